// Shared by the pages with moving pictures: data, colours, canvases.

const data = JSON.parse(document.getElementById("data").textContent);

const names = (data.planners ?? []).map((planner) => planner.name);

/** [place in the palette, dash] of a planner; the rule of planner_styles.py. */
const unlisted = names.filter((name) => !Object.hasOwn(STYLES, name));
function styleOf(planner) {
  if (Object.hasOwn(STYLES, planner)) return STYLES[planner];
  const at = Math.max(0, unlisted.indexOf(planner));
  return OTHER_STYLES[at % OTHER_STYLES.length];
}
const colour = (planner) => `var(--s${styleOf(planner)[0]})`;
const dash = (planner) => styleOf(planner)[1];
/** A colour of the style sheet, resolved for a canvas. */
const ink = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

function swatch(planner, plain = false) {
  const line = svg("line", {
    x1: 0, x2: 22, y1: 6, y2: 6, "stroke-width": 3, "stroke-dasharray": plain ? "" : dash(planner),
    style: `stroke:${colour(planner)}`,
  });
  return svg("svg", { class: "swatch", viewBox: "0 0 22 12", "aria-hidden": "true" }, line);
}

/** A canvas made sharp for this screen: its context in CSS pixels (or its paper), and its size. */
function sharp(canvas) {
  const { clientWidth: w, clientHeight: h } = canvas;
  if (canvas.paper) return { ctx: canvas.paper, w, h };
  const ratio = devicePixelRatio || 1;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, w, h);
  return { ctx, w, h };
}
