// One run: scope, diagram, steps, verdict, tags and notes.
import { ask, asked, day, gammas, make, shown } from "./common.js";
import { savers } from "/static/web/save.js";
import { Diagram } from "./diagram.js";
import { Events } from "./events.js";
import { RunScope } from "./scope.js";
import { Why } from "./why.js";

const id = document.getElementById("run").dataset.id, api = `/runs/api/${id}`;
const byId = (name) => document.getElementById(name);
let scope = null, diagram = null, why = null, notes = [];

function problem(words) {
  byId("problem").textContent = words;
  byId("problem").hidden = !words;
}

function facts(run) {
  const badges = [];
  if (run.simulated) badges.push(make("span", "simulated rig", { class: "badge simulated" }));
  badges.push(make("span", run.ended, { class: `badge ${run.ended === "complete" ? "" : run.ended === "stopped" ? "warn" : "bad"}` }));
  byId("badges").replaceChildren(...badges.flatMap((one) => [one, " "]));
  byId("facts").textContent = [
    `${day(run.date)} UTC`, run.profile && `profile ${run.profile}`, run.c && `c = ${run.c}`,
    run.frequency_hz && `${shown(run.frequency_hz, 6)} Hz`, `gamma ${gammas(run)}`, `${run.steps} steps`,
    run.seconds && `${shown(run.seconds, 6)} s at ${shown(run.rate_hz, 7)} Hz`, `${run.lost_samples ?? "-"} samples lost`, run.backend,
  ].filter(Boolean).join(" \u00b7 ");
  if (run.why) problem(run.why);
}

function verdicts(loops) {
  const us = (x) => (x === null ? "-" : `${shown(x, 3)} \u00b5s`);
  const said = loops.map((loop, i) => {
    const line = make("p"), rest = [`; noise alone ${us(loop.floor_us)}`, loop.together > 1 ? `; with ${loop.together - 1} other recording(s)` : "", make("span", ` (${loop.path})`, { translate: "no" })];
    // the latest one opens its evidence
    const number = (text, what) => {
      const one = make(i ? "span" : "button", text, i ? {} : { type: "button", class: "why", title: "why? rivals, steps, residuals, edges, samples" });
      if (!i) one.addEventListener("click", () => why?.open(what));
      return one;
    };
    const summary = number(loop.summary, "rivals");
    line.append(summary, "\n", "landings: ", number(us(loop.before_us), "steps"), " before, ", number(us(loop.after_us), "steps"), " after", ...rest);
    if (loop.outdated) line.append(make("span", "Events were changed by hand since: close the loop again.", { class: "warn" }));
    return line;
  });
  byId("verdict").replaceChildren(...(said.length ? said
    : [make("p", "None yet. bench close-loop RECORDING gives one.", { class: "faint" })]));
}

function remarks(told) {
  byId("tags").replaceChildren(...told.tags.map((tag) => {
    const one = make("span", tag, { class: "tag" });
    const remove = make("button", "\u00d7", { type: "button", "aria-label": `take away ${tag}` });
    remove.addEventListener("click", () => send({ remove: [tag] }));
    one.append(remove);
    return one;
  }));
  notes = told.notes;
  scope?.annotate(notes);
  byId("notes").replaceChildren(...notes.map((note) => {
    const line = make("li", `${day(note.at)}  `);
    if (note.at_s !== null) {
      const place = make("button", `${note.at_s.toFixed(2)} s`, { type: "button", class: "quiet", title: "show it in the scope" });
      place.addEventListener("click", () => { scope?.look([note.at_s - 0.5, note.at_s + 0.5]); byId("scope").scrollIntoView({ block: "center" }); });
      line.append(place, " ");
    }
    line.append(note.text);
    return line;
  }));
}

