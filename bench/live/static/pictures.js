// Diagram, return map, residuals and spectrum. What does not change any more is drawn once, on a layer of its own.
import { Axes, colours } from "/static/web/plot.js";

const POOR = 2, DOUBTFUL = 1;

class Picture {
  constructor(canvas, options) { this.axes = new Axes(canvas, options); this.dirty = true; }
  stale() { this.dirty = true; this.layer = null; }
  get canvas() { return this.axes.canvas; }
  paint() {
    if (this.axes.fit()) this.stale();
    if (!this.dirty) return false;
    this.dirty = false;
    this.draw();
    return true;
  }
}

export class Diagram extends Picture {
  constructor(canvas) {
    super(canvas, { x: "\u0393", y: "flight time (ms)", top: 8 });
    this.clear();
  }
  clear() { this.steps = new Map(); this.models = []; this.now = null; this.top = 1; this.count = 0; this.stale(); }
  plan(m) {
    this.axes.options.x = m.axis; this.axes.options.y = `flight time (ms) at ${m.frequency_hz.toFixed(2)} Hz`;
    const low = Math.min(...m.gammas), high = Math.max(...m.gammas), room = 0.03 * (high - low || high || 1);
    this.axes.xlim = [low - room, high + room];
    this.stale();
  }
  model(m) {
    this.models.push(m);
    for (const t of m.tau_ms) if (t > this.top) this.top = t;
    this.stale();
  }
  present(gamma) { if (gamma !== this.now) { this.now = gamma; this.dirty = true; } }
  step(s) {
    const before = this.steps.get(s.step);
    const longest = this.top;
    for (let i = 0; i < s.tau.length; i++) if (s.mark[i] < POOR && s.tau[i] > this.top) this.top = s.tau[i];
    this.steps.set(s.step, s);
    this.count += s.tau.length - (before ? before.tau.length : 0);
    if (this.top > longest || (before && before.final)) this.layer = null;
    else if (s.final && this.layer) this.onLayer(s);
    this.dirty = true;
  }
  marks(s, axes) {
    const c = colours(), pen = axes.pen, d = 3 * axes.unit, x = axes.px(s.gamma) - d / 2;
    for (let i = 0; i < s.tau.length; i++) {
      if (s.mark[i] === POOR) continue;
      pen.fillStyle = s.mark[i] === DOUBTFUL ? c.c1 : c.measured;
      pen.fillRect(x, axes.py(s.tau[i]) - d / 2, d, d);
    }
  }
  // Rows of all flights, for saving.
  table() {
    const rows = [["step", "gamma as shown", "flight time (ms)", "landing since the step began (s)", "mark (0 plain, 1 unsure, 2 not counted)"]];
    for (const s of this.steps.values()) for (let i = 0; i < s.tau.length; i++) rows.push([s.step, s.gamma, s.tau[i], s.landing[i], s.mark[i]]);
    return rows;
  }
  onLayer(s) {
    const pen = this.axes.pen;
    this.axes.pen = this.layer.getContext("2d");
    this.marks(s, this.axes);
    this.axes.pen = pen;
    s.drawn = this.layer;
  }
  // Zones, prediction and finished steps.
  background() {
    const axes = this.axes, c = colours(), screen = axes.pen;
    this.layer = document.createElement("canvas");
    this.layer.width = axes.canvas.width; this.layer.height = axes.canvas.height;
    const pen = (axes.pen = this.layer.getContext("2d", { alpha: false }));
    axes.clear();
    axes.inside(() => {
      pen.fillStyle = c.zone;
      for (const m of this.models) for (const [g, half, a, b] of m.zones) pen.fillRect(axes.px(g - half), axes.py(b), axes.px(g + half) - axes.px(g - half) + 0.5, axes.py(a) - axes.py(b));
    });
    axes.frame();
    axes.inside(() => {
      for (const m of this.models) axes.dots(m.gamma, m.tau_ms, c.model, 2.2);
      for (const s of this.steps.values()) if (s.final) { this.marks(s, axes); s.drawn = this.layer; }
    });
    axes.pen = screen;
  }
  draw() {
    const axes = this.axes, c = colours();
    axes.ylim = [0, 1.06 * this.top];
    if (!this.layer) this.background();
    axes.pen.drawImage(this.layer, 0, 0);
    axes.inside(() => {
      if (this.now !== null) axes.line([this.now, this.now], axes.ylim, c.event, 1, [4, 3]);
      for (const s of this.steps.values()) if (s.drawn !== this.layer) this.marks(s, axes);
    });
  }
}

