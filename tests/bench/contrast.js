// Text of the page whose contrast is too low; see contrast.py.
([least, leastLarge, names]) => {
  const parse = (text) => {
    const found = text.match(/rgba?\(([^)]+)\)/);
    if (!found) return null;
    const [r, g, b, a = 1] = found[1].split(/[\s,/]+/).map(Number);
    return [r, g, b, a];
  };
  const over = (top, below) => [0, 1, 2].map((i) => top[i] * top[3] + below[i] * (1 - top[3])).concat(1);
  const light = (c) => {
    const [r, g, b] = c.map((x) => (x / 255 <= 0.04045 ? x / 255 / 12.92 : ((x / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (a, b) => { const [x, y] = [light(a), light(b)].sort((p, q) => q - p); return (x + 0.05) / (y + 0.05); };
  // All colours that may lie behind an element: a gradient has several.
  const behind = (one) => {
    let layers = [], node = one;
    for (; node; node = node.parentElement) {
      const style = getComputedStyle(node), flat = parse(style.backgroundColor);
      const stops = [...style.backgroundImage.matchAll(/rgba?\([^)]+\)/g)].map((m) => parse(m[0]));
      if (stops.length) return stops.map((stop) => layers.reduceRight((below, layer) => over(layer, below), stop));
      if (flat[3] > 0) layers.push(flat);
      if (flat[3] === 1) break;
    }
    return [layers.reduceRight((below, layer) => over(layer, below), [255, 255, 255, 1])];
  };
  const bad = [];
  for (const one of document.querySelectorAll("body *")) {
    const words = [...one.childNodes].filter((n) => n.nodeType === 3 && n.textContent.trim()).map((n) => n.textContent.trim()).join(" ");
    const value = one.matches("input, textarea, select") ? one.value || one.placeholder : "";
    if (!(words || value) || one.closest(":disabled, script, style, datalist") || !one.checkVisibility({ checkVisibilityCSS: true })) continue;
    const style = getComputedStyle(one), size = parseFloat(style.fontSize);
    const isLarge = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
    for (const below of behind(one)) {
      const found = ratio(over(parse(style.color), below), below);
      if (found < (isLarge ? leastLarge : least)) bad.push(`${one.id || one.className || one.tagName}: "${(words || value).slice(0, 40)}" ${found.toFixed(2)}`);
    }
  }
  const probe = document.createElement("i");
  document.body.append(probe);
  const named = (name) => { probe.style.color = `var(--${name})`; return parse(getComputedStyle(probe).color); };
  for (const name of names) {
    const found = ratio(named(name), named("paper"));
    if (found < least) bad.push(`canvas --${name}: ${found.toFixed(2)}`);
  }
  probe.remove();
  return bad;
}
