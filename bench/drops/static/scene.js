// One file of a drop test: its sound, its track or its times, with the impacts, which are dragged, added and taken away.
import { Axes, colours } from "/static/web/plot.js";
import { savers } from "/static/web/save.js";

const NEAR = 7; // css px within which a pointer means a mark
const make = (name, text = "", attributes = {}) => {
  const one = document.createElement(name);
  one.textContent = text;
  for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
  return one;
};

export class Scene extends EventTarget {
  // Dispatches "correct" with {file, gone_s, new_s, same_s}.
  constructor(place, number) {
    super();
    Object.assign(this, { number, file: null, plot: null, chosen: null, drag: null, wave: null, mine: false, at: [0, 1] });
    this.box = make("section", "", { class: "panel", "aria-label": `file ${number + 1}` });
    this.head = make("div", "", { class: "tools" });
    this.name = make("strong");
    this.where = make("span", "", { class: "mono faint", role: "status" });
    this.head.append(this.name, this.where, make("span", "", { class: "grow" }));
    for (const [words, does] of [["\u2212", () => this.zoom(2)], ["+", () => this.zoom(0.5)], ["all", () => this.show(0, this.file.duration_s)],
      ["impacts", () => this.show(...this.file.span)]]) {
      const button = make("button", words, { type: "button" });
      button.addEventListener("click", does);
      this.head.append(button);
    }
    savers(this.head, "impacts", () => [this.canvas], () => [["impact", "time (s)"], ...(this.file?.impacts ?? []).map((one, k) => [k + 1, one.t])]);
    this.canvas = make("canvas", "", { class: "scene", tabindex: "0", role: "application", "data-file": number,
      "aria-label": "impacts over time; the table below holds the same" });
    this.hint = make("p", "", { class: "faint hint" });
    this.hint.textContent = "drag an impact to move it \u00b7 double click: add one \u00b7 click and Delete: take it away \u00b7 wheel: zoom \u00b7 drag elsewhere: move along";
    this.table = make("table");
    const holder = make("div", "", { class: "impacts" });
    holder.append(this.table);
    const row = make("div", "", { class: "scenes" }), left = make("div");
    left.append(this.canvas, this.hint);
    this.film = make("img", "", { class: "film", alt: "the ball stamped from every few frames, with its measured centres", hidden: "" });
    row.append(this.film, left, holder);
    this.box.append(this.head, row);
    place.append(this.box);
    this.axes = new Axes(this.canvas, { left: 62, right: 14, top: 8 });
    new ResizeObserver(() => { this.axes.fit(); this.ask(); this.draw(); }).observe(this.canvas);
    addEventListener("themechange", () => this.draw());
    this.pointer();
    this.canvas.addEventListener("keydown", (event) => this.key(event));
  }

  // New marks; the view stays where a person left it.
  set(file, plot) {
    const first = this.file === null || this.file.name !== file.name;
    this.file = file;
    this.plot = plot;
    this.chosen = null;
    this.drag = null;
    this.name.textContent = file.name;
    this.canvas.classList.toggle("times", file.kind === "times");
    this.film.hidden = !file.picture;
    if (file.picture) this.film.src = `/drop/picture/${this.number}?${Date.now()}`;
    this.axes.options.x = file.seconds ? "time in the file (s)" : "frame";
    this.axes.options.y = { sound: "amplitude", path: "height (file's unit)", times: "" }[file.kind];
    if (first) { this.wave = null; this.show(...file.span); }
    this.list();
    this.draw();
  }

  controls(mine) { this.mine = mine; if (this.file) this.list(); }

  show(a, b) {
    const all = Math.max(this.file.duration_s, this.file.span[1]), span = Math.min(Math.max(b - a, 1e-4), 1.02 * all);
    const start = Math.min(Math.max(a, -0.01 * all), 1.01 * all - span);
    this.at = [start, start + span];
    this.ask();
    this.draw();
  }

  zoom(factor, about = 0.5 * (this.at[0] + this.at[1])) {
    this.show(about - (about - this.at[0]) * factor, about + (this.at[1] - about) * factor);
  }

  // Ask for the stretch of the sound that is shown; one question at a time, the latest wish next.
  async ask() {
    if (!this.file || this.file.kind !== "sound") return;
    this.axes.fit();
    if (this.asking) { this.again = true; return; }
    this.asking = true;
    const [a, b] = this.at, width = Math.min(8192, Math.max(64, Math.round(this.axes.width)));
    const answer = await fetch(`/drop/wave?file=${this.number}&start_s=${Math.max(a, 0)}&stop_s=${b}&width=${width}`,
      { headers: { accept: "application/json" } }).catch(() => null);
    if (answer?.ok) this.wave = await answer.json();
    this.asking = false;
    this.draw();
    if (this.again) { this.again = false; this.ask(); }
  }

