// The six gates: one message holds the whole state, from which everything is drawn anew.
import { alarm } from "/static/web/alarm.js";
import { showLease, socketAddress } from "/static/web/controls.js";
import { rampPictures, rigPicture } from "./pictures.js";

const $ = (id) => document.getElementById(id);
const make = (tag, words, attributes = {}) => {
  const one = document.createElement(tag);
  if (words !== undefined) one.textContent = words;
  for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
  return one;
};
const base = (name) => name.split(/[\\/]/).pop();
const TITLES = {
  card: "1. The card", wiring: "2. The wiring", calibrate: "3. Scales", check: "4. The check", ramp: "5. The ramp", verdict: "6. The verdict",
};
const WORDS = {
  card: "Which device, at which rate; which inputs carry something; how late the drive comes back.",
  wiring: "Which terminal is what is found by moving it: by hand, while nothing is driven, or by the drive itself.",
  calibrate: "How many volts are how much motion. Each scale with its age; what is measured here is written into the profile. Restitution and bounce come from a drop test.",
  check: "A chirp, a quiet tone and a short flight: is every channel what the profile says?",
  ramp: "Choose a ramp and look at what the plate will do. Nothing moves before you say that all hands are off.",
  verdict: "The recording is held against the model; the missing effect is named, with the error before and after.",
};
const STATES = { green: "passed", open: "open", closed: "closed" };
let socket = null, view = null, mine = false, chosen = null, runState = null, shownKey = "";

// What was refused stands on the page until the next thing is asked; why there is no profile, until there is one.
const clear = () => { $("refused").textContent = view?.fault; $("refused").hidden = !view?.fault; };
const send = (command) => { clear(); if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(command)); };

function connect() {
  socket = new WebSocket(socketAddress("/gates/socket"));
  socket.onopen = () => badge("connected", "");
  socket.onclose = () => { badge("page's server gone", "bad"); mine = false; draw(); setTimeout(connect, 1000); };
  socket.onmessage = (event) => handlers[JSON.parse(event.data).kind]?.(JSON.parse(event.data));
}
function badge(words, name) { $("connection").textContent = words; $("connection").className = `badge ${name}`; }

const handlers = {
  gates(m) {
    if (view && m.profile !== view.profile) chosen = null;
    if (!m.run) runState = null;
    const was = view && current();
    const faulty = m.fault || view?.fault;
    view = m;
    if (faulty) clear();
    if (chosen && was === chosen && gateOf(chosen).state === "green") chosen = null; // on to the next
    draw();
  },
  lease(m) { mine = showLease(m, $); draw(); },
  refused(m) { $("refused").textContent = m.why; $("refused").hidden = false; },
  state(m) { runState = m; status(); },
  ended(m) { if (m.how === "failed" && view?.run) alarm(m.why); },
};

const gateOf = (name) => view.gates.find((one) => one.name === name);
// The gate that is shown: the one that was clicked, or the first that is not green.
function current() {
  return chosen ?? (view.gates.find((one) => one.state !== "green") ?? view.gates.at(-1)).name;
}

function draw() {
  if (!view) return;
  const name = current(), gate = gateOf(name);
  document.title = `${TITLES[name].slice(3)} - shakerbench`;
  $("simulated").hidden = !view.simulated;
  $("steps").replaceChildren(...view.gates.map((one) => {
    const item = make("li"), button = make("button", TITLES[one.name], { type: "button", class: one.state, id: `step-${one.name}` });
    if (one.name === name) button.setAttribute("aria-current", "step");
    button.append(make("small", STATES[one.state]));
    button.addEventListener("click", () => { chosen = one.name; clear(); draw(); });
    item.append(button);
    return item;
  }));
  status();
  $("picture").replaceChildren(rigPicture(name, view));
  $("gate-title").textContent = TITLES[name];
  $("gate-words").textContent = WORDS[name];
  const before = view.gates[view.gates.findIndex((one) => one.name === name) - 1];
  const since = gate.state === "closed" ? `Closed until \u201c${TITLES[before.name]}\u201d is passed.` : gate.since.length && gate.state !== "green" ? `Changed since it was passed: ${gate.since.join(", ")}.` : "";
  $("gate-since").textContent = since;
  $("gate-since").hidden = !since;
  const key = JSON.stringify([name, view, mine]);
  if (key !== shownKey) { controls(name, gate); shownKey = key; }
  rows(name, gate);
  ramp(name);
  rounds(name);
  $("profile-box").hidden = !view.profile;
  $("profile-name").textContent = view.profile;
  $("undo").disabled = !mine || !view.can_undo || busy();
  if ($("profile-box").open) fields();
}

