// Arming: what is armed, shown once a second; a person arms one profile for one call.
const byId = (name) => document.getElementById(name);

async function ask(profile) {
  const answer = await fetch("/agent/armed", profile === undefined ? {} : { method: "POST", body: JSON.stringify({ profile }) });
  const told = await answer.json();
  byId("refused").textContent = answer.ok ? "" : told.error;
  if (!answer.ok) return;
  const name = document.createElement("strong");
  name.translate = false;
  name.textContent = told.profile ?? "";
  byId("armed").replaceChildren(...(told.profile ? [name, " is armed for one call", `, ${Math.round(told.left_s)} s left`] : ["Nothing is armed."]));
}

byId("arm").addEventListener("submit", (event) => { event.preventDefault(); ask(event.target.elements.profile.value); });
byId("disarm").addEventListener("click", () => ask(null));
ask();
setInterval(ask, 1000);
