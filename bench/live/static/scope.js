// The scope of a run that goes on: minima and maxima of every bin for the last seconds, in a ring.
import { Scope } from "/static/web/scope.js";

const KEPT_S = 12;
const UNKNOWN = -32768; // of a displacement that the accelerometer does not tell

export class LiveScope extends Scope {
  constructor(canvas) {
    super(canvas);
    Object.assign(this, { names: [], spanS: 0.2, unit: "si", onTakeoff: true, frozen: false, view: null, since: null });
    this.clear();
  }

  clear() { this.size = 0; this.n = 0; this.end = 0; this.bin = 0; this.cursor = this.marked = null; this.changed(); }
  stale() { this.changed(); }
  // `list`: name of each trace, and scales of its codes in volts and SI
  set(list) { this.names = list; this.clear(); }
  span(seconds) { this.spanS = seconds; this.whole(); }
  units(name) { this.unit = name; this.changed(); }
  trigger(on) { this.onTakeoff = on; this.changed(); }
  freeze() { this.frozen = !this.frozen; if (!this.frozen) this.view = null; this.changed(); return this.frozen; }
  whole() { this.view = null; this.changed(); }
  // Zooming freezes the picture: what is looked at stands still.
  look(view) {
    if (!this.frozen) document.getElementById("freeze").click();
    this.view = view;
    super.look(view);
  }
  mark(at) { super.mark(at); if (this.marked !== null && !this.frozen) this.look([...this.at]); }

  // bins: [bin][min|max][trace]
  add(first, bin, traces, bins) {
    if (this.frozen) return;
    const n = bins.length / (2 * traces);
    if (bin !== this.bin || traces !== this.low?.length) {
      this.bin = bin; this.size = Math.ceil(KEPT_S / bin); this.n = 0;
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
    this.changed();
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
    const up = this.names[contact].si.scale > 0, middle = (least + most) / 2;
    for (let i = this.n - Math.round(0.8 * bins); i > oldest; i--) {
      const now = up ? low[i % this.size] > middle : high[i % this.size] < middle;
      const before = up ? high[(i - 1) % this.size] < middle : low[(i - 1) % this.size] > middle;
      if (now && before) return i;
    }
    return -1;
  }

  // The window: what is looked at, or from a fifth of it before the take-off on, or the latest.
  paint() {
    if (this.n && this.dirty) {
      this.start = this.end - this.n * this.bin; // time of bin 0
      const bins = Math.round(this.spanS / this.bin), at = !this.view && this.onTakeoff ? this.takeoff(bins) : -1;
      this.since = at >= 0 ? this.start + at * this.bin : null;
      const first = at >= 0 ? this.since - 0.2 * this.spanS : this.end - this.spanS;
      this.at = this.view ?? [first, first + this.spanS];
    }
    return super.paint();
  }
  zero() { return this.since; }
  traces() { return this.n ? this.names.slice(0, this.low.length).map((trace) => ({ name: trace.name, unit: trace[this.unit].unit })) : []; }

  // The range grows at once and shrinks slowly: no jitter.
  range(k, low, high) {
    const trace = this.names[k], room = 0.08 * (high - low || 1e-3), before = trace.range ?? [low, high];
    trace.range = [Math.min(low - room, before[0] + 0.02 * (low - before[0])), Math.max(high + room, before[1] + 0.02 * (high - before[1]))];
    return trace.range;
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

  // The bins that are shown, from the first ever.
  bins() {
    const [a, b] = this.at, oldest = Math.max(0, this.n - this.size);
    return [Math.max(oldest, Math.floor((a - this.start) / this.bin)), Math.min(this.n, Math.ceil((b - this.start) / this.bin))];
  }

  columns(k) {
    const [first, last] = this.bins(), most = Math.max(1, Math.floor(this.axes.width / Math.max(1, this.axes.scale)));
    const per = Math.max(1, (last - first) / most), n = Math.max(0, Math.ceil((last - first) / per));
    const t = new Float64Array(n), low = new Float64Array(n), high = new Float64Array(n);
    for (let j = 0; j < n; j++) {
      const a = first + Math.floor(j * per), b = Math.max(a + 1, Math.min(last, first + Math.floor((j + 1) * per)));
      t[j] = this.start + a * this.bin;
      [low[j], high[j]] = this.extremes(k, a, b);
    }
    return { t, low, high: per > 1 ? high : null };
  }

  // What is shown, for saving: the extremes of each bin.
  table() {
    const names = this.names.flatMap((t) => ["lowest", "highest"].map((end) => `${t.name} ${end} (${t[this.unit].unit})`));
    const rows = [["time (s)", ...names]], [first, last] = this.n ? this.bins() : [0, 0];
    for (let i = first; i < last; i++) {
      rows.push([(this.start + i * this.bin).toFixed(6), ...this.names.flatMap((_, k) => this.extremes(k, i, i + 1).map((x) => Number(x.toPrecision(6))))]);
    }
    return rows;
  }
}
