// A scope: lanes one above the other over one time axis, with a cursor, a mark, and gestures that zoom and move.
// A subclass gives `traces()` (name, unit) and `columns(k)`: times (s), lows and highs of each column, or samples alone.
import { Axes, colours } from "./plot.js";

const COLOURS = ["c0", "c1", "c4", "c3", "c5", "c6"];
const minus = (text) => globalThis.desk.digits(text.replace("-", "\u2212"));

export class Scope {
  constructor(canvas) {
    this.canvas = canvas;
    this.axes = new Axes(canvas, { left: 62, top: 18, bottom: 32 });
    this.at = [0, 1]; // the stretch that is shown (s)
    this.cursor = this.marked = this.chosen = null; // times (s); a stretch that is being chosen
    this.dirty = true;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY / 240))), this.time(event));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    this.pointer();
  }

  // What a subclass may say differently.
  changed() { this.dirty = true; }
  under() {} // drawn in every lane below the signals
  over() { return []; } // drawn above them; words and their places (device px), put into the first lane
  keys() { return {}; }
  grab() { return null; } // what is dragged at a time: `move` and `drop` take its new time
  zero() { return null; } // time that the axis counts from
  range(k, low, high) { const margin = 0.06 * (high - low) || 0.1 * Math.abs(high) || 1; return [low - margin, high + margin]; }

  time(event) { return this.axes.at(event)[0]; }
  look(stretch) { this.at = stretch; this.changed(); }
  zoom(by, about = 0.5 * (this.at[0] + this.at[1])) { this.look([about - (about - this.at[0]) * by, about + (this.at[1] - about) * by]); }
  move(part) { const shift = part * (this.at[1] - this.at[0]); this.look([this.at[0] + shift, this.at[1] + shift]); }
  point(at) { if (at !== this.cursor) { this.cursor = at; this.changed(); } }
  // A second cursor that stays, from which times are measured; a click near it takes it away.
  mark(at) {
    const near = 0.02 * (this.at[1] - this.at[0]);
    this.marked = this.marked !== null && Math.abs(at - this.marked) < near ? null : at;
    this.changed();
  }

  // Drag moves, Shift and drag chooses a stretch, a click sets the mark.
  pointer() {
    const canvas = this.canvas;
    let down = null;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      down = { x: event.clientX, at: [...this.at], time: this.time(event), moved: false, held: this.grab(this.time(event)) };
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!down) { this.point(this.time(event)); return; }
      down.moved ||= Math.abs(event.clientX - down.x) > 3;
      if (!down.moved) return;
      if (down.held) { down.held.move(this.time(event)); this.changed(); return; }
      if (event.shiftKey) { this.chosen = [down.time, this.time(event)].sort((a, b) => a - b); this.changed(); return; }
      const shift = ((event.clientX - down.x) * this.axes.scale / this.axes.width) * (down.at[1] - down.at[0]);
      this.look([down.at[0] - shift, down.at[1] - shift]);
    });
    const up = (event) => {
      if (!down) return;
      if (down.held && down.moved) down.held.drop(this.time(event));
      else if (this.chosen) this.look(this.chosen);
      else if (!down.moved) this.mark(down.time);
      down = this.chosen = null;
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointerleave", () => { if (!down) this.point(null); });
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const [a, b] = this.at, step = 0.01 * (b - a), here = this.cursor ?? 0.5 * (a + b);
    const does = {
      "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2), ArrowLeft: () => this.move(-0.2),
      ArrowRight: () => this.move(0.2), ",": () => this.point(here - step), ".": () => this.point(here + step),
      m: () => this.mark(here), Home: () => this.whole(), ...this.keys(),
    }[event.key];
    if (!does) return;
    event.preventDefault();
    does();
  }

  // Draw where something changed; whether it did.
  paint() {
    const axes = this.axes;
    if (!axes.fit() && !this.dirty) return false;
    this.dirty = false;
    axes.clear();
    const traces = this.traces();
    if (!traces.length) {
      axes.pen.fillStyle = colours().faint;
      axes.pen.font = `${axes.font * axes.scale}px sans-serif`;
      axes.pen.fillText("no samples yet", axes.left + 10, axes.top + 30 * axes.unit);
      return true;
    }
    const { top, height } = axes, gap = 1.6 * axes.font * axes.scale, each = (height - gap * (traces.length - 1)) / traces.length;
    traces.forEach((trace, k) => {
      axes.top = top + k * (each + gap);
      axes.height = each;
      this.lane(trace, k, k === traces.length - 1);
    });
    axes.top = top;
    axes.height = height;
    return true;
  }

  lane(trace, k, last) {
    const axes = this.axes, pen = axes.pen, c = colours(), [a, b] = this.at, tone = c[COLOURS[k % COLOURS.length]];
    const { t, low, high } = this.columns(k);
    let least = Infinity, most = -Infinity;
    for (const x of low) if (x < least) least = x;
    for (const x of high ?? low) if (x > most) most = x;
    axes.ylim = isFinite(least) ? this.range(k, least, most) : [0, 1];
    const zero = this.zero(), short = b - a < 0.5, unit = short ? 1e3 : 1, origin = zero ?? (short ? a : 0);
    const name = short ? "ms" : "s";
    axes.options.x = !last ? "" : zero !== null ? `time since take-off (${name})` : short ? `time (ms) from ${a.toFixed(5)} s` : "time (s)";
    axes.xlim = this.at;
    axes.inside(() => this.under(axes));
    axes.xlim = [(a - origin) * unit, (b - origin) * unit];
    axes.frame(last);
    axes.xlim = this.at;
    let labels = [];
    axes.inside(() => {
      if (high) axes.envelope(t, low, high, tone);
      else {
        this.pieces(t, low, tone);
        if (t.length < axes.width / (3 * axes.unit)) axes.dots(t, low, tone, 4);
      }
      labels = this.over(axes);
      for (const [at, style] of [[this.cursor, c.ink], [this.marked, c.event]]) if (at !== null) axes.line([at, at], axes.ylim, style, 1);
      if (this.chosen) { pen.fillStyle = c.band; pen.globalAlpha = 0.5; pen.fillRect(axes.px(this.chosen[0]), axes.top, axes.px(this.chosen[1]) - axes.px(this.chosen[0]), axes.height); pen.globalAlpha = 1; }
      if (k === 0) for (const [words, x, below] of labels) if (below) this.words(words, x, axes.top + axes.height - 20 * axes.unit);
    });
    // the name stands above its lane, where it hides no signal; behind it the value at the cursor
    pen.font = `bold ${axes.font * axes.scale}px sans-serif`;
    pen.fillStyle = tone;
    pen.fillRect(axes.left, axes.top - 11 * axes.unit, 8 * axes.unit, 8 * axes.unit);
    pen.fillStyle = c.ink; pen.textAlign = "left"; pen.textBaseline = "bottom";
    const own = `${trace.name} (${trace.unit})${this.value(t, low, high)}`, y = axes.top - (axes.font + 6) * axes.scale;
    pen.fillText(own, axes.left + 12 * axes.unit, axes.top - 2 * axes.unit);
    if (k > 0) return;
    // to the right of it names of steps, where there is room, and what the cursor says
    const said = this.between(), free = axes.left + 24 * axes.unit + pen.measureText(own).width;
    const end = axes.left + axes.width - (said ? pen.measureText(said).width + 12 * axes.unit : 0);
    for (const [words, x, below] of labels) if (!below && x > free && x + pen.measureText(words).width < end) this.words(words, x, y);
    if (said) this.words(said, axes.left + axes.width - pen.measureText(said).width, y);
  }

  // Words on a patch of paper, legible over any curve.
  words(text, x, y) {
    const words = globalThis.desk.say(text);
    const axes = this.axes, pen = axes.pen, c = colours(), room = 3 * axes.unit;
    pen.fillStyle = c.paper;
    pen.fillRect(x - room, y, pen.measureText(words).width + 2 * room, (axes.font + 4) * axes.scale);
    pen.fillStyle = c.ink; pen.textAlign = "left"; pen.textBaseline = "top";
    pen.fillText(words, x, y + 2 * axes.scale);
  }

  // A line through samples that is broken where some are missing.
  pieces(t, values, style) {
    const xs = [], ys = [];
    let longest = Infinity; // one and a half times the time between two samples
    for (let i = 1; i < t.length; i++) longest = Math.min(longest, 1.5 * (t[i] - t[i - 1]));
    for (let i = 0; i < t.length; i++) {
      if (i && t[i] - t[i - 1] > longest) { xs.push(t[i]); ys.push(NaN); }
      xs.push(t[i]); ys.push(values[i]);
    }
    this.axes.line(xs, ys, style, 1.4);
  }

  value(t, low, high) {
    if (this.cursor === null || !t.length || this.cursor < t[0]) return "";
    let i = 0;
    while (i + 1 < t.length && t[i + 1] <= this.cursor) i++;
    const value = high ? 0.5 * (low[i] + high[i]) : low[i];
    return isFinite(value) ? `  ${minus(value.toPrecision(4))}` : "  not known";
  }

  // Time at the cursor, and from the mark to it.
  between() {
    if (this.cursor === null && this.marked === null) return "";
    const at = this.cursor ?? this.marked, ms = 1e3 * (at - this.marked);
    const since = this.marked === null ? "" : `, ${ms.toFixed(3)} ms from the mark${ms ? ` (${Math.abs(1e3 / ms).toPrecision(4)} Hz)` : ""}`;
    return minus(`${at.toFixed(5)} s${since}`);
  }
}
