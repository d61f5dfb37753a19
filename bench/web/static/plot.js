// Axes on a canvas: ranges, ticks, labels with units, and marks drawn in data coordinates; sharp on every screen.

export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

let palette = null;
export function colours() {
  if (!palette) {
    palette = {};
    for (const name of ["paper", "panel", "line", "grid", "ink", "faint", "measured", "model", "floor", "zone", "band",
      "event", "good", "bad", "warn", "c0", "c1", "c2", "c3", "c4", "c5", "c6"]) palette[name] = colour(name);
  }
  return palette;
}
addEventListener("themechange", () => { palette = null; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  palette = null;
  dispatchEvent(new Event("themechange"));
});

// Steps of 1, 2 or 5 times a power of ten; at most `most` of them in [low, high].
export function ticks(low, high, most) {
  const span = high - low;
  if (!(span > 0) || !isFinite(span)) return { at: [], step: 1 };
  const rough = span / Math.max(1, most), power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => span / s <= most) ?? 10 * power;
  const at = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * span; k++) at.push(k * step);
  return { at, step };
}

// Decades of an axis that carries logarithms: their exponents, and words as 0.001, 1, 100 or 10\u2074.
const SUPERSCRIPTS = "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079";
export function decades(low, high, most) {
  const by = Math.max(1, Math.ceil((Math.floor(high) - Math.ceil(low) + 1) / Math.max(1, most)));
  const at = [];
  for (let k = Math.ceil(low - 1e-9); k <= high + 1e-9; k += by) at.push(k);
  return { at, step: by };
}
function power(k) {
  if (Math.abs(k) < 4) return k < 0 ? (10 ** k).toFixed(-k) : String(10 ** k);
  return `10${k < 0 ? "\u207b" : ""}${[...String(Math.abs(k))].map((digit) => SUPERSCRIPTS[digit]).join("")}`;
}

export function number(value, step) {
  if (value === 0) return "0";
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  if (Math.abs(value) >= 1e5 || digits > 6) return value.toExponential(1).replace("-", "\u2212");
  return globalThis.desk.digits(value.toFixed(Math.min(digits, 8)).replace("-", "\u2212"));
}

export class Axes {
  // options: x, y (labels with units), title, left (room for numbers, css px), log (axes carry log10 of values)
  constructor(canvas, options = {}) {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d", { alpha: false });
    this.options = { x: "", y: "", title: "", left: 54, right: 16, top: 18, bottom: 34, ...options };
    this.xlim = [0, 1];
    this.ylim = [0, 1];
    this.fit();
  }

  // Take the canvas's size on the screen; true where it has changed.
  fit() {
    const ratio = devicePixelRatio || 1;
    const box = this.canvas.getBoundingClientRect();
    const width = Math.max(1, Math.round(box.width * ratio)), height = Math.max(1, Math.round(box.height * ratio));
    const root = parseFloat(getComputedStyle(document.documentElement).fontSize) || 14;
    this.scale = ratio;
    this.font = root * 0.82;
    const s = (root / 14) * ratio, o = this.options;
    const changed = this.canvas.width !== width || this.canvas.height !== height;
    if (changed) { this.canvas.width = width; this.canvas.height = height; }
    this.left = o.left * s; this.top = o.top * s;
    this.width = Math.max(1, width - (o.left + o.right) * s);
    this.height = Math.max(1, height - (o.top + o.bottom) * s);
    this.unit = s; // device pixels of one design pixel
    return changed;
  }

  px(x) { return this.left + ((x - this.xlim[0]) / (this.xlim[1] - this.xlim[0])) * this.width; }
  py(y) { return this.top + this.height - ((y - this.ylim[0]) / (this.ylim[1] - this.ylim[0])) * this.height; }
  // Data coordinates of a pointer event.
  at(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = (event.clientX - box.left) * this.scale, y = (event.clientY - box.top) * this.scale;
    return [
      this.xlim[0] + ((x - this.left) / this.width) * (this.xlim[1] - this.xlim[0]),
      this.ylim[0] + ((this.top + this.height - y) / this.height) * (this.ylim[1] - this.ylim[0]),
    ];
  }

  clear() {
    const c = colours();
    this.pen.fillStyle = c.paper;
    this.pen.fillRect(0, 0, this.canvas.width, this.canvas.height);
  }

