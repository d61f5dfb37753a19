// Who holds the controls of a page: this browser's name, a socket that comes back, and the words and buttons of the lease.

export function browserName() {
  let name = sessionStorage.getItem("browser");
  if (!name) {
    name = [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, "0")).join("");
    sessionStorage.setItem("browser", name);
  }
  return name;
}

export function socketAddress(path) {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  return `${scheme}://${location.host}${path}?browser=${browserName()}`;
}

// The words and buttons of a lease; true where this browser holds the controls.
export function showLease(m, $) {
  $("lease-word").textContent = m.mine ? (m.asked ? "another browser asks for the controls" : "you hold the controls")
    : m.asked_by_me ? "asked; waiting for the holder" : m.free ? "nobody holds the controls" : "watching: another browser holds the controls";
  $("ask").hidden = m.mine; $("ask").disabled = m.asked_by_me;
  $("hand_over").hidden = !m.mine || m.browsers < 2;
  $("keep").hidden = !(m.mine && m.asked);
  return m.mine;
}