const busy = () => Boolean(view.job || view.run);
function status() {
  if (!view) return;
  const job = view.job, run = view.run;
  $("status").hidden = !busy();
  $("answer").hidden = !job?.asks;
  $("answer").disabled = !mine;
  $("watch").hidden = !run;
  $("part").hidden = !run || !runState;
  if (job) $("doing").textContent = job.words || `${TITLES[job.gate].slice(3)}${job.kind ? `: ${job.kind}` : ""} \u2026`;
  if (run) {
    const s = runState, left = s && view.plan?.duration_s ? (s.left_samples / s.n_samples) * view.plan.duration_s : null;
    $("doing").textContent = s ? `driving ${run.out}: step ${s.step + 1} of ${s.n_steps}, ${s.state}${left === null || !isFinite(left) ? "" : `, ${Math.ceil(left)} s left`}${view.queue ? `; ${view.queue} more to follow` : ""}` : `starting ${run.out} \u2026`;
    if (s) $("part").value = Math.min(1, s.sample / Math.max(1, s.n_samples));
  }
}

const button = (words, command, { go = false, id = "", off = false } = {}) => {
  const one = make("button", words, { type: "button", ...(go ? { class: "go" } : {}), ...(id ? { id } : {}) });
  one.disabled = !mine || busy() || off;
  one.addEventListener("click", () => send(typeof command === "function" ? command() : command));
  return one;
};
function labelled(words, field, tick = false) {
  const one = make("label", tick ? undefined : words, tick ? { class: "tick" } : {});
  one.append(...(tick ? [field, ` ${words}`] : [field]));
  return one;
}
function choice(id, values, names, value) {
  const one = make("select", undefined, { id });
  one.append(...values.map((v, i) => { const o = make("option", names[i]); o.value = v; o.translate = names[i] !== v; return o; }));
  one.value = value;
  one.disabled = !mine || busy();
  return one;
}

function controls(name, gate) {
  const closed = gate.state === "closed", parts = [];
  const job = (kind, words, go, id) => button(words, { do: "job", gate: name, kind }, { go, id, off: closed });
  if (name === "card") {
    const own = view.profiles, others = view.shipped.map((one) => `new:${one}`);
    const rig = choice("rig", [...own, ...others], [...own, ...view.shipped.map((one) => `new, like ${one}`)], view.profile || "new:simulated");
    const hidden = choice("scenario", ["", ...view.scenarios.filter((one) => one !== "ideal")], ["nothing (ideal)", ...view.scenarios.filter((one) => one !== "ideal")], view.scenario);
    const choose = () => ({ do: "choose", ...(rig.value.startsWith("new:") ? { like: rig.value.slice(4) } : { profile: rig.value }), scenario: hidden.value, seed: view.seed });
    parts.push(labelled("rig", rig), labelled("the simulated rig hides", hidden), button("use this rig", choose, { go: !view.profile, id: "choose" }));
    if (!view.profile) parts.push(button("Simulated rig, with friction", { do: "choose", like: "simulated", scenario: "friction", seed: view.seed }, { go: true, id: "simulate" }));
    else parts.push(job("", "look at the card", true, "do-card"));
  } else if (name === "wiring") {
    if (!view.simulated) parts.push(job("tap", "I tap the plate", true, "do-tap"), job("lift", "I lift the ball", true, "do-lift"));
    parts.push(job("drive", "move it by the drive", Boolean(view.simulated), "do-wiring"));
    const wrong = gate.rows.filter((row) => row.passed === false);
    if (wrong.some((row) => row.what === "inputs") && view.terminals?.continuity?.startsWith("input ")) parts.push(button("exchange these inputs in the profile", { do: "exchange" }, { id: "exchange" }));
    if (wrong.some((row) => row.what === "accelerometer sign")) parts.push(button("turn the sign in the profile", { do: "turn" }, { id: "turn" }));
  } else if (name === "calibrate") {
    for (const [kind, words] of [["accelerometer", "flip test"], ["drive", "drive"], ["contact", "contact"]]) parts.push(job(kind, `calibrate: ${words}`, false, `do-${kind}`));
    const drop = make("a", "drop test", { href: "/drop", class: "button" });
    const doubtful = (view.scales ?? []).some((one) => one.state !== "good"), anyway = make("input", undefined, { type: "checkbox", id: "anyway" });
    parts.push(drop);
    if (doubtful) parts.push(labelled("take the scales that are old or were never calibrated, too", anyway, true));
    parts.push(button("use these scales", () => ({ do: "accept", anyway: anyway.checked }), { go: true, id: "accept", off: closed }));
  } else if (name === "check") parts.push(job("", "check", true, "do-check"));
  else if (name === "ramp") rampControls(parts, closed);
  else {
    parts.push(job("", "name the cause", true, "do-verdict"));
    const ramp = gateOf("ramp");
    if (ramp.file) parts.push(make("a", "look at the run", { href: `/runs/file?path=${encodeURIComponent(ramp.file)}`, class: "button", id: "look" }));
    if (view.rounds.length && view.rounds.at(-1).improved !== view.profile) parts.push(button("drive again with the improved profile", { do: "again" }, { go: gate.state === "green", id: "again" }));
  }
  $("controls").replaceChildren(...parts);
}

