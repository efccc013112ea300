
// Charts: curves with bands and a cursor, bars with intervals.

const EDGE = { left: 52, right: 14, top: 14, bottom: 38 };
const finite = (value) => typeof value === "number" && Number.isFinite(value);

/** A map from values to pixels, and its round marks; logarithmic if asked. */
function axis(low, high, from, to, log, count) {
  const f = log ? Math.log : (k) => k;
  const back = log ? Math.exp : (k) => k;
  const [a, b] = [f(low), f(high)];
  const scale = (to - from) / ((b - a) || 1);
  return {
    at: (value) => from + scale * (f(Math.max(value, log ? 1e-300 : value)) - a),
    value: (pixel) => back(a + (pixel - from) / scale),
    marks: log ? logMarks(low, high, count) : ticks(low, high, count),
  };
}

/** 1, 2, 5 of every decade between two values; fewer where they would crowd. */
function logMarks(low, high, count) {
  const powers = Array.from({ length: 40 }, (_, k) => k - 20);
  for (const steps of [[1, 1.5, 2, 3, 5, 7], [1, 2, 5], [1, 3], [1]]) {
    const marks = powers.flatMap((p) => steps.map((s) => Number((s * 10 ** p).toPrecision(3))))
      .filter((v) => v >= low * 0.999 && v <= high * 1.001);
    if (marks.length <= count && marks.length > 1) return marks;
  }
  const most = powers.map((p) => 10 ** p).filter((v) => v >= low && v <= high);
  return most.length > 1 ? most : [low, high].map((v) => Number(v.toPrecision(2)));
}

/**
 * Curves in an SVG, with a cursor that pointer and arrow keys move.
 *
 * chart: { at, log, x, y, yLog, top, curves: [{ style, dash, value, low, high }], dots }
 * show(k): told the index of the cursor, or null.
 */
function drawChart(node, chart, show) {
  const w = node.clientWidth || 560;
  const h = node.clientHeight || 320;
  node.setAttribute("viewBox", `0 0 ${w} ${h}`);
  const { at } = chart;
  const x = axis(at[0], at.at(-1), EDGE.left, w - EDGE.right, chart.log, w / 70);
  const [low, high] = chart.range;
  const y = axis(low, high, h - EDGE.bottom, EDGE.top, chart.yLog, h / 45);
  const grid = svg("g");
  for (const mark of y.marks) {
    grid.append(svg("line", { class: "grid", x1: EDGE.left, x2: w - EDGE.right, y1: y.at(mark), y2: y.at(mark) }),
      svg("text", { x: EDGE.left - 7, y: y.at(mark) + 4, "text-anchor": "end" }, chart.percent ? percent(mark) : short(mark)));
  }
  for (const mark of x.marks) {
    grid.append(svg("text", { x: x.at(mark), y: h - EDGE.bottom + 17, "text-anchor": "middle" }, short(mark)));
  }
  grid.append(svg("text", { x: w - EDGE.right, y: h - 5, "text-anchor": "end" }, chart.x));
  const cursor = svg("g");
  node.replaceChildren(grid, ...chart.curves.flatMap((curve) => drawn(curve, at, x, y)), cursor);

  let place = null;
  const move = (k) => {
    place = k === null ? null : Math.min(Math.max(k, 0), at.length - 1);
    show(place);
    cursor.replaceChildren(...(place === null ? [] : [
      svg("line", { class: "cursor", x1: x.at(at[place]), x2: x.at(at[place]), y1: EDGE.top, y2: h - EDGE.bottom }),
      ...chart.curves.filter((c) => c.value && finite(c.value[place])).map((c) => svg("circle", {
        cx: x.at(at[place]), cy: y.at(c.value[place]), r: 3.5, style: `fill:${c.colour}`,
      })),
    ]));
  };
  node.onpointermove = (event) => {
    const value = x.value((event.clientX - node.getBoundingClientRect().left) * w / node.clientWidth);
    move(at.reduce((best, v, k) => (Math.abs(x.at(v) - x.at(value)) < Math.abs(x.at(at[best]) - x.at(value)) ? k : best), 0));
  };
  node.onpointerleave = node.onblur = () => move(null);
  node.onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    move(place === null ? (step > 0 ? 0 : at.length - 1) : place + step);
  };
}

