// The desk in the browser's language: texts are looked up in a catalogue, numbers in them put back. Decision 498.
// What is data (a name, a note) stands in an element with translate="no" and stays as it is. A text that the catalogue
// lacks as a whole is taken by its parts: what * stands for in a text with names, rows, sentences, and clauses.
(() => {
  const NAMES = { en: "English", de: "Deutsch", fr: "Fran\u00e7ais" };
  const NUMBER = /[-\u2212+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?/g, LETTERS = /\p{L}{2}/u, NAME = /^\S*[._]\S*$/, ATTRIBUTES = ["title", "aria-label", "placeholder"];
  const given = new URLSearchParams(location.search).get("language") ?? localStorage.getItem("language");
  const language = [given].find((x) => x in NAMES || x === "pseudo") ?? navigator.languages.map((x) => x.slice(0, 2)).find((x) => x in NAMES) ?? "en";
  const pseudo = language === "pseudo", comma = localStorage.getItem("decimal") === "comma";
  const JOINTS = [/(\s+[\u00b7\u2192]\s+)/, /(?<=\.)(\s+)(?=\p{Lu})/u, /(;\s+)/, /(: )/, /(, )/];
  let words = null, patterns = []; // patterns: of texts with names, written with * in the catalogue
  const missing = new Set();
  const key = (text) => text.trim().replace(/\s+/g, " ").replace(NUMBER, "#");
  const digits = (text) => (comma ? text.replace(/(\d)\.(?=\d)/g, "$1,") : text);

  // A text in the language of the page; one that the catalogue lacks stays English.
  function say(text) {
    if (!words || !LETTERS.test(text)) return digits(text);
    const own = key(text), [, before, after] = /^(\s*)[^]*?(\s*)$/.exec(text), numbers = text.match(NUMBER) ?? [];
    const found = known(own);
    if (found === null && !NAME.test(own)) missing.add(own);
    if (found === null) return digits(text);
    return before + digits((pseudo ? `\u27e6${own}\u27e7` : found).replace(/#/g, () => numbers.shift() ?? "")) + after;
  }

  // The translation of a text whose numbers are written as #; null where neither it nor all its parts are known.
  function known(own) {
    if (own in words) return words[own];
    for (const [pattern, template] of patterns) {
      const names = pattern.exec(own)?.slice(1);
      if (names) return template.replace(/\*/g, () => { const name = names.shift(); return known(name) ?? name; });
    }
    for (const joint of JOINTS) {
      const parts = own.split(joint);
      if (parts.length < 2) continue;
      const said = parts.map((part) => (LETTERS.test(part) && !NAME.test(part) ? known(part) : part));
      if (!said.includes(null)) return said.join("");
    }
    return null;
  }

  const done = new WeakMap(); // what was written last, by node: its own change is no new text
  const isData = (element) => element?.closest("[translate=no], script, style, textarea, code, kbd") !== null;
  function text(node) {
    if (isData(node.parentElement) || done.get(node) === node.data) return;
    const said = say(node.data);
    done.set(node, said);
    if (said !== node.data) node.data = said;
  }
  function attributes(element) {
    if (isData(element)) return;
    const own = done.get(element) ?? {};
    for (const name of ATTRIBUTES) {
      const value = element.getAttribute(name);
      if (value === null || own[name] === value) continue;
      own[name] = say(value);
      done.set(element, own);
      if (own[name] !== value) element.setAttribute(name, own[name]);
    }
  }
  function tree(root) {
    if (root.nodeType === Node.TEXT_NODE) { text(root); return; }
    if (root.nodeType !== Node.ELEMENT_NODE) return;
    attributes(root);
    const walk = document.createTreeWalker(root, NodeFilter.SHOW_ELEMENT | NodeFilter.SHOW_TEXT);
    while (walk.nextNode()) if (walk.currentNode.nodeType === Node.TEXT_NODE) text(walk.currentNode); else attributes(walk.currentNode);
  }
  function changed(records) {
    for (const one of records) {
      if (one.type === "characterData") text(one.target);
      else if (one.type === "attributes") attributes(one.target);
      else one.addedNodes.forEach(tree);
    }
  }

  globalThis.desk = { say, digits, missing, language };
  addEventListener("DOMContentLoaded", async () => {
    const choice = document.getElementById("language"), point = document.getElementById("decimal");
    choice.value = pseudo ? "en" : language;
    choice.addEventListener("change", () => { localStorage.setItem("language", choice.value); location.reload(); });
    point.checked = comma;
    point.addEventListener("change", () => { localStorage.setItem("decimal", point.checked ? "comma" : "point"); location.reload(); });
    if (language !== "en") {
      words = await (await fetch(`/static/web/languages/${pseudo ? "de" : language}.json`)).json();
      patterns = Object.keys(words).filter((one) => one.includes("*")).sort((a, b) => b.length - a.length).map((one) => {
        const plain = one.split("*").map((part) => part.replace(/[.+?^${}()|[\]\\]/g, "\\$&"));
        return [new RegExp(`^${plain.join("(.+?)").replace(/\(\.\+\?\)$/, "(.*)")}$`), words[one]];
      });
      document.documentElement.lang = pseudo ? "en" : language;
    }
    if (words || comma) {
      tree(document.documentElement);
      new MutationObserver(changed).observe(document.documentElement,
        { subtree: true, childList: true, characterData: true, attributes: true, attributeFilter: ATTRIBUTES });
      dispatchEvent(new Event("themechange")); // canvases draw their words anew
    }
    document.documentElement.dataset.language = language;
  });
})();