function rampControls(parts, closed) {
  const presets = Object.entries(view.presets);
  const preset = choice("preset", ["", ...presets.map(([name]) => name)], ["as the profile has it", ...presets.map(([, words]) => words)], "");
  preset.addEventListener("change", () => { if (preset.value) send({ do: "preset", name: preset.value }); });
  const name = make("input", undefined, { type: "text", id: "run-name", maxlength: 100, placeholder: "profile and time" });
  const note = make("input", undefined, { type: "text", id: "run-note", maxlength: 1900 });
  const hands = make("input", undefined, { type: "checkbox", id: "hands" });
  const forbidden = view.plan?.fault || view.plan?.faults?.length;
  const start = button("start the ramp", () => ({ do: "start", hands_off: hands.checked, name: name.value, note: note.value }), { go: true, id: "go", off: true });
  hands.addEventListener("change", () => { start.disabled = !mine || busy() || closed || forbidden || !hands.checked; });
  hands.disabled = !mine || busy() || closed;
  parts.push(labelled("ramp", preset), labelled("name of the recording", name), labelled("note", note), labelled("all hands are off the plate", hands, true), start);
  if (view.run) {
    const more = make("button", "once more after this", { type: "button", id: "later" });
    more.disabled = !mine;
    more.addEventListener("click", () => send({ do: "later", times: 1 }));
    parts.push(more);
    if (view.queue) {
      const none = make("button", "nothing after this", { type: "button", id: "no-later" });
      none.disabled = !mine;
      none.addEventListener("click", () => send({ do: "later", times: 0 }));
      parts.push(none);
    }
  }
}

function rows(name, gate) {
  let shown = gate.rows.map((row) => [row.passed, row.what, row.seen + (row.passed === true || !row.remedy ? "" : ` \u2192 ${row.remedy}`)]);
  if (name === "calibrate") {
    const age = { good: "", old: ", too old", missing: "" };
    shown = [...(view.scales ?? []).map((one) => [one.state === "good" ? true : null, one.key,
      one.days === null ? `${one.value || "unknown"}; never calibrated` : `${one.value}; ${one.days} days old${age[one.state]}${one.source ? ` (${one.source})` : ""}`]),
    ...shown.filter((row) => row[0] === false)];
  }
  const mark = (passed) => (passed === true ? [name === "calibrate" ? "ok" : "pass", "good"] : passed === false ? ["FAIL", "bad"] : ["?", "warn"]);
  $("rows").hidden = !shown.length;
  $("rows").tBodies[0].replaceChildren(...shown.map(([passed, what, seen]) => {
    const row = make("tr"), [word, colour] = mark(passed);
    row.append(make("td", word, { class: colour }), make("td", what), make("td", seen));
    return row;
  }));
}

