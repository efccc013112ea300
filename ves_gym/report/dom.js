// What the pages share: elements, numbers, drawing again.

const $ = (id) => document.getElementById(id);

/** An HTML element. Text is only ever set as text: names in the data are not markup. */
function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  return fill(node, attributes, children);
}

/** An SVG element; the namespace is taken from one that is on the page. */
function svg(tag, attributes = {}, ...children) {
  const node = document.createElementNS(document.querySelector("svg").namespaceURI, tag);
  return fill(node, attributes, children);
}

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined) node.setAttribute(name, value);
  }
  node.append(...children.filter((child) => child !== null));
  return node;
}

// ---------------------------------------------------------------------- numbers

/** Three significant digits, or an en dash where there is no number. */
function number(value, digits = 3) {
  if (typeof value !== "number" || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size < 1e-4 || size >= 1e6) return value.toExponential(digits - 1).replace("-", "−");
  const text = size >= 10 ** digits ? value.toFixed(0) : value.toPrecision(digits);
  return text.replace("-", "−");
}

const percent = (value) => (value === null ? "–" : `${number(100 * value, 2)} %`);
const signed = (value) => (value > 0 ? `+${percent(value)}` : percent(value));
const span = (low, high) => (low === high ? "–" : `${number(low, 2)} – ${number(high, 2)}`);

function listed(items) {
  if (items.length < 2) return items.join("");
  return `${items.slice(0, -1).join(", ")} and ${items.at(-1)}`;
}

/** Round steps between low and high, about `count` of them. */
function ticks(low, high, count) {
  const raw = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = power * [1, 2, 5, 10].find((k) => k * power >= raw * 0.999);
  const out = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) {
    out.push(Number((k * step).toPrecision(12)));
  }
  return out;
}

// ------------------------------------------------------------------------ drawing

const redraws = []; // what to draw again when the colour scheme or the width changes
function redrawn(draw) {
  redraws.push(draw);
  draw();
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraws.forEach((d) => d()));
let width = innerWidth;
addEventListener("resize", () => {
  if (innerWidth === width) return;
  width = innerWidth;
  requestAnimationFrame(() => redraws.forEach((d) => d()));
});

/** "E_mean" as E with a subscript; other text as it is. */
function symbol(text) {
  const [letter, below] = text.split("_");
  return below ? el("span", {}, letter, el("sub", {}, below)) : text;
}
