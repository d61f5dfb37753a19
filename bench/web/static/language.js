// The desk in the browser's language: texts are looked up in a catalogue, numbers in them put back. Decision 498.
// What is data (a name, a note, a verdict's sentence) stands in an element with translate="no" and stays as it is.
(() => {
  const NAMES = { en: "English", de: "Deutsch", fr: "Fran\u00e7ais" };
  const NUMBER = /[-\u2212+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?/g, LETTERS = /\p{L}{2}/u, NAME = /^\S*[._]\S*$/, ATTRIBUTES = ["title", "aria-label", "placeholder"];
  const given = new URLSearchParams(location.search).get("language") ?? localStorage.getItem("language");
  const language = [given].find((x) => x in NAMES || x === "pseudo") ?? navigator.languages.map((x) => x.slice(0, 2)).find((x) => x in NAMES) ?? "en";
  const pseudo = language === "pseudo", comma = localStorage.getItem("decimal") === "comma";
  let words = null, starts = []; // starts: of texts that end with a name, written with * in the catalogue
  const missing = new Set();
  const key = (text) => text.trim().replace(/\s+/g, " ").replace(NUMBER, "#");
  const digits = (text) => (comma ? text.replace(/(\d)\.(?=\d)/g, "$1,") : text);

  // A text in the language of the page; one that the catalogue lacks stays English.
  function say(text) {
    if (!words || !LETTERS.test(text)) return digits(text);
    const own = key(text), [, before, after] = /^(\s*)[^]*?(\s*)$/.exec(text);
    if (!(own in words) && own.includes(" \u00b7 ")) return text.split(/(\s*\u00b7\s*)/).map(say).join("");
    const start = own in words ? null : starts.find((one) => own.startsWith(one));
    if (!start && !(own in words)) { if (!NAME.test(own)) missing.add(own); return digits(text); }
    const numbers = text.match(NUMBER) ?? [];
    const said = (pseudo ? `\u27e6${own}\u27e7` : start ? words[`${start}*`].replace("*", own.slice(start.length)) : words[own]).replace(/#/g, () => numbers.shift() ?? "");
    return before + digits(said) + after;
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
      starts = Object.keys(words).filter((one) => one.endsWith("*")).map((one) => one.slice(0, -1));
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
