// The live page: one websocket in, canvases and words out. No drawing happens unless something changed.
import { showLease, socketAddress } from "/static/web/controls.js";
import { alarm } from "/static/web/alarm.js";
import { savers } from "/static/web/save.js";
import { LiveScope } from "./scope.js";
import { Diagram, ReturnMap, Residuals, Spectrum } from "./pictures.js";

const $ = (id) => document.getElementById(id);
const el = (tag, words, name) => {
  const one = document.createElement(tag);
  if (words !== undefined) one.textContent = words;
  if (name) one.className = name;
  return one;
};
const minus = (text) => text.replace("-", "\u2212");
const fixed = (x, n) => (x === null || x === undefined || !isFinite(x) ? "\u2013" : minus(x.toFixed(n)));

const scope = new LiveScope($("scope"));
const diagram = new Diagram($("diagram")), map = new ReturnMap($("map"));
const residuals = new Residuals($("residual")), spectrum = new Spectrum($("spectrum"));
const pictures = [scope, diagram, map, residuals, spectrum];
let shared = "";
let socket = null, plan = null, run = null, mine = false, running = false, pausing = false, offer = null, last = null, present = -1;
export const counts = { updates: 0, scopes: 0, draws: 0, flights: 0, since: performance.now() };
window.deskCounts = counts; // for measurements
window.deskTable = () => diagram.table();

function send(command) { if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(command)); }

function connect() {
  socket = new WebSocket(socketAddress("/live/socket"));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { reset(); badge("connected", ""); };
  socket.onclose = () => { badge("page's server gone; the run is not touched by that", "bad"); mine = false; buttons(); setTimeout(connect, 1000); };
  socket.onmessage = (event) => {
    if (typeof event.data === "string") words(JSON.parse(event.data)); else binary(event.data);
  };
}

function badge(text, name) { $("connection").textContent = text; $("connection").className = `badge ${name}`; }

function reset() {
  diagram.clear(); map.clear(); residuals.clear(); scope.clear();
  counts.flights = 0; present = -1; $("log").replaceChildren();
}

const handlers = {
  offer(m) { offer = m; buttons(); },
  plan(m) {
    plan = m;
    diagram.plan(m); map.plan(m); residuals.plan(m);
    document.title = `live: ${m.profile} - shakerbench`;
    $("verdict-title").textContent = "Verdict so far";
    $("verdict").replaceChildren(el("span", "after the first step with flights", "faint"));
    $("tones").tBodies[0].replaceChildren();
    $("cycle").textContent = "";
  },
  started(m) { reset(); run = null; running = true; $("state-run").hidden = true; log(m.why ? `next: ${m.why}` : `run started: ${m.out}`); buttons(); },
  run(m) {
    run = m; running = true;
    $("simulated").hidden = !m.simulated;
    scope.set(m.traces);
    log(`recording ${m.out}, back end ${m.backend}`, "", m.at);
    buttons();
  },
  state(m) { state(m); },
  ended(m) {
    $("state-word").textContent = m.how;
    $("state-word").className = m.how === "complete" ? "good" : "bad";
    $("state-left").textContent = m.why || "";
    log(`${m.how}${m.why ? `: ${m.why}` : ""}; ${m.n_samples} samples kept`, "", m.at);
    if (m.out && offer && !offer.in_terminal) { // a page beside a run in a terminal ends with it
      log(`judge it: bench close-loop ${/\s/.test(m.out) ? `"${m.out}"` : m.out}`, "", m.at);
      $("state-run").href = `/runs/file?path=${encodeURIComponent(m.out)}`;
      $("state-run").hidden = false;
    }
    if (m.how === "failed" && Date.now() / 1e3 - m.at < 5) alarm(m.why);
    running = false;
    if (last) margins({ ...last, limits: {}, contact_age_cycles: NaN });
    buttons();
  },
  model(m) { diagram.model(m); },
  reduced(m) { reduced(m); },
  verdict(m) { verdict(m); },
  taken(m) { log({ finish: "finishing this step", ramp_down: "ramping down", now: "stopped now", pause: "pausing after this step", go_on: "going on", note: `note: ${m.text}`, next: `finishing this step; next: ${m.text || "another choice"}`, refused: m.text }[m.do] ?? m.do, m.do === "refused" ? "bad" : "", m.at); },
  shared(m) {
    shared = m.url;
    $("share").setAttribute("aria-pressed", String(Boolean(shared)));
    $("link").textContent = shared;
    $("link").hidden = !shared;
  },
  lease(m) {
    mine = showLease(m, $);
    buttons();
  },
  refused(m) { log(m.why, "bad", m.at); },
};