function ramp(name) {
  const plan = view.plan;
  $("ramp-box").hidden = name !== "ramp" || !plan;
  if (name !== "ramp" || !plan) return;
  if (plan.fault) { $("ramp").replaceChildren(make("p", plan.fault, { class: "error" })); $("ramp-words").textContent = ""; return; }
  const minutes = Math.floor(plan.duration_s / 60);
  $("ramp-words").textContent = `${plan.n_steps} steps, c = ${plan.ratio}, ${plan.frequency_hz} Hz, ${minutes ? `${minutes} min ` : ""}${Math.round(plan.duration_s % 60)} s`;
  $("ramp").replaceChildren(...rampPictures(plan), ...plan.faults.map((line) => make("p", line, { class: "error" })));
}

function rounds(name) {
  const all = view.rounds.slice(-3);
  $("rounds-box").hidden = name !== "verdict" || !all.length;
  if ($("rounds-box").hidden) return;
  const us = (x) => (x === null ? "\u2013" : `${Number(x.toPrecision(3)).toLocaleString("en", { useGrouping: false })} \u00b5s`);
  const line = (words, cell) => {
    const row = make("tr");
    row.append(make("th", words, { scope: "row" }), ...all.map((one) => { const td = make("td"); const made = cell(one); td.append(...(Array.isArray(made) ? made : [made])); return td; }));
    return row;
  };
  const effects = (one) => one.effects.map((e) => make("div", `${e.name}: ${Object.entries(e.parameters).map(([p, v]) => `${p} = ${v.value.toPrecision(3)}`).join(", ")}`));
  $("rounds").tHead.replaceChildren(line("run", (one) => make("a", one.recording, { href: `/runs/file?path=${encodeURIComponent(one.recording)}` })));
  $("rounds").tBodies[0].replaceChildren(
    line("finding", (one) => make("span", one.headline)), line("missing effects", (one) => (one.effects.length ? effects(one) : "none")),
    line("landings missed by, before", (one) => us(one.before)), line("after", (one) => us(one.after)),
    line("noise alone", (one) => us(one.floor_us)), line("improved profile", (one) => [make("div", one.improved), ...one.lines.map((words) => make("div", words))]),
  );
}

// The profile: every key with its unit, limit and help; a value is sent when it was changed and left.
async function fields() {
  const answer = await fetch("/gates/fields");
  if (!answer.ok) return;
  const { fields: all } = await answer.json(), focus = document.activeElement?.dataset?.key;
  const find = $("find").value.trim().toLowerCase();
  $("fields").tBodies[0].replaceChildren(...all.filter((one) => `${one.key} ${one.help}`.toLowerCase().includes(find)).map((one) => {
    const row = make("tr"), cell = make("td");
    let field = make("input", undefined, { value: one.text, "data-key": one.key, "aria-label": one.key, placeholder: "not set" });
    if (one.choices.length) {
      field = make("select", undefined, { "data-key": one.key, "aria-label": one.key });
      field.append(...(one.text ? [] : [make("option", "", { value: "" })]), ...one.choices.map((value) => make("option", value, { value })));
      field.value = one.text;
    }
    field.disabled = !mine || busy();
    field.addEventListener("change", () => { if (field.value !== one.text) { send({ do: "set", key: one.key, text: field.value }); } });
    cell.append(field);
    cell.translate = false;
    row.append(make("td", one.key, { translate: "no" }), cell, make("td", one.unit), make("td", one.limit, { translate: "no" }), make("td", one.help));
    return row;
  }));
  if (focus) document.querySelector(`[data-key="${focus}"]`)?.focus();
}
$("profile-box").addEventListener("toggle", () => { if ($("profile-box").open) fields(); });
$("find").addEventListener("input", fields);
$("undo").addEventListener("click", () => send({ do: "undo" }));
$("answer").addEventListener("click", () => send({ do: "answer" }));
$("now").addEventListener("click", () => send({ do: "now" }));
for (const id of ["ask", "hand_over", "keep"]) $(id).addEventListener("click", () => send({ do: id }));
addEventListener("keydown", (event) => { if (event.key === "Escape" && view && busy()) { event.preventDefault(); send({ do: "now" }); } });
connect();