const short = (value) => String(Number(value.toPrecision(3))).replace("-", "−");

/** Band, line and dot of one curve: a value holds until the next; where it is missing, a gap. */
function drawn(curve, at, x, y) {
  const [h, v] = [(k) => `H${x.at(at[k]).toFixed(1)}`, (value) => `V${y.at(value).toFixed(1)}`];
  const start = (value, k) => `M${x.at(at[k]).toFixed(1)} ${y.at(value).toFixed(1)}`;
  const parts = [];
  if (curve.low) {
    let d = start(curve.low[0], 0) + v(curve.high[0]);
    for (let k = 1; k < at.length; k++) d += h(k) + v(curve.high[k]);
    for (let k = at.length - 1; k > 0; k--) d += v(curve.low[k]) + v(curve.low[k - 1]) + h(k - 1);
    parts.push(svg("path", { class: "band", style: `fill:${curve.colour}`, d: `${d}Z` }));
  }
  if (curve.value) {
    let d = "";
    curve.value.forEach((value, k) => {
      if (finite(value)) d += d && finite(curve.value[k - 1]) ? h(k) + v(value) : start(value, k);
    });
    parts.push(svg("path", { class: "curve", style: `stroke:${curve.colour}`, "stroke-dasharray": curve.dash, d }));
  }
  if (curve.dot && curve.dot.every(finite)) {
    const [cx, cy] = [x.at(curve.dot[0]), y.at(curve.dot[1])];
    parts.push(svg("circle", { class: "dot", cx, cy, r: 5, style: `fill:${curve.colour}` }));
  }
  return parts;
}

// ------------------------------------------------------------------------- bars

const BAR = { w: 150, h: 22, pad: 5 };

/** The axis all bars of a group share: from 0 if scores are above it and of one size. */
function barAxis({ entries, reference }) {
  const some = entries.filter((e) => finite(e.score[0]));
  const scores = some.map((e) => e.score[0]);
  const ends = some.flatMap((e) => e.score).filter(finite);
  if (ends.length === 0) return null;
  const sorted = [...scores].sort((a, b) => a - b);
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const log = low > 0 && sorted.at(-1) / sorted[0] > 12;
  const margin = 0.04 * (high - low) || 0.04 * Math.abs(high) || 1;
  const from = log ? low / 1.15 : low < 0 ? low - margin : 0;
  const to = high + margin;
  const pixels = axis(from, to, BAR.pad, BAR.w - BAR.pad, log, 3);
  return { ...pixels, from, to, log, bars: from === 0, mark: reference > from && reference < to ? reference : null };
}

/** The score as a dot, with a bar where there is a 0 to begin from; its interval as a whisker. */
function scoreBar([value, low, high], scale) {
  const picture = svg("svg", { class: "bar", viewBox: `0 0 ${BAR.w} ${BAR.h}`, "aria-hidden": "true" });
  if (scale === null || !finite(value)) {
    picture.append(svg("path", { class: "beyond", d: `M${BAR.w - 16} 6l5 5l-5 5m6 -10l5 5l-5 5` }));
    return picture;
  }
  const [x, middle, end] = [scale.at, BAR.h / 2, BAR.w - BAR.pad];
  if (scale.bars) {
    picture.append(svg("rect", { class: "amount", x: x(0), y: 6, width: x(value) - x(0), height: 10, rx: 1.5 }));
  }
  picture.append(svg("path", { class: "track", d: `M${BAR.pad} ${middle}H${end}` }));
  if (scale.mark !== null) {
    picture.append(svg("path", { class: "one", d: `M${x(scale.mark)} 2V${BAR.h - 2}` }));
  }
  const to = finite(high) ? x(high) : end;
  const from = finite(low) ? x(low) : x(value);
  picture.append(
    svg("path", { class: "whisker", d: `M${from} ${middle}H${to}M${from} 7V15${finite(high) ? `M${to} 7V15` : ""}` }),
    svg("circle", { class: "point", cx: x(value), cy: middle, r: 2.6 }),
  );
  if (!finite(high)) picture.append(svg("path", { class: "beyond", d: `M${BAR.w - 9} 7l5 4l-5 4` }));
  return picture;
}