function words(m) { (handlers[m.kind] ?? (() => {}))(m); }

function binary(buffer) {
  const view = new DataView(buffer), kind = view.getUint8(0);
  counts.updates++;
  if (kind === 1) {
    counts.scopes++;
    scope.add(view.getFloat64(8, true), view.getFloat64(16, true), view.getUint8(1), new Int16Array(buffer, 24));
  } else if (kind === 2) {
    const n = view.getUint32(4, true), column = (k) => new Float32Array(buffer, 16 + 4 * n * k, n);
    const step = { step: view.getUint16(2, true), final: view.getUint8(1) === 1, gamma: view.getFloat32(8, true),
      tau: column(0), landing: column(1), residual: column(2), noise: column(3), mark: new Uint8Array(buffer, 16 + 16 * n, n) };
    diagram.step(step); residuals.step(step);
    if (step.step >= present) { present = step.step; map.step(step); }
    counts.flights = diagram.count;
  } else if (kind === 3) {
    const n = view.getUint32(4, true);
    spectrum.set(new Float32Array(buffer, 8, n), new Float32Array(buffer, 8 + 4 * n, n));
  }
}

function state(m) {
  running = true;
  pausing = m.pausing;
  $("state-word").textContent = m.stopping && m.state !== "done" ? `${m.state} (${m.stopping.replace("_", " ")})` : m.state;
  $("state-word").className = m.state === "paused" || m.stopping ? "warn" : "";
  const f = plan ? plan.factor : 1;
  $("state-step").textContent = `step ${m.step} (last ${m.n_steps - 1})`;
  const achieved = m.achieved_gamma === null ? "" : `, last achieved ${(f * m.achieved_gamma).toFixed(4)} \u00b1 ${(f * (m.achieved_gamma_uncertainty ?? 0)).toPrecision(1)}`;
  $("state-gamma").textContent = `\u0393${plan && plan.factor !== 1 ? " peak" : ""} commanded ${(f * m.gamma).toFixed(4)}${achieved}`;
  const left = plan ? m.left_samples / plan.rate_hz : 0;
  last = m;
  $("state-left").textContent = `${Math.floor(left / 60)} min ${String(Math.floor(left % 60)).padStart(2, "0")} s left`;
  $("state-lost").textContent = `${m.lost_samples} samples lost`;
  $("state-lost").className = m.lost_samples ? "bad" : "";
  const alive = m.contact_age_cycles <= 3;
  $("state-contact").textContent = alive ? "contact alive" : `contact silent for ${m.contact_age_cycles.toFixed(0)} cycles`;
  $("state-contact").className = alive ? "good" : "warn";
  diagram.present(f * m.gamma);
  margins(m);
  buttons();
}

