// Diagrams: flight times, in periods of the forcing, over the gamma of their step; one colour a run.
import { Axes, colours } from "/static/web/plot.js";
import { savers } from "/static/web/save.js";

export class Diagram {
  // `chosen` is called with the run and the time (s) of a flight whose dot is clicked
  constructor(canvas, chosen) {
    this.axes = new Axes(canvas, { x: "gamma = A\u03c9\u00b2/g (dimensionless)", y: "flight time (periods)" });
    this.runs = [];
    new ResizeObserver(() => { this.axes.fit(); this.paint(); }).observe(canvas.parentElement);
    addEventListener("themechange", () => this.paint());
    canvas.title = "click a flight to see its samples";
    canvas.addEventListener("click", (event) => {
      const found = this.nearest(this.axes.at(event));
      if (found) chosen(found.run, found.at);
    });
    savers(canvas.closest("section").querySelector("h2"), "diagram", () => [canvas], () => this.table());
  }

  table() {
    const rows = [["run", "step", "gamma set", "gamma measured", "flight time (periods)"]];
    for (const { name, steps } of this.runs) for (const step of steps) for (const y of step.periods) rows.push([name, step.step, step.commanded, step.gamma, y]);
    return rows;
  }

  // The flight whose dot is nearest to a place, within a fortieth of the axes.
  nearest([x, y]) {
    const { xlim, ylim } = this.axes;
    let found = null, least = 0.025 ** 2;
    for (const run of this.runs) for (const step of run.steps) {
      const aside = (((step.gamma ?? step.commanded) - x) / (xlim[1] - xlim[0])) ** 2;
      if (aside < least) step.periods.forEach((period, i) => {
        const d = aside + ((period - y) / (ylim[1] - ylim[0])) ** 2;
        if (d < least) { least = d; found = { run, at: step.shown_s[i] }; }
      });
    }
    return found;
  }

  // One run: its steps with flights, its name, the number of its colour.
  add(name, steps, colour) {
    this.runs.push({ name, steps, colour });
    this.paint();
  }

  paint() {
    const axes = this.axes, xs = [], ys = [];
    for (const run of this.runs) for (const step of run.steps) {
      const gamma = step.gamma ?? step.commanded;
      if (gamma !== null && step.periods.length) { xs.push(gamma); for (const y of step.periods) ys.push(y); }
    }
    axes.clear();
    if (xs.length) {
      let least = Infinity, most = -Infinity, top = 0;
      for (const x of xs) { least = Math.min(least, x); most = Math.max(most, x); }
      for (const y of ys) top = Math.max(top, y);
      const margin = 0.05 * (most - least) || 0.05;
      axes.xlim = [least - margin, most + margin];
      axes.ylim = [0, 1.08 * top];
    }
    axes.frame();
    const c = colours();
    axes.inside((pen) => {
      this.runs.forEach((run, k) => {
        for (const step of run.steps) {
          const gamma = step.gamma ?? step.commanded;
          if (gamma !== null) axes.dots(step.periods.map(() => gamma), step.periods, c[`c${run.colour % 7}`], 3);
        }
        if (this.runs.length < 2) return;
        const x = axes.left + 10 * axes.unit, y = axes.top + (12 + 16 * k) * axes.unit;
        pen.fillStyle = c[`c${run.colour % 7}`];
        pen.fillRect(x, y - 4 * axes.unit, 8 * axes.unit, 8 * axes.unit);
        pen.fillStyle = c.ink; pen.textAlign = "left"; pen.textBaseline = "middle";
        pen.fillText(run.name, x + 14 * axes.unit, y);
      });
    });
  }
}
