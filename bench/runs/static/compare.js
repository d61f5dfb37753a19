// Runs over each other: diagrams, verdicts, and calibrations over time.
import { Axes, colours } from "/static/web/plot.js";
import { savers } from "/static/web/save.js";
import { ask, asked, day, make, shown } from "./common.js";
import { Diagram } from "./diagram.js";

const ids = document.getElementById("compare").dataset.ids.split(",").filter(Boolean);
const byId = (name) => document.getElementById(name);

async function runs() {
  const told = await Promise.all(ids.map((id) => ask(`/runs/api/${id}`)));
  byId("verdicts").tBodies[0].replaceChildren(...told.map(({ run }, k) => {
    const line = make("tr"), key = make("td"), name = make("td", "", { translate: "no" });
    key.append(make("span", "", { class: `key k${k % 7}` }));
    name.append(make("a", run.path, { href: `/runs/${run.id}` }));
    line.append(key, name, make("td", day(run.date)), make("td", run.loop?.summary ?? "-", { translate: "no" }));
    for (const value of [run.loop?.before_us, run.loop?.after_us, run.loop?.floor_us]) line.append(make("td", shown(value, 3), { class: "number" }));
    line.append(make("td", run.notes, { class: "lines", translate: "no" }));
    return line;
  }));
  const open = (run, at) => { location.href = `/runs/${ids[run.colour]}?at=${at}`; };
  const diagram = new Diagram(byId("diagram"), open), state = byId("diagram-state");
  const failed = [];
  for (const [k, { run }] of told.entries()) {
    try {
      const { steps } = await asked(`/runs/api/${run.id}/flights`, () => { state.textContent = "finding the flights, once \u2026"; });
      diagram.add(run.path, steps, k);
    } catch (error) {
      failed.push(`${run.path}: ${error.message}`);
    }
  }
  state.textContent = failed.join("; ");
  state.dataset.done = "1";
}

// One quantity over the dates of the runs.
class Drift {
  constructor(place, name, rows) {
    const figure = make("div", "", { class: "picture" }), canvas = make("canvas");
    figure.append(canvas);
    place.append(figure);
    this.rows = rows;
    const unit = rows[0].unit || "dimensionless";
    this.axes = new Axes(canvas, { x: "", y: unit, title: name, left: 70, bottom: 24 });
    new ResizeObserver(() => { this.axes.fit(); this.paint(); }).observe(figure);
    addEventListener("themechange", () => this.paint());
    savers(figure, name, () => [canvas], () => [["run", "date", `${name} (${unit})`, "sigma", "origin"],
      ...rows.map((row) => [row.path, row.date, row.value, row.sigma, row.origin])]);
  }

  paint() {
    const axes = this.axes, c = colours();
    const at = this.rows.map((row) => Date.parse(row.date) / 86400000);
    const least = Math.min(...at), most = Math.max(...at), side = 0.06 * (most - least) || 0.5;
    const low = Math.min(...this.rows.map((r) => r.value - (r.sigma ?? 0))), high = Math.max(...this.rows.map((r) => r.value + (r.sigma ?? 0)));
    const margin = 0.12 * (high - low) || 0.05 * Math.abs(high) || 1;
    axes.xlim = [least - side, most + side];
    axes.ylim = [low - margin, high + margin];
    axes.clear();
    this.frame(axes);
    axes.inside((pen) => this.rows.forEach((row, i) => {
      const place = ids.indexOf(row.id), style = place < 0 ? c.faint : c[`c${place % 7}`];
      const x = axes.px(at[i]), y = axes.py(row.value), r = 3.5 * axes.unit;
      pen.strokeStyle = style; pen.fillStyle = style; pen.lineWidth = 1.3 * axes.unit;
      if (row.sigma) {
        pen.beginPath(); pen.moveTo(x, axes.py(row.value - row.sigma)); pen.lineTo(x, axes.py(row.value + row.sigma)); pen.stroke();
      }
      pen.beginPath();
      if (row.origin === "profile") { pen.rect(x - r, y - r, 2 * r, 2 * r); pen.stroke(); }
      else { pen.arc(x, y, r, 0, 7); pen.fill(); }
    }));
  }

  // The frame with dates in place of numbers.
  frame(axes) {
    const pen = axes.pen, c = colours(), [a, b] = axes.xlim;
    axes.xlim = [0, 0]; // no numbers below
    axes.frame();
    axes.xlim = [a, b];
    pen.fillStyle = c.ink; pen.textBaseline = "top";
    const days = b - a, labels = 4;
    for (let k = 0; k < labels; k++) {
      const x = a + (days * (k + 0.5)) / labels, date = new Date(x * 86400000).toISOString();
      pen.textAlign = "center";
      pen.fillText(days < 0.05 ? date.slice(11, 19) : days < 3 ? date.slice(5, 16).replace("T", " ") : date.slice(0, 10), axes.px(x), axes.top + axes.height + 4 * axes.unit);
    }
  }
}

// What drifts on a bench comes first.
const ranks = [/^accelerometer\.sensitivity/, /friction|damping|drag/, /restitution/, /^drive\./];
const rank = (name) => { const k = ranks.findIndex((one) => one.test(name)); return k < 0 ? ranks.length : k; };

async function drifts() {
  const place = byId("drifts"), every = byId("every").checked || !ids.length;
  const { quantities } = await ask(`/runs/api/quantities${every ? "" : `?ids=${ids.join(",")}`}`);
  const named = Map.groupBy ? Map.groupBy(quantities, (q) => q.name) : quantities.reduce((m, q) => m.set(q.name, [...(m.get(q.name) ?? []), q]), new Map());
  const others = byId("others");
  place.replaceChildren();
  others.replaceChildren();
  const first = [...named].filter(([name]) => rank(name) < ranks.length).sort((a, b) => rank(a[0]) - rank(b[0]));
  for (const [name, rows] of first) new Drift(place, name, rows);
  for (const [name, rows] of named) if (rank(name) === ranks.length) new Drift(others, name, rows);
  others.parentElement.hidden = !others.childElementCount;
  if (!named.size) place.append(make("p", "No profile or verdict of these runs states one.", { class: "faint" }));
  place.dataset.done = [...named.keys()].join(" ");
}

const problem = (error) => { byId("problem").textContent = error.message; byId("problem").hidden = false; };
byId("every").addEventListener("change", () => drifts().catch(problem));
runs().catch(problem);
drifts().catch(problem);