const NAMES = { drive_v: "drive", plate_mps2: "plate acceleration", velocity_mps: "plate velocity", displacement_m: "plate displacement" };
const bars = new Map();
function margins(m) {
  if (!plan) return;
  for (const [key, [limit, unit]] of Object.entries(plan.limits)) if (limit !== null) bar(key, NAMES[key] ?? key, m.limits[key] ?? NaN, `limits.${key} = ${limit} ${unit}`);
  if (plan.contact_cycles) bar("contact", "contact silent", m.contact_age_cycles / plan.contact_cycles, `limits.contact_cycles = ${plan.contact_cycles}`);
}
function bar(key, name, part, limit) {
  let one = bars.get(key);
  if (!one) {
    const row = el("div", undefined, "bar-row"), value = el("span"), track = el("div", undefined, "track"), fillBar = el("div", undefined, "fill");
    row.append(el("span", name), value, track);
    row.title = limit;
    track.append(fillBar);
    const small = el("span", limit, "faint");
    row.append(small);
    $("margins").append(row);
    one = { value, fillBar };
    bars.set(key, one);
  }
  one.value.textContent = isFinite(part) ? `${(100 * part).toFixed(0)} %` : "\u2013"; // a plate that stands: not known
  one.fillBar.style.width = `${Math.min(100, 100 * (isFinite(part) ? part : 0))}%`;
  one.fillBar.className = `fill${part > 0.95 ? " over" : part > 0.75 ? " near" : ""}`;
}

function reduced(m) {
  if (m.step < present) return;
  $("cycle").textContent = `step ${m.step}: ${m.label}${m.final ? "" : " ..."}`;
  $("tones").tBodies[0].replaceChildren(...m.tones.map((t) => {
    const row = document.createElement("tr"), hz = plan ? plan.frequency_hz * t.multiple : 0;
    const off = t.mps2 === null || !t.target_mps2 ? null : 100 * (t.mps2 / t.target_mps2 - 1);
    let turn = t.deg === null ? null : t.deg - t.target_deg;
    if (turn !== null) turn = ((turn + 540) % 360) - 180;
    row.append(el("td", `${hz.toPrecision(4)} Hz`));
    for (const text of [fixed(t.mps2, 2), off === null ? "\u2013" : `${fixed(off, 2)} %`, `${fixed(t.deg, 1)}\u00b0`, `${fixed(turn, 2)}\u00b0`])
      row.append(el("td", text, "number"));
    row.title = `target: ${fixed(t.target_mps2, 2)} m/s\u00b2 at ${fixed(t.target_deg, 1)}\u00b0`;
    return row;
  }));
}

function verdict(m) {
  $("verdict-title").textContent = m.last ? "Verdict at the end of the run" : "Verdict so far";
  const parts = [el("b", m.headline, m.within ? "good" : "warn")];
  if (m.candidates.length) {
    const list = el("ul");
    for (const c of m.candidates) list.append(el("li", c));
    parts.push(list);
  }
  for (const line of m.lines) parts.push(el("div", line));
  $("verdict").replaceChildren(...parts);
  residuals.floor(m.floor_us);
  $("floor").textContent = m.floor_us ? `noise floor ${m.floor_us.toPrecision(2)} \u00b5s` : "";
}

// The latest line first; `at` (s, Unix time) is when it happened, which a reload does not change.
function log(text, name, at = Date.now() / 1e3) {
  const row = el("li", undefined, name), time = el("time", new Date(1e3 * at).toLocaleTimeString([], { hour12: false }));
  row.dataset.at = at;
  const words = el("span", text);
  words.translate = !/^(note|finishing this step; next): /.test(text); // a person's own words
  row.append(time, words);
  const before = [...$("log").children].find((one) => Number(one.dataset.at) <= at);
  $("log").insertBefore(row, before ?? null);
  while ($("log").children.length > 200) $("log").lastChild.remove();
}

function buttons() {
  const may = mine && running;
  $("now").disabled = !running; // whoever sees the page may stop the plate
  for (const id of ["ramp_down", "finish", "pause", "note"]) $(id).disabled = !may;
  $("note-form").querySelector("button").disabled = !may;
  $("next-form").hidden = !(run && run.leads);
  for (const one of $("next-form").elements) one.disabled = !may;
  $("share").disabled = !mine;
  for (const id of ["mark", "repeat"]) $(id).disabled = !may;
  $("repeat").hidden = !(run && run.leads);
  $("pause").firstChild.textContent = pausing ? "go on " : "pause after step ";
  $("start").hidden = !offer || offer.in_terminal || running;
  $("margins-box").hidden = !$("start").hidden;
}

