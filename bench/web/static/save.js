// "picture", "data" and "table": what every plot can be saved and read as. PNG of the canvas as it is drawn, CSV of the numbers behind it.
function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

function cell(x) {
  if (x === null || x === undefined || (typeof x === "number" && !isFinite(x))) return "";
  return /[",\n]/.test(x) ? `"${String(x).replaceAll('"', '""')}"` : x;
}

// Several canvases one above the other as one picture.
function joined(canvases) {
  if (canvases.length === 1) return canvases[0];
  const whole = document.createElement("canvas");
  whole.width = Math.max(...canvases.map((one) => one.width));
  whole.height = canvases.reduce((sum, one) => sum + one.height, 0);
  let y = 0;
  for (const one of canvases) { whole.getContext("2d").drawImage(one, 0, y); y += one.height; }
  return whole;
}

// Two buttons at the end of `place`. `canvases` and `table` are functions: the latter gives rows, headings (with units)
// first (without it there is only the picture); `name` is that of the files, without ending.
export function savers(place, name, canvases, table) {
  const box = document.createElement("span");
  box.className = "savers";
  const add = (words, title, act) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: words, title, className: "quiet" });
    button.addEventListener("click", act);
    box.append(button);
  };
  add("picture", "save as a picture (PNG)", () => joined(canvases()).toBlob((blob) => download(blob, `${name}.png`)));
  if (table) add("data", "save the numbers (CSV)", () => {
    const lines = table().map((row) => row.map(cell).join(","));
    download(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }), `${name}.csv`);
  });
  if (table) add("table", "show the numbers as a table", () => toggle(canvases()[0], table));
  place.append(box);
}

// The numbers of a plot as a table below it, the first of them; the file has all.
const MOST_ROWS = 500;
function toggle(canvas, table) {
  const under = canvas.parentElement.classList.contains("picture") ? canvas.parentElement : canvas;
  if (under.nextElementSibling?.classList.contains("numbers")) { under.nextElementSibling.remove(); return; }
  const around = document.createElement("div"), whole = around.appendChild(document.createElement("table"));
  around.className = "numbers";
  around.tabIndex = 0;
  table().slice(0, MOST_ROWS + 1).forEach((row, i) => {
    const line = whole.insertRow();
    for (const value of row) line.appendChild(document.createElement(i ? "td" : "th")).textContent = typeof value === "number" ? Number(value.toPrecision(7)) : value ?? "";
  });
  under.after(around);
}
