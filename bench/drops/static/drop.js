// The page of a drop test: one websocket; files to choose, the verdict, the impacts of each file, the curves.
import { showLease, socketAddress } from "/static/web/controls.js";
import { Axes, colours } from "/static/web/plot.js";
import { savers } from "/static/web/save.js";
import { Scene } from "./scene.js";

const $ = (id) => document.getElementById(id);
const make = (name, text = "", attributes = {}) => {
  const one = document.createElement(name);
  one.textContent = text;
  for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
  return one;
};
let socket = null, mine = false, plot = null, scenes = [], asked = { files: [] };

function send(command) { if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(command)); }

function connect() {
  socket = new WebSocket(socketAddress("/drop/socket"));
  socket.onopen = () => { $("connection").textContent = "connected"; $("connection").className = "badge"; };
  socket.onclose = () => {
    $("connection").textContent = "page's server gone"; $("connection").className = "badge bad";
    mine = false; buttons(); setTimeout(connect, 1000);
  };
  socket.onmessage = (event) => { const m = JSON.parse(event.data); (handlers[m.kind] ?? (() => {}))(m); };
}

function say(why) { $("refused").hidden = !why; $("refused").textContent = why ?? ""; }

const handlers = {
  offer(m) {
    $("chooser").hidden = !m.choose;
    $("none").hidden = m.files.length > 0;
    $("files").replaceChildren(...m.files.map((name) => {
      const label = make("label"), box = make("input", "", { type: "checkbox", value: name });
      box.addEventListener("change", buttons);
      label.append(box, ` ${name}`);
      return label;
    }));
    buttons();
  },
  request(m) {
    asked = m;
    if (!m.files.length) return;
    document.title = `${m.files[0]} - drop test - shakerbench`;
    $("title").textContent = m.files.length === 1 ? m.files[0] : `${m.files[0]} and ${m.files.length - 1} more`;
    for (const field of $("options").elements) {
      if (!field.name || field === document.activeElement) continue;
      const value = field.name === "heights_m" ? m.heights_m[0] : m[field.name];
      field.value = value === null || value === undefined ? "" : value;
    }
    $("saved").textContent = "";
    buttons();
  },
  working(m) {
    $("working").hidden = false;
    $("working").textContent = m.total ? `${m.what}: ${m.done} of ${m.total}` : `${m.what} \u2026`;
    document.body.dataset.state = "working";
  },
  result(m) {
    say(null);
    $("badge").textContent = m.explained ? m.best.replaceAll("_", " ") : "unexplained";
    $("badge").className = `badge ${m.explained ? "" : "warn"}`;
    $("sentences").replaceChildren(...m.sentences.map((words) => make("p", words, words.includes("intervals are 95 %") ? { class: "verdict" } : {})));
    $("sentences").dataset.e0 = m.parameters.e0.value;
    plot = m.plot;
    $("opened").hidden = false;
    $("fits").hidden = false;
    $("fit-box").hidden = m.is_path;
    files(m);
    figures.forEach((draw) => draw());
    $("legend").replaceChildren(...m.plot.models.flatMap((model, k) => [make("span", "", { class: `key m${k}` }), make("span", `${model.label}  `)]));
    done(m);
  },
  refused(m) {
    say(m.why);
    $("badge").textContent = "refused";
    $("badge").className = "badge bad";
    $("sentences").replaceChildren();
    delete $("sentences").dataset.e0;
    plot = null;
    $("fits").hidden = true;
    $("opened").hidden = false;
    files(m);
    done(m);
  },
  lease(m) { mine = showLease(m, $); buttons(); },
  saved(m) { $("saved").textContent = `kept as ${m.as}`; },
  no(m) { say(m.why); scenes.forEach((scene) => { scene.drag = null; scene.draw(); }); },
};

function done(m) {
  $("working").hidden = true;
  $("command").translate = !m.command;
  $("command").textContent = m.command ?? "corrections differ from file to file: no one command says this; the kept JSON does";
  document.body.dataset.state = "done";
  document.body.dataset.results = Number(document.body.dataset.results ?? 0) + 1;
  buttons();
}

