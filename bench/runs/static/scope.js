// A scope over a whole recording: the server sends extremes by column, or the samples where there are few.
import { Axes, colours } from "/static/web/plot.js";
import { ask } from "./common.js";

const lanes = ["c0", "c1", "c4", "c3", "c5", "c6"];

export class Scope extends EventTarget {
  constructor(place, id, told) {
    super();
    Object.assign(this, { place, id, told, si: false, seen: null, asking: null, at: [0, told.duration_s] });
    this.shortest = 4 / told.rate_hz;
    this.axes = told.channels.map(() => {
      const lane = document.createElement("div"), canvas = document.createElement("canvas");
      lane.className = "lane";
      lane.append(canvas);
      place.append(lane);
      return [canvas, null];
    });
    this.axes = this.axes.map(([canvas], k) => {
      const last = k === told.channels.length - 1;
      return new Axes(canvas, { x: last ? "time (s)" : "", top: 20, bottom: last ? 34 : 6, left: 58, right: 24 });
    });
    new ResizeObserver(() => { if (this.axes.map((one) => one.fit()).some(Boolean)) this.ask(); this.draw(); }).observe(place);
    addEventListener("themechange", () => this.draw());
    this.pointer();
    place.addEventListener("keydown", (event) => this.key(event));
    this.ask();
  }

  // Show the stretch [a, b], cut to the recording.
  show(a, b) {
    const all = this.told.duration_s, span = Math.min(Math.max(b - a, this.shortest), all);
    const middle = 0.5 * (a + b);
    let start = span === b - a ? a : middle - 0.5 * span;
    start = Math.min(Math.max(start, 0), all - span);
    this.at = [start, start + span];
    this.draw();
    this.ask();
  }

  zoom(factor, about = 0.5 * (this.at[0] + this.at[1])) {
    const [a, b] = this.at;
    this.show(about - (about - a) * factor, about + (b - about) * factor);
  }

  move(part) {
    const span = this.at[1] - this.at[0];
    this.show(this.at[0] + part * span, this.at[1] + part * span);
  }

  // Ask for what is shown; one question at a time, the latest wish next.
  async ask() {
    if (this.asking) { this.again = true; return; }
    const width = Math.min(8192, Math.max(16, Math.round(this.axes[0].width)));
    const [a, b] = this.at;
    this.asking = true;
    const began = performance.now();
    try {
      this.seen = await ask(`/runs/api/${this.id}/view?start_s=${a}&stop_s=${b}&width=${width}`);
      this.seen.took_ms = performance.now() - began;
      this.dispatchEvent(new CustomEvent("seen", { detail: this.seen }));
      this.draw();
    } catch (error) {
      this.dispatchEvent(new CustomEvent("refused", { detail: error.message }));
    }
    this.asking = false;
    if (this.again) { this.again = false; this.ask(); }
  }

  draw() {
    if (this.drawing) return;
    this.drawing = requestAnimationFrame(() => { this.drawing = null; this.paint(); });
  }

  scaled(channel, values) {
    if (!this.si || channel.si_per_volt === null) return values.map((v) => (v === null ? NaN : v));
    return values.map((v) => (v === null ? NaN : (v - channel.zero_v) * channel.si_per_volt));
  }