  // Grid, frame, numbers and labels; without numbers below where another panel follows.
  frame(below = true) {
    const pen = this.pen, c = colours(), s = this.unit, o = this.options;
    const font = this.font * this.scale;
    pen.font = `${font}px ${getComputedStyle(document.body).fontFamily}`;
    pen.lineWidth = Math.max(1, s);
    const find = o.log ? decades : ticks, words = o.log ? power : number;
    const xt = find(...this.xlim, Math.max(2, Math.floor(this.width / (5.2 * font))));
    const yt = find(...this.ylim, Math.max(2, Math.min(4, Math.floor(this.height / (1.4 * font))), Math.floor(this.height / (2.6 * font))));
    pen.strokeStyle = c.grid;
    pen.beginPath();
    for (const x of xt.at) { const p = Math.round(this.px(x)) + 0.5; pen.moveTo(p, this.top); pen.lineTo(p, this.top + this.height); }
    for (const y of yt.at) { const p = Math.round(this.py(y)) + 0.5; pen.moveTo(this.left, p); pen.lineTo(this.left + this.width, p); }
    pen.stroke();
    pen.strokeStyle = c.faint;
    pen.strokeRect(this.left, this.top, this.width, this.height);
    pen.fillStyle = c.ink;
    pen.textAlign = "center"; pen.textBaseline = "top";
    if (below) for (const x of xt.at) pen.fillText(words(x, xt.step), this.px(x), this.top + this.height + 3 * s);
    pen.textAlign = "right"; pen.textBaseline = "middle";
    for (const y of yt.at) pen.fillText(words(y, yt.step), this.left - 4 * s, this.py(y));
    pen.textAlign = "center"; pen.textBaseline = "alphabetic";
    pen.fillText(globalThis.desk.say(o.x), this.left + this.width / 2, this.canvas.height - 4 * s);
    if (o.title) { pen.textAlign = "left"; pen.fillStyle = c.faint; pen.fillText(globalThis.desk.say(o.title), this.left, this.top - 5 * s); }
    pen.fillStyle = c.ink; pen.textAlign = "center";
    pen.save();
    pen.translate(font, this.top + this.height / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(globalThis.desk.say(o.y), 0, 0);
    pen.restore();
  }

  // Draw with everything outside the frame cut off.
  inside(draw) {
    const pen = this.pen;
    pen.save();
    pen.beginPath();
    pen.rect(this.left, this.top, this.width, this.height);
    pen.clip();
    draw(pen);
    pen.restore();
  }

  line(xs, ys, style, width = 1.2, dash = []) {
    const pen = this.pen;
    pen.strokeStyle = style; pen.lineWidth = width * this.unit; pen.setLineDash(dash.map((d) => d * this.unit));
    pen.beginPath();
    let up = true;
    for (let i = 0; i < xs.length; i++) {
      if (!isFinite(ys[i])) { up = true; continue; }
      if (up) pen.moveTo(this.px(xs[i]), this.py(ys[i])); else pen.lineTo(this.px(xs[i]), this.py(ys[i]));
      up = false;
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  // Small squares: the fastest mark there is.
  dots(xs, ys, style, size = 2, first = 0, last = xs.length) {
    const pen = this.pen, d = size * this.unit, h = d / 2;
    pen.fillStyle = style;
    for (let i = first; i < last; i++) pen.fillRect(this.px(xs[i]) - h, this.py(ys[i]) - h, d, d);
  }

  // A band from lows to highs, one column each: nothing between two samples is lost.
  envelope(xs, lows, highs, style) {
    const pen = this.pen, thin = Math.max(1, this.unit);
    pen.fillStyle = style;
    let before = null;
    for (let i = 0; i < xs.length; i++) {
      let low = lows[i], high = highs[i];
      if (!isFinite(low)) { before = null; continue; }
      const own = [low, high];
      if (before) { low = Math.min(low, before[1]); high = Math.max(high, before[0]); } // columns join
      const top = this.py(high), bottom = this.py(low);
      pen.fillRect(this.px(xs[i]) - thin / 2, top - thin / 2, Math.max(thin, this.px(xs[Math.min(i + 1, xs.length - 1)]) - this.px(xs[i])), Math.max(thin, bottom - top + thin));
      before = own;
    }
  }

  text(words, x, y, style, align = "left") {
    const pen = this.pen;
    pen.fillStyle = style; pen.textAlign = align; pen.textBaseline = "middle";
    pen.fillText(words, this.px(x), this.py(y));
  }
}
