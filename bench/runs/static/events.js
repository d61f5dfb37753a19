// Events of the stretch that the scope shows: marks in the traces, a table for the keyboard, and changes by hand.
import { ask, asked, make } from "./common.js";

const WORDS = { takeoff: "take-off", landing: "landing", impact: "impact" };
const byId = (name) => document.getElementById(name);
const MOST_ROWS = 40;

export class Events {
  // `changed` is called after each change, with the answer
  constructor(scope, api, changed) {
    Object.assign(this, { scope, api, changed, shown: [], newest: 0 });
    scope.events = this;
    byId("undo-event").addEventListener("click", () => this.send({ undo: true }));
    byId("add-event").addEventListener("submit", (event) => {
      event.preventDefault();
      const { kind, at } = event.target.elements;
      if (at.value !== "") this.send({ kind: kind.value, was_s: null, now_shown_s: Number(at.value) });
    });
  }

  // Ask for the events of the stretch once it rests.
  look() {
    clearTimeout(this.soon);
    this.soon = setTimeout(() => this.load().catch((error) => { byId("event-refused").textContent = error.message; }), 150);
  }
  async load() {
    const mine = ++this.newest, [a, b] = this.scope.at;
    const told = await asked(`${this.api}/events?from_s=${a}&to_s=${b}`, () => { byId("event-count").textContent = "finding the events, once \u2026"; });
    if (mine !== this.newest) return;
    const { kind = [], at_s, shown_s, by_hand } = told.events;
    this.shown = told.count > kind.length ? [] : kind.map((k, i) => ({ kind: k, at_s: at_s[i], t: shown_s[i], by_hand: by_hand[i] }));
    const many = told.count >= MOST_ROWS ? `: zoom in to fewer than ${MOST_ROWS} to change one` : "";
    byId("event-count").textContent = `${told.count} event${told.count === 1 ? "" : "s"} in this stretch${many}`;
    byId("by-hand").textContent = told.said.map((line) => `${line}.`).join(" ");
    byId("undo-event").disabled = !told.changes;
    this.scope.canvas.dataset.events = `${told.count} ${told.changes}`;
    byId("events").tBodies[0].replaceChildren(...(many ? [] : this.shown).map((event) => this.row(event)));
    this.scope.changed();
  }

  row(event) {
    const line = make("tr"), name = `${WORDS[event.kind]} at ${event.t.toFixed(6)} s`;
    const time = make("input", "", { type: "number", step: "0.00001", min: "0", "aria-label": `time of the ${name}` });
    time.value = event.t.toFixed(6);
    time.addEventListener("change", () => {
      if (time.value === "") time.value = event.t.toFixed(6); // an empty field is no time
      else this.send({ kind: event.kind, was_s: event.at_s, now_shown_s: Number(time.value) });
    });
    const cell = make("td"), last = make("td"), show = make("button", "show", { type: "button", "aria-label": `show the ${name}` });
    const remove = make("button", "remove", { type: "button", "aria-label": `remove the ${name}` });
    show.addEventListener("click", () => this.scope.look([event.t - 0.002, event.t + 0.002]));
    remove.addEventListener("click", () => this.send({ kind: event.kind, was_s: event.at_s, now_shown_s: null }));
    cell.append(time);
    last.append(show, " ", remove);
    line.append(make("td", WORDS[event.kind]), cell, make("td", event.by_hand ? "by hand" : "found"), last);
    return line;
  }

  async send(change) {
    byId("event-refused").textContent = "";
    try {
      const told = await ask(`${this.api}/events`, { method: "POST", body: JSON.stringify(change) });
      this.changed(told);
      await this.load();
    } catch (error) {
      byId("event-refused").textContent = error.message;
    }
  }

  // The event near a place in the scope, where they may be dragged.
  near(t, reach_s) {
    if (!byId("drag-events").checked) return null;
    const best = this.shown.reduce((a, b) => (a && Math.abs(a.t - t) <= Math.abs(b.t - t) ? a : b), null);
    return best && Math.abs(best.t - t) < reach_s ? best : null;
  }
  drop(event, t) { this.send({ kind: event.kind, was_s: event.at_s, now_shown_s: t }); }

  // A triangle that points up for a take-off, down for a landing, a square for an impact; filled where it was set by hand.
  draw(axes, colour) {
    const pen = axes.pen, r = 5 * axes.unit, y = axes.top + axes.height - 2 * r;
    for (const event of this.shown) {
      const x = axes.px(event.moving ?? event.t), up = event.kind === "takeoff" ? -1 : 1;
      pen.beginPath();
      if (event.kind === "impact") pen.rect(x - 0.8 * r, y - 0.8 * r, 1.6 * r, 1.6 * r);
      else { pen.moveTo(x - r, y - up * r); pen.lineTo(x + r, y - up * r); pen.lineTo(x, y + up * r); pen.closePath(); }
      pen.strokeStyle = pen.fillStyle = colour;
      if (event.by_hand) pen.fill();
      pen.stroke();
    }
  }
}