  paint() {
    const c = colours();
    this.told.channels.forEach((channel, k) => {
      const axes = this.axes[k], seen = this.seen?.channels[channel.name];
      axes.options.y = this.si && channel.si_unit ? channel.si_unit : "V";
      axes.xlim = this.at;
      let low = [], high = [];
      if (seen) {
        low = this.scaled(channel, seen.low);
        high = seen.high ? this.scaled(channel, seen.high) : low;
        if (channel.si_per_volt < 0 && this.si && seen.high) [low, high] = [high, low];
        const least = Math.min(...low.filter(isFinite)), most = Math.max(...high.filter(isFinite));
        if (isFinite(least)) {
          const margin = 0.06 * (most - least) || 0.1 * Math.abs(most) || 1;
          axes.ylim = [least - margin, most + margin];
        }
      }
      axes.clear();
      if (this.seen) axes.inside(() => this.losses(axes));
      axes.frame();
      if (k < this.axes.length - 1) this.blank(axes);
      if (!seen) return;
      const t = this.seen.time_s, style = c[lanes[k % lanes.length]];
      let labels = [];
      axes.inside(() => {
        labels = this.marks(axes);
        const noted = this.noted(axes);
        if (seen.high) axes.envelope(t, low, high, style);
        else {
          this.pieces(axes, t, low, style);
          if ((this.at[1] - this.at[0]) * this.told.rate_hz < axes.width / (3 * axes.unit)) axes.dots(t, low, style, 4);
        }
        for (const [words, x] of noted) this.words(axes, words, x, axes.top + axes.height - 20 * axes.unit);
      });
      // names stand above the lane, where they hide no signal; a step's name gives way to the channel's
      const above = axes.top - (axes.font + 6) * axes.scale, right = axes.left + axes.width;
      const own = right - axes.pen.measureText(channel.name).width - 12 * axes.unit;
      for (const [words, x] of labels) if (x + axes.pen.measureText(words).width < own) this.words(axes, words, x, above);
      this.words(axes, channel.name, right, above, "right");
    });
  }

  // No numbers below a lane that is not the last.
  blank(axes) {
    const y = axes.top + axes.height + Math.ceil(axes.unit);
    axes.pen.fillStyle = colours().paper;
    axes.pen.fillRect(0, y, axes.canvas.width, axes.canvas.height - y);
  }

  // Words on a patch of paper, legible over any curve.
  words(axes, words, x, y, align = "left") {
    const pen = axes.pen, c = colours(), width = pen.measureText(words).width, room = 3 * axes.unit;
    const left = align === "left" ? x : x - width;
    pen.fillStyle = c.paper;
    pen.fillRect(left - room, y, width + 2 * room, (axes.font + 4) * axes.scale);
    pen.fillStyle = c.ink; pen.textAlign = "left"; pen.textBaseline = "top";
    pen.fillText(words, left, y + 2 * axes.scale);
    return left + width + room;
  }

  // A line through samples that is broken where some were lost.
  pieces(axes, t, values, style) {
    const longest = 1.5 / this.told.rate_hz, xs = [], ys = [];
    for (let i = 0; i < t.length; i++) {
      if (i && t[i] - t[i - 1] > longest) { xs.push(t[i]); ys.push(NaN); }
      xs.push(t[i]); ys.push(values[i]);
    }
    axes.line(xs, ys, style, 1.4);
  }

  losses(axes) {
    const pen = axes.pen;
    pen.fillStyle = colours().zone;
    for (const [a, b] of this.seen.lost) {
      const left = axes.px(a);
      pen.fillRect(left, axes.top, Math.max(2 * axes.unit, axes.px(b) - left), axes.height);
    }
  }

  // What is shown, in volts: extremes of each column, or the samples.
  table() {
    const names = Object.keys(this.seen.channels), all = names.map((name) => this.seen.channels[name]);
    const heads = names.flatMap((name, k) => (all[k].high ? [`${name} lowest (V)`, `${name} highest (V)`] : [`${name} (V)`]));
    return [["time (s)", ...heads], ...this.seen.time_s.map((t, i) => [t, ...all.flatMap((x) => (x.high ? [x.low[i], x.high[i]] : [x.low[i]]))])];
  }

  // Notes that were typed during the run, each at its time.
  annotate(notes) {
    this.notes = notes.filter((note) => note.at_s !== null);
    this.place.dataset.notes = this.notes.length;
    this.draw();
  }

