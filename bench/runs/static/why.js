// Why? From a number of the verdict to its rivals, its steps, the residuals of a step, one flight, its two edges, its volts.
import { Axes, colours } from "/static/web/plot.js";
import { savers } from "/static/web/save.js";
import { asked, make, shown } from "./common.js";

const byId = (name) => document.getElementById(name);
const MODELS = ["declared", "improved"];
const us = (x) => (x === null || x === undefined ? "-" : `${shown(x, 3)}`);

// A table of texts; `open(i)` is called for a row that is chosen by click or Enter.
function fill(table, rows, open = null) {
  table.tBodies[0].replaceChildren(...rows.map((texts, i) => {
    const line = make("tr");
    texts.forEach((text, k) => {
      const cell = make("td", "", k && /^[-\u2212\d.]/.test(text) ? { class: "number" } : {});
      if (open && k === 0) {
        const button = make("button", text, { type: "button", class: "quiet" });
        button.addEventListener("click", () => open(i));
        cell.append(button);
      } else cell.textContent = text;
      cell.translate = k > 0 || table.id !== "rivals"; // a rival's name is data
      line.append(cell);
    });
    return line;
  }));
}

export class Why {
  constructor(scope, api) {
    Object.assign(this, { scope, api, step: null, flight: null });
    this.axes = new Axes(byId("residuals"), { x: "take-off (s)", y: "landing residual (\u00b5s)" });
    new ResizeObserver(() => { this.axes.fit(); this.paint(); }).observe(byId("residuals").parentElement);
    addEventListener("themechange", () => this.paint());
    for (const name of ["measured", ...MODELS]) byId(`layer-${name}`).addEventListener("change", () => { this.paint(); scope.changed(); });
    byId("layer-rivals").addEventListener("change", () => { byId("rivals").closest(".scroll").hidden = !byId("layer-rivals").checked; });
    byId("residuals").addEventListener("click", (event) => this.choose(this.nearest(this.axes.at(event))));
    savers(byId("residuals-head"), "residuals", () => [byId("residuals")], () => this.table());
    scope.why = this;
  }

  // What a number of the verdict opens: steps for an error, rivals for a name.
  async open(what) {
    const part = byId("why-part");
    part.open = true;
    try {
      const told = await asked(`${this.api}/why`, () => { byId("why-state").textContent = "reading the saved verdict \u2026"; });
      byId("why-state").textContent = "";
      this.steps = told.steps;
      fill(byId("rivals"), told.rivals.map((r) => [r.names.join(", "), r.gain === null ? "-" : `${shown(r.gain, 3)} \u00b1 ${us(r.error)}`, r.outcome]));
      fill(byId("why-steps"), told.steps.map((s) => [`step ${s.step}${s.held_out ? " (held out)" : ""}`, s.gamma.toFixed(4), String(s.flights), us(s.declared_us), us(s.improved_us)]),
        (i) => this.openStep(told.steps[i].step));
      byId(what === "rivals" ? "rivals" : "why-steps").scrollIntoView({ block: "nearest" });
      byId("why-part").dataset.done = what;
    } catch (error) {
      byId("why-state").textContent = error.message;
    }
  }

  async openStep(number) {
    this.step = await asked(`${this.api}/why?step=${number}`);
    this.number = number;
    this.flight = null;
    byId("residuals-part").hidden = false;
    byId("residuals-title").textContent = `Residuals of step ${number}: ${this.step.shown_s.length} flights`;
    fill(byId("why-flights"), this.step.shown_s.map((t, i) => [`${t.toFixed(5)} s`, ...MODELS.map((m) => us(this.step[`${m}_us`][i])), us(this.step.improved_sigma_us[i])]), (i) => this.choose(i));
    this.axes.fit();
    this.paint();
  }

  // One residual: its two edges, measured and predicted, and the samples round them in the scope.
  choose(i) {
    if (i === null) return;
    const s = this.step, length = s.landing_s[i] - s.takeoff_s[i], t = s.shown_s[i];
    this.flight = { t, length, marks: [] };
    const lines = [];
    for (const [edge, key] of [["take-off", "takeoff"], ["landing", "landing"]]) {
      const measured = s[`${key}_s`][i], at = key === "takeoff" ? t : t + length;
      this.flight.marks.push(["measured", at]);
      const said = MODELS.map((m) => {
        const own = s[`${m}_${key}_s`][i], left = key === "takeoff" ? s[`${m}_takeoff_us`][i] : s[`${m}_us`][i];
        if (own === null) return `${m}: none`;
        this.flight.marks.push([m, at + own - measured]);
        return `${m} ${own.toFixed(6)} s (residual ${us(left)} \u00b5s)`;
      });
      lines.push([`${edge} measured ${measured.toFixed(6)} s`, ...said].join(" \u00b7 "));
    }
    byId("edges").replaceChildren(...lines.map((line) => make("li", line)));
    byId("edges").dataset.flight = t;
    const margin = Math.max(0.002, 0.15 * length);
    this.scope.look([t - margin, t + length + margin]);
    this.scope.canvas.scrollIntoView({ block: "nearest" });
    this.paint();
  }

  nearest([x, y]) {
    if (!this.step) return null;
    const { xlim, ylim } = this.axes, s = this.step;
    let best = null, least = 0.03 ** 2;
    s.shown_s.forEach((t, i) => {
      for (const m of MODELS) {
        if (!byId(`layer-${m}`).checked || s[`${m}_us`][i] === null) continue;
        const d = ((t - x) / (xlim[1] - xlim[0])) ** 2 + ((s[`${m}_us`][i] - y) / (ylim[1] - ylim[0])) ** 2;
        if (d < least) { least = d; best = i; }
      }
    });
    return best;
  }

  table() {
    const s = this.step;
    return [["take-off (s)", ...MODELS.flatMap((m) => [`${m} residual (us)`, `${m} uncertainty (us)`])],
      ...(s ? s.shown_s.map((t, i) => [t, ...MODELS.flatMap((m) => [s[`${m}_us`][i], s[`${m}_sigma_us`][i]])]) : [])];
  }

  paint() {
    const axes = this.axes, s = this.step, c = colours();
    axes.clear();
    if (!s?.shown_s.length) return;
    const seen = MODELS.filter((m) => byId(`layer-${m}`).checked);
    const ys = seen.flatMap((m) => s[`${m}_us`]).filter((y) => y !== null), most = Math.max(1, ...ys.map(Math.abs)), xs = s.shown_s;
    axes.xlim = [xs[0] - 0.05, xs[xs.length - 1] + 0.05];
    axes.ylim = [-1.1 * most, 1.1 * most];
    axes.frame();
    axes.inside(() => {
      if (byId("layer-measured").checked) axes.envelope(xs, s.improved_sigma_us.map((x) => (x === null ? NaN : -x)), s.improved_sigma_us.map((x) => x ?? NaN), c.floor);
      for (const m of seen) axes.dots(xs, s[`${m}_us`].map((y) => y ?? NaN), m === "declared" ? c.bad : c.model, 4);
      if (this.flight) axes.line([this.flight.t, this.flight.t], axes.ylim, c.event, 1);
    });
  }

  // Edges of the chosen flight in the scope: measured, and where each model put them.
  draw(axes) {
    if (!this.flight) return;
    const c = colours(), style = { measured: c.ink, declared: c.bad, improved: c.model };
    for (const [layer, t] of this.flight.marks) if (byId(`layer-${layer}`).checked) axes.line([t, t], axes.ylim, style[layer], 1.2);
  }
}