// A scene for each file; those that stay keep their view.
function files(m) {
  while (scenes.length > m.files.length) scenes.pop().box.remove();
  m.files.forEach((file, k) => {
    if (!scenes[k]) {
      scenes[k] = new Scene($("marks"), k);
      scenes[k].addEventListener("correct", (event) => send({ do: "correct", ...event.detail }));
    }
    scenes[k].mine = mine;
    scenes[k].set(file, m.plot ?? null);
  });
}

function buttons() {
  const chosen = document.querySelectorAll("#files input:checked").length;
  $("open").disabled = !mine || !chosen;
  $("undo").disabled = !mine || !asked.can_undo;
  for (const id of ["reset", "save"]) $(id).disabled = !mine;
  for (const field of $("options").elements) field.disabled = !mine;
  scenes.forEach((scene) => scene.controls(mine));
}

function figure(id, pick, labels) {
  const axes = new Axes($(id), { left: 62, right: 14 });
  savers($(id).closest("section").querySelector("h2"), `drop-${id}`, () => [$(id)], () => {
    const rows = [["set", ...(plot ? labels(plot) : [])]];
    const name = (set) => (set.model === undefined ? "measured" : `model ${set.model + 1}`);
    for (const set of plot ? pick(plot) : []) set.x.forEach((x, i) => rows.push([name(set), x, set.y[i]]));
    return rows;
  });
  const draw = () => {
    if (!plot) return;
    axes.fit();
    const c = colours(), style = [c.c1, c.c0], sets = pick(plot);
    const xs = sets.flatMap((s) => s.x), ys = sets.flatMap((s) => s.y).filter((y) => y !== null);
    if (!xs.length || !ys.length) return;
    const room = (low, high) => { const part = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1; return [low - part, high + part]; };
    axes.xlim = room(Math.min(...xs), Math.max(...xs));
    axes.ylim = room(Math.min(...ys), Math.max(...ys));
    [axes.options.x, axes.options.y] = labels(plot);
    axes.clear();
    axes.frame();
    axes.inside(() => {
      for (const set of sets) {
        const y = set.y.map((v) => v ?? NaN);
        if (set.line) axes.line(set.x, y, style[set.model], 1.6); else axes.dots(set.x, y, set.model === undefined ? c.measured : style[set.model], 4.5);
      }
    });
  };
  new ResizeObserver(draw).observe($(id));
  addEventListener("themechange", draw);
  return draw;
}

const figures = [
  figure("fit", (p) => [...p.data, ...p.models.flatMap((m, k) => m.pieces.map((one) => ({ ...one, line: true, model: k })))], (p) => [p.x_label, p.y_label]),
  figure("left", (p) => p.models.flatMap((m, k) => m.left.map((one) => ({ ...one, model: k }))), (p) => [p.x_label, p.left_label]),
];

for (const id of ["ask", "hand_over", "keep"]) $(id).addEventListener("click", () => send({ do: id }));
for (const id of ["undo", "reset", "save"]) $(id).addEventListener("click", () => send({ do: id }));
$("open").addEventListener("click", () => {
  const names = [...document.querySelectorAll("#files input:checked")].map((box) => box.value);
  scenes.forEach((scene) => scene.box.remove());
  scenes = [];
  say(null);
  send({ do: "open", files: names });
});
$("filter").addEventListener("input", () => {
  for (const label of $("files").children) label.hidden = !label.textContent.toLowerCase().includes($("filter").value.toLowerCase());
});
$("options").addEventListener("submit", (event) => {
  event.preventDefault();
  const told = { do: "options" };
  for (const field of $("options").elements) {
    if (!field.name) continue;
    const text = field.value.trim().replace(",", "."), value = text === "" ? null : Number(text);
    if (value !== null && !isFinite(value)) { say(`${field.value}: wanted a number`); return; }
    told[field.name] = field.name === "heights_m" ? (value === null ? [] : [value]) : value;
  }
  send(told);
});
addEventListener("keydown", (event) => {
  if (event.key === "z" && (event.ctrlKey || event.metaKey) && event.target.tagName !== "INPUT") { event.preventDefault(); send({ do: "undo" }); }
});
connect();
