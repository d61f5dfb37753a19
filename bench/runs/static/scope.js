// The scope over a whole recording: the server sends extremes by column, or the samples where there are few.
import { colours } from "/static/web/plot.js";
import { Scope } from "/static/web/scope.js";
import { ask } from "./common.js";

export class RunScope extends Scope {
  // `facts`: length, rate, channels and steps of the run; `says` is called with each view that comes, or a refusal
  constructor(canvas, id, facts, says) {
    canvas.style.height = `${9.2 * facts.channels.length + 2}rem`;
    super(canvas);
    Object.assign(this, { id, facts, says, si: false, seen: null, asking: false, notes: [], at: [0, facts.duration_s] });
    new ResizeObserver(() => { if (this.axes.fit()) this.ask(); this.changed(); }).observe(canvas);
    addEventListener("themechange", () => this.changed());
    this.ask();
  }

  changed() {
    this.dirty = true;
    this.frame ??= requestAnimationFrame(() => { this.frame = undefined; this.paint(); });
  }

  // Show the stretch [a, b], cut to the recording.
  look([a, b]) {
    const all = this.facts.duration_s, span = Math.min(Math.max(b - a, 4 / this.facts.rate_hz), all);
    const start = Math.min(Math.max(span === b - a ? a : 0.5 * (a + b - span), 0), all - span);
    super.look([start, start + span]);
    this.ask();
  }
  whole() { this.look([0, this.facts.duration_s]); }

  // Ask for what is shown; one question at a time, the latest wish next.
  async ask() {
    if (this.asking) { this.again = true; return; }
    const width = Math.min(8192, Math.max(16, Math.round(this.axes.width))), [a, b] = this.at;
    this.asking = true;
    try {
      this.seen = await ask(`/runs/api/${this.id}/view?start_s=${a}&stop_s=${b}&width=${width}`);
      this.says(this.seen, "");
      this.events?.look();
      this.changed();
    } catch (error) {
      this.says(null, error.message);
    }
    this.asking = false;
    if (this.again) { this.again = false; this.ask(); }
  }

  traces() { return this.seen ? this.facts.channels.map((x) => ({ name: x.name, unit: this.si && x.si_unit ? x.si_unit : "V" })) : []; }

  columns(k) {
    const channel = this.facts.channels[k], seen = this.seen.channels[channel.name], si = this.si && channel.si_per_volt !== null;
    const scaled = (values) => values?.map((v) => (v === null ? NaN : si ? (v - channel.zero_v) * channel.si_per_volt : v));
    const low = scaled(seen.low), high = scaled(seen.high) ?? null;
    return { t: this.seen.time_s, ...(si && channel.si_per_volt < 0 && high ? { low: high, high: low } : { low, high }) };
  }

  // Shaded: samples that were lost.
  under(axes) {
    axes.pen.fillStyle = colours().zone;
    for (const [a, b] of this.seen.lost) axes.pen.fillRect(axes.px(a), axes.top, Math.max(2 * axes.unit, axes.px(b) - axes.px(a)), axes.height);
  }

  // Beginnings of steps, and notes that were typed during the run, each at its time.
  over(axes) {
    const pen = axes.pen, labels = [], shown = (t) => t >= this.at[0] && t <= this.at[1];
    const line = (t) => { const x = axes.px(t); pen.beginPath(); pen.moveTo(x, axes.top); pen.lineTo(x, axes.top + axes.height); pen.stroke(); return x; };
    pen.strokeStyle = colours().faint;
    pen.setLineDash([3 * axes.unit, 3 * axes.unit]);
    let free = -Infinity;
    this.facts.steps.forEach((step, k) => {
      if (!shown(step.start_s)) return;
      const x = line(step.start_s);
      if (x < free) return;
      labels.push([`step ${k}`, x + 5 * axes.unit, false]);
      free = x + pen.measureText(`step ${k}`).width + 16 * axes.unit;
    });
    pen.setLineDash([]);
    pen.strokeStyle = colours().event;
    for (const note of this.notes) {
      if (shown(note.at_s)) labels.push([note.text.length > 28 ? `${note.text.slice(0, 27)}\u2026` : note.text, line(note.at_s) + 5 * axes.unit, true]);
    }
    this.events?.draw(axes, colours().ink);
    this.why?.draw(axes);
    return labels;
  }
  grab(t) {
    const event = this.events?.near(t, (8 * this.axes.unit / this.axes.width) * (this.at[1] - this.at[0]));
    return event && { move: (at) => { event.moving = at; }, drop: (at) => this.events.drop(event, at) };
  }
  mark(at) {
    super.mark(at);
    if (this.marked !== null) document.getElementById("event-at").value = this.marked.toFixed(6);
  }
  annotate(notes) {
    this.notes = notes.filter((note) => note.at_s !== null);
    this.canvas.dataset.notes = this.notes.length;
    this.changed();
  }

  // What is shown, in volts: extremes of each column, or the samples.
  table() {
    const names = Object.keys(this.seen.channels), all = names.map((name) => this.seen.channels[name]);
    const heads = names.flatMap((name, k) => (all[k].high ? [`${name} lowest (V)`, `${name} highest (V)`] : [`${name} (V)`]));
    return [["time (s)", ...heads], ...this.seen.time_s.map((t, i) => [t, ...all.flatMap((x) => (x.high ? [x.low[i], x.high[i]] : [x.low[i]]))])];
  }

  keys() { return { PageDown: () => this.step(1), PageUp: () => this.step(-1), u: () => document.getElementById("units").click() }; }
  // The step after or before the one that begins at the left edge.
  step(by) {
    const starts = this.facts.steps.map((s) => s.start_s), slack = 1e-6 + 0.01 * (this.at[1] - this.at[0]);
    const k = by > 0 ? starts.findIndex((s) => s > this.at[0] + slack) : starts.findLastIndex((s) => s < this.at[0] - slack);
    if (k >= 0) this.showStep(k);
  }
  showStep(k) {
    const step = this.facts.steps[k];
    if (step) this.look([step.start_s, step.start_s + step.length_s]);
  }
}