async function send(change) {
  try {
    remarks(await ask(`${api}/remarks`, { method: "POST", body: JSON.stringify(change) }));
    byId("refused").textContent = "";
    return true;
  } catch (error) {
    byId("refused").textContent = error.message;
    return false;
  }
}
for (const [name, change] of [["tag", (x) => ({ add: x.split(/\s+/).filter(Boolean) })], ["note", (x) => ({ note: x })]]) {
  byId(`add-${name}`).addEventListener("submit", async (event) => {
    event.preventDefault();
    const field = event.target.elements[name];
    if (field.value.trim() && await send(change(field.value))) field.value = "";
  });
}

async function openScope() {
  const where = byId("where");
  const told = await asked(`${api}/open`, () => { where.textContent = "reading the recording, once \u2026"; });
  scope = new RunScope(byId("scope"), id, told, (seen, why) => {
    where.textContent = why;
    if (!seen) return;
    const span = seen.stop_s - seen.start_s, lost = seen.lost.reduce((sum, row) => sum + row[2], 0);
    const each = seen.samples_per_point === 1 ? "every sample" : `${shown(seen.samples_per_point, 3)} samples a column`;
    where.textContent = `${seen.start_s.toFixed(span < 1 ? 5 : 2)} s, ${shown(span, 4)} s long, ${each}${lost ? `, ${lost} lost` : ""}`;
    byId("scope").dataset.seen = `${seen.start_s} ${seen.stop_s} ${seen.samples_per_point}`;
  });
  scope.annotate(notes);
  new Events(scope, api, async () => { openDiagram(); verdicts((await ask(api)).loops); });
  why = new Why(scope, api);
  const at = Number(new URLSearchParams(location.search).get("at") ?? NaN);
  if (isFinite(at)) scope.look([at - 0.01, at + 0.09]);
  savers(document.querySelector(".scope .tools"), "scope", () => [scope.canvas], () => scope.table());
  byId("units").addEventListener("click", () => { scope.si = !scope.si; byId("units").textContent = scope.si ? "volts" : "SI units"; scope.changed(); });
  byId("in").addEventListener("click", () => scope.zoom(0.5));
  byId("out").addEventListener("click", () => scope.zoom(2));
  byId("all").addEventListener("click", () => scope.whole());
}

async function openDiagram() {
  const state = byId("diagram-state");
  const told = await asked(`${api}/flights`, () => { state.textContent = "finding the flights, once \u2026"; });
  state.textContent = told.steps.some((s) => s.flights) ? "" : "no flights were found";
  diagram ??= new Diagram(byId("diagram"), (run, at) => { scope?.look([at - 0.01, at + 0.09]); byId("scope").scrollIntoView({ block: "center" }); });
  diagram.runs = [];
  diagram.add("", told.steps, 0);
  document.querySelector("#steps tbody").replaceChildren(...told.steps.map((step) => {
    const row = make("tr", "", { tabindex: "0", title: "show it in the scope" });
    const gamma = step.gamma === null ? "-" : `${step.gamma.toFixed(4)} \u00b1 ${shown(step.gamma_uncertainty, 1)}`;
    for (const text of [step.step, step.start_s.toFixed(2), step.length_s.toFixed(2), shown(step.commanded, 5), gamma]) {
      row.append(make("td", text, { class: "number" }));
    }
    row.append(make("td", step.motion), make("td", step.flights, { class: "number" }), make("td", step.double_hits, { class: "number" }));
    const show = () => { scope?.showStep(step.step); byId("scope").scrollIntoView({ block: "center" }); };
    row.addEventListener("click", show);
    row.addEventListener("keydown", (event) => { if (event.key === "Enter") show(); });
    return row;
  }));
}

const told = await ask(api);
facts(told.run);
verdicts(told.loops);
remarks({ tags: told.run.tags, notes: told.notes });
if (told.run.remarks_problem) byId("refused").textContent = told.run.remarks_problem;
openScope().catch((error) => { byId("where").textContent = error.message; });
openDiagram().catch((error) => { byId("diagram-state").textContent = error.message; });