  draw() {
    if (this.drawing || !this.file) return;
    this.drawing = requestAnimationFrame(() => { this.drawing = null; this.paint(); });
  }

  paint() {
    const axes = this.axes, c = colours(), file = this.file;
    axes.xlim = this.at;
    axes.ylim = this.limits();
    axes.clear();
    axes.frame();
    if (file.kind === "times") this.hideNumbers();
    axes.inside(() => {
      if (file.kind === "sound" && this.wave) axes.envelope(this.wave.time_s, this.wave.low, this.wave.high, c.floor);
      if (file.kind === "path" && file.track) this.track();
      this.marks();
    });
    this.canvas.dataset.impacts = file.impacts.map((one) => one.t.toFixed(6)).join(" ");
    this.canvas.dataset.view = this.at.join(" ");
  }

  hideNumbers() {
    const axes = this.axes, pen = axes.pen;
    pen.fillStyle = colours().paper;
    pen.fillRect(0, 0, axes.left - axes.unit, axes.top + axes.height);
  }

  limits() {
    const file = this.file;
    let values = [-1, 1];
    if (file.kind === "sound" && this.wave?.low.length) {
      const top = Math.max(...this.wave.high, ...this.wave.low.map((v) => -v), 1e-6);
      values = [-top, top];
    }
    if (file.kind === "path" && file.track) values = [Math.min(...file.track.y), Math.max(...file.track.y)];
    const margin = 0.08 * (values[1] - values[0]) || 1;
    return [values[0] - margin, values[1] + margin];
  }

  track() {
    const axes = this.axes, c = colours(), file = this.file;
    axes.dots(file.track.x, file.track.y, c.measured, 3.5);
    const model = this.plot?.models.at(-1);
    model?.pieces.forEach((piece, k) => {
      if (this.plot.clips[k] === file.item) axes.line(piece.x, piece.y, c.c0, 1.4);
    });
  }

  marks() {
    const axes = this.axes, c = colours(), file = this.file, pen = axes.pen, bottom = axes.top + axes.height;
    const line = (t, style, width, dash = []) => {
      pen.strokeStyle = style; pen.lineWidth = width * axes.unit; pen.setLineDash(dash.map((d) => d * axes.unit));
      pen.beginPath(); pen.moveTo(axes.px(t), axes.top); pen.lineTo(axes.px(t), bottom); pen.stroke(); pen.setLineDash([]);
    };
    for (const t of file.events) { // heard, whatever it is
      pen.fillStyle = c.faint;
      pen.fillRect(axes.px(t) - axes.unit, bottom - 8 * axes.unit, 2 * axes.unit, 8 * axes.unit);
    }
    for (const t of file.ignored) line(t, c.faint, 1, [2, 5]);
    for (const t of file.false) this.sign("\u00d7", t, 0.12, c.ink);
    for (const t of file.missed) this.sign("\u25bc missed", t, 0.08, c.bad);
    file.impacts.forEach((one, k) => {
      const t = this.drag?.k === k ? this.drag.t : one.t;
      const style = one.how === "irregular" ? c.warn : one.how === "landing" ? c.faint : c.c0;
      line(t, style, k === this.chosen || this.drag?.k === k ? 3.5 : 1.5, one.how === "landing" ? [5, 4] : []);
      if (file.added.some((a) => Math.abs(a - one.t) <= file.same_s)) this.sign("\u270e", t, 0.06, style);
    });
  }

  sign(words, t, part, style) {
    const axes = this.axes, pen = axes.pen;
    pen.fillStyle = style; pen.textAlign = "center"; pen.textBaseline = "middle";
    pen.fillText(words, axes.px(t), axes.top + part * axes.height);
  }

  // The impact under a pointer; null where there is none.
  near(event) {
    const x = (event.clientX - this.canvas.getBoundingClientRect().left) * this.axes.scale;
    let best = null, least = NEAR * this.axes.scale;
    this.file?.impacts.forEach((one, k) => {
      const off = Math.abs(this.axes.px(one.t) - x);
      if (off <= least) { least = off; best = k; }
    });
    return best;
  }

  correct(gone_s, new_s) {
    this.dispatchEvent(new CustomEvent("correct", { detail: { file: this.number, gone_s, new_s, same_s: this.file.same_s } }));
  }

  // An event that was heard, or one taken away, within reach of a time; else the time itself.
  snapped(t) {
    const reach = (NEAR * this.axes.scale / this.axes.width) * (this.at[1] - this.at[0]);
    const known = [...this.file.ignored, ...this.file.events, ...this.file.false].filter((one) => Math.abs(one - t) <= reach);
    return known.sort((a, b) => Math.abs(a - t) - Math.abs(b - t))[0] ?? t;
  }