export class ReturnMap extends Picture {
  constructor(canvas) { super(canvas, { x: "flight time (ms)", y: "next flight time (ms)", top: 8 }); this.clear(); }
  clear() { this.s = null; this.stale(); }
  plan() { this.clear(); }
  step(s) { this.s = s; this.dirty = true; }
  table() {
    const rows = [["flight time (ms)", "next flight time (ms)"]], s = this.s;
    for (let i = 0; s && i + 1 < s.tau.length; i++) if (s.mark[i] < POOR && s.mark[i + 1] < POOR) rows.push([s.tau[i], s.tau[i + 1]]);
    return rows;
  }
  draw() {
    const axes = this.axes, c = colours(), s = this.s;
    axes.clear();
    const xs = [], ys = [], doubtX = [], doubtY = [];
    let low = Infinity, high = -Infinity;
    if (s) {
      for (let i = 0; i < s.tau.length; i++) {
        if (s.mark[i] === POOR) continue;
        low = Math.min(low, s.tau[i]); high = Math.max(high, s.tau[i]);
        if (i + 1 >= s.tau.length || s.mark[i + 1] === POOR) continue;
        const doubt = s.mark[i] === DOUBTFUL || s.mark[i + 1] === DOUBTFUL;
        (doubt ? doubtX : xs).push(s.tau[i]); (doubt ? doubtY : ys).push(s.tau[i + 1]);
      }
    }
    if (!(high > 0)) { low = 0; high = 1; }
    const room = 0.1 * (high - low) + 0.3;
    axes.xlim = [low - room, high + room]; axes.ylim = axes.xlim;
    axes.frame();
    axes.inside(() => {
      axes.line(axes.xlim, axes.ylim, c.faint, 0.8, [3, 3]);
      axes.dots(xs, ys, c.measured, 4); axes.dots(doubtX, doubtY, c.c1, 4);
    });
  }
}

export class Residuals extends Picture {
  constructor(canvas) { super(canvas, { x: "\u0393", y: "landing \u2212 predicted (\u00b5s)", top: 8, left: 62 }); this.clear(); }
  clear() { this.steps = new Map(); this.noise = 0; this.stale(); }
  plan(m) {
    this.axes.options.x = m.axis;
    const low = Math.min(...m.gammas), high = Math.max(...m.gammas), room = 0.03 * (high - low || high || 1);
    this.width = 0.6 * (high - low || 1) / Math.max(2, m.gammas.length);
    this.axes.xlim = [low - room, high + room];
    this.clear();
  }
  floor(us) { this.noise = us || 0; this.dirty = true; }
  step(s) {
    const own = [];
    for (let i = 0; i < s.residual.length; i++) if (isFinite(s.residual[i])) own.push(Math.abs(s.residual[i]));
    own.sort((a, b) => a - b);
    const noise = [...s.noise].filter(isFinite).sort((a, b) => a - b);
    s.size = own.length ? own[Math.floor(0.97 * (own.length - 1))] : 0;
    s.floor = noise.length ? noise[noise.length >> 1] : 0;
    this.steps.set(s.step, s);
    this.dirty = true;
  }
  table() {
    const rows = [["step", "gamma as shown", "landing less prediction (us)", "noise, 1 sigma (us)"]];
    for (const s of this.steps.values()) for (let i = 0; i < s.residual.length; i++) if (isFinite(s.residual[i])) rows.push([s.step, s.gamma, s.residual[i], s.noise[i]]);
    return rows;
  }
  draw() {
    const axes = this.axes, c = colours();
    axes.clear();
    // a step with a wide band, or with wild residuals, goes beyond the frame and leaves the others legible
    const sizes = [...this.steps.values()].map((s) => Math.max(s.size, 4 * s.floor)).filter((x) => x > 0).sort((a, b) => a - b);
    const size = sizes.length ? Math.min(sizes[sizes.length - 1], 3 * sizes[sizes.length >> 1]) : 20;
    axes.ylim = [-1.15 * size, 1.15 * size];
    axes.inside((pen) => {
      pen.fillStyle = c.band; // two standard deviations of the noise
      for (const s of this.steps.values()) if (s.floor) pen.fillRect(axes.px(s.gamma - this.width), axes.py(2 * s.floor), axes.px(s.gamma + this.width) - axes.px(s.gamma - this.width), Math.max(1, axes.py(-2 * s.floor) - axes.py(2 * s.floor)));
    });
    axes.frame();
    axes.inside((pen) => {
      axes.line(axes.xlim, [0, 0], c.faint, 1);
      const d = 3 * axes.unit;
      for (const s of this.steps.values()) {
        const n = s.residual.length;
        for (let i = 0; i < n; i++) {
          const r = s.residual[i];
          if (!isFinite(r)) continue;
          const x = axes.px(s.gamma + this.width * (i / Math.max(1, n - 1) - 0.5)), beyond = Math.abs(r) > 1.15 * size;
          pen.fillStyle = beyond ? c.bad : c.measured;
          const y = axes.py(beyond ? Math.sign(r) * 1.12 * size : r);
          pen.fillRect(x - d / 2, y - d / 2, d, beyond ? 2 * d : d);
        }
      }
    });
  }
}

export class Spectrum extends Picture {
  constructor(canvas) { super(canvas, { x: "frequency (Hz)", y: "(m/s\u00b2)/\u221aHz", title: "spectrum of the accelerometer", top: 20, log: true }); }
  table() { return [["frequency (Hz)", "spectral density ((m/s^2)/sqrt(Hz))"], ...[...(this.f ?? [])].map((f, i) => [10 ** f, 10 ** this.d[i]])]; }
  set(frequency, density) { this.f = frequency.map(Math.log10); this.d = density.map((v) => Math.log10(Math.max(v, 1e-9))); this.dirty = true; }
  draw() {
    const axes = this.axes, c = colours();
    axes.clear();
    if (this.f) {
      axes.xlim = [this.f[0], this.f[this.f.length - 1]];
      axes.ylim = [Math.floor(Math.min(...this.d)), Math.ceil(Math.max(...this.d) + 0.1)];
    } else { axes.xlim = [0, 4]; axes.ylim = [-5, 1]; }
    axes.frame();
    if (this.f) axes.inside(() => axes.line(this.f, this.d, c.c1, 1.2));
  }
}