  noted(axes) {
    const labels = [], pen = axes.pen;
    pen.strokeStyle = colours().event;
    for (const note of this.notes ?? []) {
      if (note.at_s < this.at[0] || note.at_s > this.at[1]) continue;
      const x = axes.px(note.at_s);
      pen.beginPath(); pen.moveTo(x, axes.top); pen.lineTo(x, axes.top + axes.height); pen.stroke();
      labels.push([note.text.length > 28 ? `${note.text.slice(0, 27)}\u2026` : note.text, x + 5 * axes.unit]);
    }
    return axes === this.axes[0] ? labels : [];
  }

  // Beginnings of steps.
  marks(axes) {
    const pen = axes.pen, first = axes === this.axes[0];
    pen.strokeStyle = colours().faint;
    pen.setLineDash([3 * axes.unit, 3 * axes.unit]);
    let free = -Infinity;
    const labels = [];
    this.told.steps.forEach((step, k) => {
      if (step.start_s < this.at[0] || step.start_s > this.at[1]) return;
      const x = axes.px(step.start_s);
      pen.beginPath(); pen.moveTo(x, axes.top); pen.lineTo(x, axes.top + axes.height); pen.stroke();
      if (!first || x < free) return;
      labels.push([`step ${k}`, x + 5 * axes.unit]);
      free = x + pen.measureText(`step ${k}`).width + 16 * axes.unit;
    });
    pen.setLineDash([]);
    return labels;
  }

  // Wheel, drag, and Shift with drag.
  pointer() {
    let down = null, chosen = null;
    this.place.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY / 240))), this.axes[0].at(event)[0]);
    }, { passive: false });
    this.place.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      this.place.focus({ preventScroll: true });
      this.place.setPointerCapture(event.pointerId);
      down = { x: event.clientX, at: [...this.at], choose: event.shiftKey, time: this.axes[0].at(event)[0] };
      this.place.classList.add(down.choose ? "choosing" : "dragging");
      if (down.choose) {
        chosen = document.createElement("div");
        chosen.className = "chosen";
        this.place.append(chosen);
      }
    });
    this.place.addEventListener("pointermove", (event) => {
      if (!down) return;
      const axes = this.axes[0];
      if (down.choose) {
        const box = this.place.getBoundingClientRect();
        chosen.style.left = `${Math.min(down.x, event.clientX) - box.left}px`;
        chosen.style.width = `${Math.abs(event.clientX - down.x)}px`;
        return;
      }
      const shift = ((event.clientX - down.x) * axes.scale / axes.width) * (down.at[1] - down.at[0]);
      this.show(down.at[0] - shift, down.at[1] - shift);
    });
    const up = (event) => {
      if (!down) return;
      if (down.choose) {
        chosen.remove();
        const to = this.axes[0].at(event)[0];
        if (Math.abs(event.clientX - down.x) > 3) this.show(Math.min(down.time, to), Math.max(down.time, to));
      }
      this.place.classList.remove("dragging", "choosing");
      down = null;
    };
    this.place.addEventListener("pointerup", up);
    this.place.addEventListener("pointercancel", up);
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const does = {
      ArrowLeft: () => this.move(-0.2), ArrowRight: () => this.move(0.2), "+": () => this.zoom(0.5),
      "=": () => this.zoom(0.5), "-": () => this.zoom(2), Home: () => this.show(0, this.told.duration_s),
      PageDown: () => this.step(1), PageUp: () => this.step(-1), u: () => this.toggle(),
    }[event.key];
    if (!does) return;
    event.preventDefault();
    does();
  }

  toggle() {
    this.si = !this.si;
    this.dispatchEvent(new Event("units"));
    this.draw();
  }

  // The step after or before the one that begins at the left edge.
  step(by) {
    const starts = this.told.steps.map((s) => s.start_s), slack = 1e-6 + 0.01 * (this.at[1] - this.at[0]);
    const k = by > 0 ? starts.findIndex((s) => s > this.at[0] + slack) : starts.findLastIndex((s) => s < this.at[0] - slack);
    if (k >= 0) this.showStep(k);
  }

  showStep(k) {
    const step = this.told.steps[k];
    if (step) this.show(step.start_s, step.start_s + step.length_s);
  }
}