  pointer() {
    let pan = null;
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (this.file) this.zoom(Math.exp(Math.max(-1, Math.min(1, event.deltaY / 240))), this.axes.at(event)[0]);
    }, { passive: false });
    this.canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.file) return;
      this.canvas.focus({ preventScroll: true });
      this.canvas.setPointerCapture(event.pointerId);
      const k = this.near(event);
      this.chosen = k;
      if (k !== null && this.mine && this.file.impacts[k].how !== "landing") this.drag = { k, t: this.file.impacts[k].t, x: event.clientX, moved: false };
      else pan = { x: event.clientX, at: [...this.at] };
      this.choose();
      this.draw();
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!this.file) return;
      const t = this.axes.at(event)[0];
      this.where.textContent = `${t.toFixed(4)}${this.file.seconds ? " s" : ""}`;
      if (this.drag) {
        this.drag.moved ||= Math.abs(event.clientX - this.drag.x) > 2;
        if (this.drag.moved) { this.drag.t = t; this.draw(); }
      } else if (pan) {
        const by = ((event.clientX - pan.x) * this.axes.scale / this.axes.width) * (pan.at[1] - pan.at[0]);
        this.show(pan.at[0] - by, pan.at[1] - by);
      } else this.canvas.classList.toggle("near", this.near(event) !== null);
    });
    const up = () => {
      if (this.drag?.moved) this.correct(this.file.impacts[this.drag.k].t, this.drag.t);
      else this.drag = null;
      pan = null;
      this.draw();
    };
    this.canvas.addEventListener("pointerup", up);
    this.canvas.addEventListener("pointercancel", () => { this.drag = null; pan = null; this.draw(); });
    this.canvas.addEventListener("dblclick", (event) => {
      if (this.file && this.mine && this.near(event) === null) this.correct(null, this.snapped(this.axes.at(event)[0]));
    });
  }

  key(event) {
    if (!this.file || event.ctrlKey || event.altKey || event.metaKey) return;
    const span = this.at[1] - this.at[0], one = this.file.impacts[this.chosen];
    const step = (by) => { const n = this.file.impacts.length; if (n) { this.chosen = this.chosen === null ? 0 : (this.chosen + by + n) % n; this.choose(); this.draw(); } };
    const does = {
      Delete: () => one && this.correct(one.t, null), Backspace: () => one && this.correct(one.t, null),
      n: () => step(1), p: () => step(-1),
      ArrowLeft: () => this.show(this.at[0] - 0.2 * span, this.at[1] - 0.2 * span),
      ArrowRight: () => this.show(this.at[0] + 0.2 * span, this.at[1] + 0.2 * span),
      "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2), Home: () => this.show(0, this.file.duration_s),
    }[event.key];
    if (!does) return;
    event.preventDefault();
    does();
  }

  choose() {
    [...(this.table.tBodies[0]?.rows ?? [])].forEach((row, k) => row.classList.toggle("chosen", k === this.chosen));
  }

  // The same impacts as a table: times can be typed.
  list() {
    const head = make("thead"), body = make("tbody"), first = make("tr"), unit = this.file.seconds ? "s" : "frame";
    for (const words of ["#", `impact (${unit})`, this.file.seconds ? "to the next (ms)" : "to the next", "", ""]) first.append(make("th", words, { class: "number" }));
    head.append(first);
    this.file.impacts.forEach((one, k) => {
      const row = make("tr"), next = this.file.impacts[k + 1], cell = make("td"), last = make("td");
      const field = make("input", "", { value: one.t.toFixed(this.file.seconds ? 5 : 2), "aria-label": `impact ${k + 1}`, inputmode: "decimal" });
      const fixed = one.how === "landing" || !this.mine;
      field.disabled = fixed;
      field.addEventListener("change", () => { const t = Number(field.value.replace(",", ".")); if (isFinite(t) && t !== one.t) this.correct(one.t, t); });
      cell.append(field);
      const button = make("button", "\u2715", { type: "button", "aria-label": `take impact ${k + 1} away`, title: "take away" });
      button.disabled = fixed;
      button.addEventListener("click", () => this.correct(one.t, null));
      last.append(button);
      const flight = next && next.drop === one.drop ? (next.t - one.t) * (this.file.seconds ? 1e3 : 1) : null;
      row.append(make("td", String(k + 1), { class: "number" }), cell, make("td", flight === null ? "\u2013" : flight.toFixed(2), { class: "number" }),
        make("td", one.how === "impact" ? "" : one.how), last);
      body.append(row);
    });
    this.table.replaceChildren(head, body);
  }
}
