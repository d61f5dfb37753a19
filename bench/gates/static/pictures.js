// The pictures of the gates: the rig with the wires that matter at a gate drawn thick, and what the ramp will do.
const NS = "http://www.w3.org/2000/svg";

export function svg(tag, attributes = {}, words) {
  const one = document.createElementNS(NS, tag);
  for (const [name, value] of Object.entries(attributes)) one.setAttribute(name, value);
  if (words !== undefined) one.textContent = words;
  return one;
}

const WIRES = {
  out: "M172 176 H204 V236 H218", power: "M312 236 H346", loop: "M172 200 H190 V176",
  accelerometer: "M438 190 H452 V292 H186 V224 H172", contact: "M404 152 H472 V308 H180 V248 H172",
};
const SHOWN = {
  card: ["out", "loop"], wiring: ["accelerometer", "contact"], calibrate: ["accelerometer", "out", "power", "loop"],
  check: Object.keys(WIRES), ramp: Object.keys(WIRES), verdict: [],
};
const HINTS = {
  card: [[8, 20, "1. Loop the output back into the input \u201cdrive\u201d."], [8, 38, "2. Leave the amplifier off: a chirp is played."]],
  wiring: [[8, 20, "Tap the plate: the accelerometer answers."], [8, 38, "Lift the ball: the contact circuit opens."]],
  calibrate: [[8, 20, "Turn the accelerometer over and back (flip test)."], [8, 38, "Then the plate moves a little, the ball resting on it."]],
  check: [[8, 20, "Amplifier on, ball on the plate, hands off."], [8, 38, "A chirp, a quiet tone, a short flight."]],
  ramp: [[8, 20, "Everything as it was for the check."], [8, 38, "Hands off the plate: it will move."]],
  verdict: [[8, 20, "The recording is compared with the model,"], [8, 38, "and what is missing is looked for by name."]],
};

// The rig at a gate; `terminals` names the plug of each channel.
export function rigPicture(gate, view) {
  const all = svg("svg", { viewBox: "0 0 480 316", role: "img", "aria-label": HINTS[gate].map((one) => one[2]).join(" ") });
  for (const [name, path] of Object.entries(WIRES)) all.append(svg("path", { d: path, class: `wire${SHOWN[gate].includes(name) ? " on" : ""}` }));
  const box = (x, y, width, height) => all.append(svg("rect", { x, y, width, height, rx: 4, class: "thing" }));
  const say = (x, y, words, name = "") => all.append(svg("text", { x, y, class: name }, words));
  box(4, 150, 168, 120);
  box(218, 216, 94, 40); say(224, 241, gate === "card" ? "amplifier off" : "amplifier");
  box(346, 206, 84, 70); say(364, 246, "shaker");
  box(381, 178, 10, 28); box(328, 168, 116, 10); box(422, 178, 18, 16);
  box(368, 136, 34, 32); all.append(svg("path", { d: "M385 136 V70", class: "wire" })); say(392, 90, "rod"); say(374, 156, "ball");
  say(288, 176, "plate");
  say(8, 144, view.simulated ? "simulated rig" : view.backend === "soundcard" ? "sound card" : "device");
  const names = view.terminals ?? {};
  say(10, 180, view.output ? `output ${view.output}: drive out` : "drive out");
  say(10, 204, `${names.drive ?? "input"}: drive back`);
  say(10, 228, `${names.accelerometer ?? "input"}: acceleration`);
  say(10, 252, `${names.continuity ?? "none"}: contact`);
  if (gate === "wiring" || gate === "calibrate") all.append(svg("path", { d: gate === "wiring" ? "M340 124 V160 M332 150 L340 162 L348 150 M356 128 V96 M348 106 L356 94 L364 106" : "M448 206 A 16 16 0 1 1 434 202 M434 202 l-9 -5 m9 5 l-6 8", class: "hand" }));
  if (gate === "check" || gate === "ramp") all.append(svg("path", { d: "M320 184 V204 M312 192 L320 182 L328 192 M312 198 L320 208 L328 198", class: "hand" }));
  for (const [x, y, words] of HINTS[gate]) say(x, y, words, "hint");
  return all;
}

// Drive, plate displacement and acceleration over the time of the ramp, against their limits.
export function rampPictures(plan) {
  const kinds = [["drive", "V", 2, "drive_v"], ["plate displacement", "mm", 3, "displacement_mm"], ["plate acceleration", "m/s\u00b2", 4, "plate_mps2"]];
  return kinds.map(([name, unit, column, key]) => {
    const limit = plan.limits[key], highest = Math.max(...plan.steps.map((step) => step[column])), top = 1.08 * Math.max(limit, highest);
    const end = plan.steps.at(-1)[1], x = (t) => (300 * t) / end, y = (v) => 100 - (100 * v) / top;
    const line = plan.steps.map((step) => `${x(step[0]).toFixed(2)},${y(step[column]).toFixed(2)} ${x(step[1]).toFixed(2)},${y(step[column]).toFixed(2)}`).join(" ");
    const words = `${name}: up to ${highest.toPrecision(3)} ${unit}, limit ${limit.toPrecision(3)} ${unit}`;
    const picture = svg("svg", { viewBox: "0 0 300 100", preserveAspectRatio: "none", role: "img", "aria-label": words });
    picture.append(svg("line", { x1: 0, x2: 300, y1: y(limit), y2: y(limit), class: "limit" }), svg("polyline", { points: line, class: "line" }));
    const figure = document.createElement("figure"), caption = document.createElement("figcaption");
    caption.textContent = words;
    figure.append(caption, picture);
    return figure;
  });
}