const numbered = () => [...$("log").children].filter((one) => /note: mark \d+$/.test(one.textContent)).length + 1;
$("mark").addEventListener("click", () => send({ do: "note", text: `mark ${numbered()}` }));
$("repeat").addEventListener("click", () => { if (last) send({ do: "next", text: `${last.gamma}: the step repeated` }); });
$("share").addEventListener("click", () => send({ do: "share", on: !shared }));
$("lecture").addEventListener("click", () => lecture(!document.body.classList.contains("lecture")));
// Large words and the diagram, to be read from ten metres; the address keeps it.
function lecture(on) {
  document.body.classList.toggle("lecture", on);
  $("lecture").setAttribute("aria-pressed", String(on));
  history.replaceState(null, "", on ? "#lecture" : location.pathname);
}
if (location.hash === "#lecture") lecture(true);
for (const id of ["now", "ramp_down", "finish"]) $(id).addEventListener("click", () => send({ do: id }));
$("pause").addEventListener("click", () => send({ do: pausing ? "go_on" : "pause" }));
for (const id of ["ask", "hand_over", "keep"]) $(id).addEventListener("click", () => send({ do: id }));
$("note-form").addEventListener("submit", (event) => {
  event.preventDefault();
  const text = $("note").value.trim();
  if (text) send({ do: "note", text });
  $("note").value = "";
  $("note").blur();
});
$("next-form").addEventListener("submit", (event) => {
  event.preventDefault();
  send({ do: "next", text: $("next").value.trim() });
  $("next").value = "";
  $("next").blur();
});
addEventListener("keydown", (event) => {
  const typing = event.target instanceof HTMLInputElement && event.target.type !== "checkbox";
  if (event.key === "Escape" || (event.key === " " && !typing && !(event.target instanceof HTMLSelectElement))) {
    event.preventDefault(); // also where a button has the focus: space is always the stop
    if (running) send({ do: "now" });
    return;
  }
  if (typing || event.ctrlKey || event.altKey || event.metaKey || event.target instanceof HTMLSelectElement) return;
  const id = { r: "ramp_down", f: "finish", p: "pause", z: "freeze", k: "mark" }[event.key];
  if (id && !$(id).disabled) $(id).click();
  if (event.key === "n" && !$("note").disabled) { event.preventDefault(); $("note").focus(); }
});
addEventListener("keyup", (event) => { if (event.key === " " && event.target instanceof HTMLButtonElement) event.preventDefault(); });

$("span").addEventListener("change", () => scope.span(parseFloat($("span").value)));
$("units").addEventListener("change", () => scope.units($("units").value));
$("trigger").addEventListener("change", () => scope.trigger($("trigger").checked));
$("freeze").addEventListener("click", () => $("freeze").setAttribute("aria-pressed", String(scope.freeze())));
$("zoom-out").addEventListener("click", () => scope.whole());

const legend = $("legend");
for (const [name, text] of [["measured", "measured"], ["doubt", "unsure"], ["model", "model"], ["zone", "forbidden"]]) {
  legend.append(el("i", "", `k-${name}`), text);
}

for (const [box, picture, name] of [["scope-box", scope, "scope"], ["diagram-box", diagram, "bifurcation-diagram"],
  ["map-box", map, "return-map"], ["residual-box", residuals, "landing-residuals"], ["plate-box", spectrum, "spectrum"]]) {
  savers($(box).querySelector(".tools"), name, () => [picture.canvas], () => picture.table());
}

function paint() {
  for (const picture of pictures) if (picture.paint()) counts.draws++;
}
// 25 pictures a second at most; a hidden page draws nothing
setInterval(() => { if (!document.hidden) requestAnimationFrame(paint); }, 40);
for (const name of ["resize", "themechange"]) addEventListener(name, () => { for (const picture of pictures) picture.stale(); });
buttons();
connect();
