// The table of runs: filtered and sorted by the server, the query kept in the address.
import { ask, day, gammas, make } from "./common.js";

const columns = [
  ["date", "date (UTC)"], ["name", "file"], ["profile", "profile"], ["c", "c"], ["gamma", "gamma"], ["steps", "steps"],
  ["lost", "lost"], ["ended", "ended"], ["verdict", "verdict"], ["note", "note"], ["tags", "tags"],
];
const numeric = new Set(["c", "gamma", "steps", "lost"]);
const form = document.getElementById("filter"), body = document.querySelector("#runs tbody");
const head = document.querySelector("#runs thead tr"), overlay = document.getElementById("overlay");
const marked = new Set();
let sort = "-date", newest = 0;

for (const [key, words] of columns) {
  const cell = make("th", "", numeric.has(key) ? { class: "number" } : {});
  const button = make("button", words, { type: "button", title: `sort by ${words}` });
  button.addEventListener("click", () => {
    sort = sort === key ? `-${key}` : sort === `-${key}` ? key : key === "date" ? "-date" : key;
    load();
  });
  cell.append(button);
  cell.dataset.key = key;
  head.append(cell);
}

function query() {
  const given = new URLSearchParams();
  for (const [key, value] of new FormData(form)) if (value !== "") given.set(key, value);
  if (sort !== "-date") given.set("sort", sort);
  return given;
}

function row(run) {
  const line = make("tr", "", { tabindex: "0" });
  line.dataset.id = run.id;
  const box = make("input", "", { type: "checkbox", "aria-label": run.path, translate: "no" });
  box.checked = marked.has(run.id);
  box.addEventListener("change", () => {
    if (box.checked) marked.add(run.id); else marked.delete(run.id);
    count();
  });
  const first = make("td");
  first.append(box);
  line.append(first, make("td", day(run.date), { class: "tight" }));
  const name = make("td", "", { translate: "no" });
  name.append(make("a", run.path, { href: `/runs/${run.id}` }));
  line.append(name);
  const profile = make("td");
  profile.append(make("span", run.profile ?? "-", { translate: "no" }));
  if (run.simulated) profile.append(" ", make("span", "(simulated)", { class: "faint" }));
  line.append(profile, make("td", run.c ?? "-", { class: "number" }), make("td", gammas(run), { class: "number" }));
  line.append(make("td", run.steps, { class: "number" }), make("td", run.lost_samples ?? "-", { class: "number" }));
  const ended = make("td", run.ended, run.ended === "complete" ? {} : { class: run.ended === "stopped" ? "warn" : "bad" });
  if (run.why) ended.append(make("div", run.why, { class: "faint", translate: "no" }));
  line.append(ended, make("td", run.loop?.summary ?? "-", { translate: "no" }), make("td", run.notes, { class: "lines", translate: "no" }));
  const tags = make("td", "", { translate: "no" });
  for (const tag of run.tags) tags.append(make("span", tag, { class: "tag" }));
  if (run.remarks_problem) tags.append(make("span", run.remarks_problem, { class: "bad" }));
  line.append(tags);
  const open = () => { location.href = `/runs/${run.id}`; };
  line.addEventListener("click", (event) => { if (!event.target.closest("a, input") && !String(getSelection())) open(); });
  line.addEventListener("keydown", (event) => {
    if (event.target !== line) return;
    if (event.key === "Enter") open();
    else if (event.key === " ") { event.preventDefault(); box.click(); }
    else if (event.key === "ArrowDown") { event.preventDefault(); line.nextElementSibling?.focus(); }
    else if (event.key === "ArrowUp") { event.preventDefault(); line.previousElementSibling?.focus(); }
  });
  return line;
}

let shownRuns = 0;
function count() {
  document.getElementById("count").textContent = `${shownRuns} run${shownRuns === 1 ? "" : "s"}${marked.size ? `, ${marked.size} marked` : ""}`;
  overlay.disabled = marked.size < 1;
}
overlay.addEventListener("click", () => { location.href = `/runs/compare?ids=${[...marked].join(",")}`; });

function options(id, values) {
  document.getElementById(id).replaceChildren(...values.map((value) => make("option", "", { value })));
}

async function load() {
  const mine = ++newest, given = query();
  history.replaceState(null, "", given.size ? `?${given}` : location.pathname);
  for (const cell of head.querySelectorAll("[data-key]")) {
    if (sort.replace("-", "") === cell.dataset.key) cell.setAttribute("aria-sort", sort.startsWith("-") ? "descending" : "ascending");
    else cell.removeAttribute("aria-sort");
  }
  given.set("sort", sort);
  const said = document.getElementById("said");
  try {
    const told = await ask(`/runs/api/list?${given}`);
    if (mine !== newest) return;
    said.textContent = told.said ?? "";
    said.hidden = !told.said;
    body.replaceChildren(...told.runs.map(row));
    shownRuns = told.runs.length;
    document.getElementById("none").hidden = shownRuns > 0;
    options("profiles", told.profiles);
    options("tags", told.tags);
    count();
  } catch (error) {
    if (mine !== newest) return;
    said.textContent = error.message;
    said.hidden = false;
  }
}

let soon;
form.addEventListener("input", () => { clearTimeout(soon); soon = setTimeout(load, 200); });
form.addEventListener("reset", () => { clearTimeout(soon); soon = setTimeout(load, 0); });
form.addEventListener("submit", (event) => { event.preventDefault(); load(); });

const given = new URLSearchParams(location.search);
for (const [key, value] of given) {
  const field = form.elements[key];
  if (field?.type === "checkbox") field.checked = value === "1"; else if (field) field.value = value;
}
sort = given.get("sort") ?? sort;
load();
