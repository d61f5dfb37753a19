// The scope: minima and maxima of every bin for the last seconds, any window of them drawn without losing a spike.
import { Axes, colours } from "/static/web/plot.js";

const KEPT_S = 12;
const UNKNOWN = -32768; // of a displacement that the accelerometer does not tell

export class Scope {
  constructor(canvas) {
    this.axes = new Axes(canvas, { x: "time (s)", left: 62, top: 18, bottom: 32 });
    this.canvas = canvas;
    this.names = []; this.spanS = 0.2; this.unit = "si"; this.onTakeoff = true;
    this.frozen = false; this.view = null; this.dirty = true; this.n = 0;
    this.clear();
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(event.deltaY > 0 ? 1.25 : 0.8, this.axes.at(event)[0]); }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => { this.from = this.axes.at(event)[0]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", (event) => {
      const to = this.axes.at(event)[0], from = this.from;
      this.from = undefined;
      if (from === undefined) return;
      if (Math.abs(to - from) > 0.01 * (this.axes.xlim[1] - this.axes.xlim[0])) this.look([Math.min(from, to), Math.max(from, to)]);
      else this.mark(to);
    });
    canvas.addEventListener("pointermove", (event) => { this.point(this.axes.at(event)[0]); });
    canvas.addEventListener("pointerleave", () => { this.point(null); });
    canvas.addEventListener("keydown", (event) => {
      const [a, b] = this.axes.xlim, shift = 0.2 * (b - a);
      if (event.key === "+") this.zoom(0.8, (a + b) / 2);
      else if (event.key === "-") this.zoom(1.25, (a + b) / 2);
      else if (event.key === "m") this.mark((this.cursor ?? (a + b) / 2));
      else if (event.key === "," || event.key === ".") this.point((this.cursor ?? (a + b) / 2) + (event.key === "." ? 1 : -1) * 0.01 * (b - a));
      else if (event.key === "ArrowLeft") this.look([a - shift, b - shift]);
      else if (event.key === "ArrowRight") this.look([a + shift, b + shift]);
      else return;
      event.preventDefault();
    });
  }

  clear() { this.size = 0; this.n = 0; this.end = 0; this.bin = 0; this.cursor = this.marked = null; this.dirty = true; }
  point(at) { if (at !== this.cursor) { this.cursor = at; this.dirty = true; } }
  // A second cursor that stays, from which times are measured; a click near it takes it away. The picture stands still.
  mark(at) {
    const near = 0.02 * (this.axes.xlim[1] - this.axes.xlim[0]);
    this.marked = this.marked !== null && Math.abs(at - this.marked) < near ? null : at;
    if (this.marked !== null && !this.frozen) this.look([...this.axes.xlim]);
    this.dirty = true;
  }
  stale() { this.dirty = true; }
  traces(list) { this.names = list; this.clear(); }
  span(seconds) { this.spanS = seconds; this.view = null; this.dirty = true; }
  units(name) { this.unit = name; this.dirty = true; }
  trigger(on) { this.onTakeoff = on; this.dirty = true; }
  freeze() { this.frozen = !this.frozen; if (!this.frozen) this.view = null; this.dirty = true; return this.frozen; }
  whole() { this.view = null; this.dirty = true; }
  zoom(by, at) {
    const [a, b] = this.axes.xlim;
    this.look([at - (at - a) * by, at + (b - at) * by]);
  }
  // Zooming freezes the picture: what is looked at stands still.
  look(view) {
    if (!this.frozen) document.getElementById("freeze").click();
    this.view = view;
    this.dirty = true;
  }

  // bins: [bin][min|max][trace]
  add(first, bin, traces, bins) {
    if (this.frozen) return;
    const n = bins.length / (2 * traces);
    if (bin !== this.bin || traces !== this.nTraces) {
      this.bin = bin; this.nTraces = traces; this.size = Math.ceil(KEPT_S / bin); this.n = 0;
      this.low = Array.from({ length: traces }, () => new Int16Array(this.size));
      this.high = Array.from({ length: traces }, () => new Int16Array(this.size));
    }
    if (this.n && Math.abs(first - this.end) > 1.5 * bin) this.n = 0; // samples are missing: begin anew
    for (let i = 0; i < n; i++) {
      const at = (this.n + i) % this.size, from = i * 2 * traces;
      for (let k = 0; k < traces; k++) { this.low[k][at] = bins[from + k]; this.high[k][at] = bins[from + traces + k]; }
    }
    this.n += n;
    this.end = first + n * bin;
    this.dirty = true;
  }

  // The last take-off that leaves most of the window after it, in bins counted from the first ever.
  takeoff(bins) {
    const contact = this.names.findIndex((t) => t.name === "continuity");
    if (contact < 0) return -1;
    const low = this.low[contact], high = this.high[contact];
    let least = Infinity, most = -Infinity;
    const oldest = Math.max(0, this.n - Math.min(this.size, Math.max(2 * bins, Math.round(0.5 / this.bin))));
    for (let i = oldest; i < this.n; i++) { const at = i % this.size; least = Math.min(least, low[at]); most = Math.max(most, high[at]); }
    if (most - least < 200) return -1; // the ball rests
    const si = this.names[contact].si, up = si.scale > 0, middle = (least + most) / 2;
    for (let i = this.n - Math.round(0.8 * bins); i > oldest; i--) {
      const now = up ? low[i % this.size] > middle : high[i % this.size] < middle;
      const before = up ? high[(i - 1) % this.size] < middle : low[(i - 1) % this.size] > middle;
      if (now && before) return i;
    }
    return -1;
  }

  paint() {
    const moved = this.axes.fit();
    if (!this.dirty && !moved) return false;
    this.dirty = false;
    const axes = this.axes, pen = axes.pen, c = colours();
    axes.clear();
    if (!this.size || !this.n) {
      axes.xlim = [0, this.spanS]; axes.ylim = [0, 1];
      pen.fillStyle = c.faint;
      pen.font = `${axes.font * axes.scale}px sans-serif`;
      pen.fillText("no samples yet", axes.left + 10, axes.top + 30 * axes.unit);
      return true;
    }
    const start = this.end - this.n * this.bin; // time of bin 0
    let zero = 0;
    if (this.view) axes.xlim = this.view;
    else {
      const bins = Math.round(this.spanS / this.bin), at = this.onTakeoff ? this.takeoff(bins) : -1;
      const first = at >= 0 ? start + (at - 0.2 * bins) * this.bin : this.end - this.spanS;
      axes.xlim = [first, first + this.spanS];
      if (at >= 0) zero = start + at * this.bin;
    }
    this.panels(start, zero);
    return true;
  }

  // Extremes of a trace in the bins [a, b), in its unit; NaN where it is not known.
  extremes(k, a, b) {
    let low = 32767, high = -32768;
    for (let i = a; i < b; i++) {
      const at = i % this.size;
      if (this.low[k][at] === UNKNOWN) return [NaN, NaN];
      if (this.low[k][at] < low) low = this.low[k][at];
      if (this.high[k][at] > high) high = this.high[k][at];
    }
    const scale = this.names[k][this.unit], ends = [low * scale.scale + scale.offset, high * scale.scale + scale.offset];
    return scale.scale < 0 ? ends.reverse() : ends;
  }

  // What is shown, for saving: the extremes of each bin.
  table() {
    const names = this.names.flatMap((t) => ["lowest", "highest"].map((end) => `${t.name} ${end} (${t[this.unit].unit})`));
    const rows = [["time (s)", ...names]], start = this.end - this.n * this.bin, [t0, t1] = this.axes.xlim;
    for (let i = Math.max(0, this.n - this.size); i < this.n; i++) {
      const t = start + i * this.bin;
      if (t >= t0 && t <= t1) rows.push([t.toFixed(6), ...this.names.flatMap((_, k) => this.extremes(k, i, i + 1).map((x) => Number(x.toPrecision(6))))]);
    }
    return rows;
  }

  // One panel a trace, over a common time axis.
  panels(start, zero) {
    const axes = this.axes, pen = axes.pen, c = colours(), [t0, t1] = axes.xlim;
    const top = axes.top, height = axes.height, gap = 1.6 * axes.font * axes.scale, each = (height - gap * (this.nTraces - 1)) / this.nTraces;
    const first = Math.max(Math.max(0, this.n - this.size), Math.floor((t0 - start) / this.bin)), last = Math.min(this.n, Math.ceil((t1 - start) / this.bin));
    const columns = Math.max(1, Math.floor(axes.width / Math.max(1, axes.scale)));
    const bottom = axes.options.bottom;
    const short = t1 - t0 < 0.5, unit = short ? 1e3 : 1, origin = zero || t0;
    for (let k = 0; k < this.nTraces; k++) {
      const trace = this.names[k]; if (!trace) continue;
      const scale = trace[this.unit];
      const count = last - first, per = Math.max(1, count / columns), n = Math.ceil(count / per);
      const xs = new Float64Array(n), lows = new Float64Array(n), highs = new Float64Array(n);
      let least = Infinity, most = -Infinity;
      for (let j = 0; j < n; j++) {
        const a = first + Math.floor(j * per), b = Math.max(a + 1, Math.min(last, first + Math.floor((j + 1) * per)));
        xs[j] = (start + a * this.bin - origin) * unit;
        [lows[j], highs[j]] = this.extremes(k, a, b);
        if (lows[j] < least) least = lows[j];
        if (highs[j] > most) most = highs[j];
      }
      if (!isFinite(least)) { least = 0; most = 1; }
      const range = trace.range ?? [least, most]; // grows at once, shrinks slowly: no jitter
      const room = 0.08 * (most - least || 1e-3);
      trace.range = [Math.min(least - room, range[0] + 0.02 * (least - range[0])), Math.max(most + room, range[1] + 0.02 * (most - range[1]))];
      axes.top = top + k * (each + gap); axes.height = each;
      axes.ylim = trace.range;
      axes.options.y = ""; axes.options.x = "";
      const real = axes.xlim;
      axes.xlim = [(t0 - origin) * unit, (t1 - origin) * unit];
      axes.options.x = k === this.nTraces - 1 ? (zero ? `time since take-off (${short ? "ms" : "s"})` : `time (${short ? "ms" : "s"}) from ${origin.toFixed(3)} s`) : "";
      axes.frame(k === this.nTraces - 1);
      const tone = c[["c0", "c1", "c4", "c3", "c5"][k % 5]];
      axes.inside(() => { if (per > 1) axes.envelope(xs, lows, highs, tone); else axes.line(xs, lows, tone, 1.3); });
      // the name stands above its panel, where it hides no signal; behind it the value at the cursor
      pen.font = `bold ${axes.font * axes.scale}px sans-serif`;
      pen.fillStyle = tone;
      pen.fillRect(axes.left, axes.top - 11 * axes.unit, 8 * axes.unit, 8 * axes.unit);
      pen.fillStyle = c.ink; pen.textAlign = "left"; pen.textBaseline = "bottom";
      pen.fillText(`${trace.name} (${scale.unit})${this.valueAt(k, start)}`, axes.left + 12 * axes.unit, axes.top - 2 * axes.unit);
      axes.xlim = real;
      for (const [at, style] of [[this.cursor, c.ink], [this.marked, c.event]]) if (at !== null) axes.inside(() => axes.line([at, at], axes.ylim, style, 1));
    }
    axes.top = top; axes.height = height; axes.options.bottom = bottom;
    this.between(axes);
    // pointer positions are in the time of the run, not since take-off
  }

  valueAt(k, start) {
    if (this.cursor === null) return "";
    const i = Math.floor((this.cursor - start) / this.bin);
    if (i < Math.max(0, this.n - this.size) || i >= this.n) return "";
    const [low, high] = this.extremes(k, i, i + 1);
    return isFinite(low) ? `  ${(0.5 * (low + high)).toPrecision(4).replace("-", "\u2212")}` : "  not known";
  }

  // Time at the cursor, and from the mark to it.
  between(axes) {
    if (this.cursor === null && this.marked === null) return;
    const pen = axes.pen, at = this.cursor ?? this.marked, ms = 1e3 * (at - this.marked);
    const since = this.marked === null ? "" : `, ${ms.toFixed(3)} ms from the mark${ms ? ` (${Math.abs(1e3 / ms).toPrecision(4)} Hz)` : ""}`;
    pen.fillStyle = colours().ink; pen.textAlign = "right"; pen.textBaseline = "bottom";
    pen.fillText(`${at.toFixed(5)} s${since}`.replace("-", "\u2212"), axes.left + axes.width, axes.top - 2 * axes.unit);
  }
}
