"use strict";
// Hover names the flight nearest to the pointer; a click pins its name; Escape takes the pins away.
(() => {
  const KINDS = { f4: [Float32Array, 4], f8: [Float64Array, 8], i4: [Int32Array, 4] };
  const SVG = "http://www.w3.org/2000/svg";
  const REACH_PX = 14;

  function numbers(text, kind) {
    const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    return new KINDS[kind][0](bytes.buffer);
  }

  const tables = {};
  function table(name) {
    if (!(name in tables)) {
      const told = JSON.parse(document.getElementById(name).textContent);
      for (const key of Object.keys(told.columns)) {
        told.columns[key] = numbers(told.columns[key].slice(3), told.columns[key].slice(0, 2));
      }
      tables[name] = told;
    }
    return tables[name];
  }

  function words(told, row) {
    const c = told.columns;
    const lines = [
      "flight " + row + " at " + c.takeoff_s[row].toFixed(6) + " s",
      "step " + c.step[row] + ", " + told.gamma + " = " + c.gamma[row].toFixed(4),
      "flight time " + (1e3 * c.duration_s[row]).toFixed(4) + " ms",
    ];
    if (c.before_us) {
      const us = (x) => (Number.isFinite(x) ? x.toFixed(1) : "-");
      lines.push("landing minus predicted: " + us(c.before_us[row]) + " before, " + us(c.after_us[row]) + " after (µs)");
    }
    if (c.flags && c.flags[row]) {
      lines.push(told.flags.filter((_, i) => c.flags[row] & (1 << i)).join(", "));
    }
    return lines;
  }

  function mark(svg, x, y) {
    const ring = document.createElementNS(SVG, "circle");
    for (const [key, value] of Object.entries({ cx: x, cy: y, r: 5, fill: "none", stroke: "#000", "stroke-width": 1.6 })) {
      ring.setAttribute(key, value);
    }
    svg.appendChild(ring);
    return ring;
  }

  function label(figure, svg, x, y, lines, kind) {
    const box = document.createElement("div");
    box.className = "flight " + kind;
    for (const line of lines) {
      const row = document.createElement("div");
      row.textContent = line;
      box.appendChild(row);
    }
    figure.appendChild(box);
    const scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
    const left = svg.getBoundingClientRect().left - figure.getBoundingClientRect().left + x * scale;
    box.style.left = Math.max(0, Math.min(left + 10, figure.clientWidth - box.offsetWidth)) + "px";
    box.style.top = svg.getBoundingClientRect().top - figure.getBoundingClientRect().top + y * scale + 10 + "px";
    return box;
  }

  function makeLive(figure) {
    const svg = figure.querySelector("svg");
    let points = null;
    let shown = null;
    const forget = () => {
      if (shown) {
        shown.ring.remove();
        shown.box.remove();
        shown = null;
      }
    };
    const nearest = (event) => {
      if (points === null) {
        const told = JSON.parse(document.getElementById(figure.dataset.points).textContent);
        points = { x: numbers(told.x, "f4"), y: numbers(told.y, "f4"), row: numbers(told.row, "i4") };
      }
      const view = svg.getBoundingClientRect();
      const scale = svg.viewBox.baseVal.width / view.width;
      const x = (event.clientX - view.left) * scale;
      const y = (event.clientY - view.top) * scale;
      let best = -1;
      let least = (REACH_PX * scale) ** 2;
      for (let i = 0; i < points.x.length; i++) {
        const d = (points.x[i] - x) ** 2 + (points.y[i] - y) ** 2;
        if (d < least) {
          least = d;
          best = i;
        }
      }
      return best;
    };
    svg.addEventListener("mousemove", (event) => {
      const i = nearest(event);
      if (shown && shown.i === i) return;
      forget();
      if (i < 0) return;
      const lines = words(table(figure.dataset.flights), points.row[i]);
      shown = {
        i,
        ring: mark(svg, points.x[i], points.y[i]),
        box: label(figure, svg, points.x[i], points.y[i], lines, "passing"),
      };
    });
    svg.addEventListener("mouseleave", forget);
    svg.addEventListener("click", (event) => {
      const i = nearest(event);
      if (i < 0) return;
      const lines = words(table(figure.dataset.flights), points.row[i]);
      const ring = mark(svg, points.x[i], points.y[i]);
      const box = label(figure, svg, points.x[i], points.y[i], lines, "pinned");
      ring.classList.add("pinned");
      box.title = "click to take the pin away";
      box.addEventListener("click", () => {
        ring.remove();
        box.remove();
      });
    });
  }

  document.querySelectorAll("figure[data-points]").forEach(makeLive);
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape") document.querySelectorAll(".pinned").forEach((element) => element.remove());
  });
})();
