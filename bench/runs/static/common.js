// What the pages of the runs share: questions to the server, and elements made of text alone.

export async function ask(address, options = {}) {
  const answer = await fetch(address, { headers: { accept: "application/json" }, ...options });
  const told = await answer.json().catch(() => ({ error: `${answer.status} ${answer.statusText}` }));
  if (!answer.ok) throw new Error(told.error ?? `status ${answer.status}`);
  return told;
}

export const wait = (ms) => new Promise((done) => setTimeout(done, ms));

// Ask until the answer is ready; the server makes at the first question what it does not have.
export async function asked(address, meanwhile = () => {}) {
  for (let pause = 100; ; pause = Math.min(1000, pause * 1.5)) {
    const told = await ask(address);
    if (told.state !== "working") return told;
    meanwhile();
    await wait(pause);
  }
}

// An element; text is never taken for HTML.
export function make(name, text = "", attributes = {}) {
  const element = document.createElement(name);
  element.textContent = text;
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

export const gammas = (run) =>
  run.gamma_low === null ? "-" : run.gamma_high - run.gamma_low < 5e-4 ? run.gamma_low.toFixed(3)
    : `${run.gamma_low.toFixed(3)} to ${run.gamma_high.toFixed(3)}`;

export const day = (date) => (date ?? "-").slice(0, 16).replace("T", " ");

export const shown = (value, digits = 4) =>
  value === null || value === undefined ? "-" : Number(value.toPrecision(digits)).toString();
