// Energy against time, and coupling maps.

// -------------------------------------------------------------- energy against time

const traces = data.traces ?? [];
const QUANTITIES = {
  E: { label: "E [J]", unit: "J", of: ({ E }) => E },
  strain: { label: "strain energy [J]", unit: "J", of: ({ strain }) => strain },
  distance: { label: "base displacement [mm]", unit: "mm", of: (s) => s.distance.map((d) => 1e3 * d) },
};
const plot = { item: null, cursor: null, frame: null, key: "E" };
const ordinates = (series) => QUANTITIES[plot.key].of(series);
const EDGE = { left: 62, right: 16, top: 30, bottom: 40 };

/** Axes of the shown trace: times and energies to pixels and back. */
function traceFrame(trace, w, h) {
  const energies = trace.series.flatMap(ordinates).filter((E) => E > 0);
  const end = Math.max(...trace.series.map((s) => (s.ideal ?? s).t.at(-1)));
  const peak = energies.length ? energies.reduce((a, b) => Math.max(a, b)) : 1;
  const log = $("trace-log").checked;
  let low = 0;
  let high = 1.05 * peak;
  if (log) {
    // four decades at most: at the start of the motion E is 0
    const late = trace.series.flatMap((s) => ordinates(s).filter((e, k) => e > 0 && s.t[k] > 0.1 * end));
    const floor = Math.max(late.reduce((a, b) => Math.min(a, b), peak), peak * 1e-4);
    [low, high] = [Math.floor(Math.log10(floor)), Math.log10(1.2 * peak)];
  }
  const inner = { w: Math.max(w - EDGE.left - EDGE.right, 1), h: h - EDGE.top - EDGE.bottom };
  const level = (E) => (log ? Math.max(Math.log10(Math.max(E, 1e-300)), low) : E);
  return {
    end, low, high, log, w, h,
    x: (t) => EDGE.left + inner.w * t / end,
    y: (E) => EDGE.top + inner.h * (1 - (level(E) - low) / (high - low)),
    time: (x) => Math.min(Math.max((x - EDGE.left) / inner.w, 0), 1) * end,
  };
}

function traceGrid(f, duration) {
  const group = svg("g");
  group.append(svg("rect", {
    class: "moving", x: f.x(0), y: EDGE.top, width: f.x(Math.min(duration, f.end)) - f.x(0),
    height: f.h - EDGE.top - EDGE.bottom,
  }));
  const steps = f.high - f.low < 2.5 ? [1, 2, 5] : [1];
  const marks = f.log
    ? ticks(f.low, f.high, f.high - f.low).flatMap((k) => steps.map((step) => step * 10 ** k))
      .filter((E) => Math.log10(E) <= f.high)
    : ticks(0, f.high, 5);
  for (const E of marks) {
    const y = f.y(E);
    group.append(svg("line", { class: "grid", x1: EDGE.left, x2: f.w - EDGE.right, y1: y, y2: y }),
      svg("text", { x: EDGE.left - 8, y: y + 4, "text-anchor": "end" }, String(Number(E.toPrecision(3)))));
  }
  for (const t of ticks(0, f.end, Math.min(12, f.w / 70))) {
    group.append(svg("text", { x: f.x(t), y: f.h - EDGE.bottom + 18, "text-anchor": "middle" }, String(t)));
  }
  group.append(
    svg("text", { x: f.w - EDGE.right, y: f.h - 6, "text-anchor": "end" }, "time [s]"),
    svg("text", { x: 10, y: 18 }, QUANTITIES[plot.key].label),
    svg("text", { x: f.x(0) + 6, y: EDGE.top + 14 }, "moving"),
  );
  return group;
}

function drawTraces() {
  const trace = plot.item;
  const node = $("trace-plot");
  const f = traceFrame(trace, node.clientWidth, node.clientHeight);
  plot.frame = f;
  node.setAttribute("viewBox", `0 0 ${f.w} ${f.h}`);
  const line = (series) => {
    const values = ordinates(series);
    return `M${series.t.map((s, k) => `${f.x(s).toFixed(1)} ${f.y(values[k]).toFixed(1)}`).join("L")}`;
  };
  const curves = trace.series.flatMap((series) => {
    const { planner, ideal } = series;
    const style = `stroke:${colour(planner)}`;
    if (!ideal) {
      return svg("path", { class: "curve", style, "stroke-dasharray": dash(planner), d: line(series) });
    }
    const both = [
      svg("path", { class: "curve emulated", style, d: line(series) }),
      svg("path", { class: "curve ideal", style, d: line(ideal) }),
    ];
    if (series.t.at(-1) < ideal.t.at(-1) - 0.1) {
      const [x, y] = [f.x(series.t.at(-1)), f.y(ordinates(series).at(-1))];
      both.push(svg("path", { class: "curve", style, d: `M${x - 5} ${y - 5}l10 10m-10 0l10 -10` }));
    }
    return both;
  });
  node.replaceChildren(traceGrid(f, trace.duration), ...curves, svg("g", { id: "trace-cursor" }));
  $("trace-legend").replaceChildren(...trace.series.map(({ planner }) => el("span", {},
    swatch(planner, EMULATED), planner, el("span", { class: "value" }))), el("span", { class: "at value" }));
  drawCursor();
}

/** Index of the last sample at or before time t. */
function sampleAt(times, t) {
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (times[middle] <= t) low = middle;
    else high = middle - 1;
  }
  return low;
}

function drawCursor() {
  const { item, cursor, frame: f } = plot;
  const values = $("trace-legend").querySelectorAll(".value:not(.at)");
  const marks = [];
  item.series.forEach((series, k) => {
    const { planner, t } = series;
    const i = cursor === null ? 0 : sampleAt(t, cursor);
    const E = ordinates(series);
    values[k].textContent = cursor === null ? "" : `${number(E[i])} ${QUANTITIES[plot.key].unit}`;
    if (cursor !== null) {
      marks.push(svg("circle", { cx: f.x(t[i]), cy: f.y(E[i]), r: 3.5, style: `fill:${colour(planner)}` }));
    }
  });
  $("trace-legend").querySelector(".at").textContent = cursor === null ? "" : `at ${cursor.toFixed(2)} s`;
  if (cursor !== null) {
    marks.unshift(svg("line", {
      class: "cursor", x1: f.x(cursor), x2: f.x(cursor), y1: EDGE.top, y2: f.h - EDGE.bottom,
    }));
  }
  $("trace-cursor").replaceChildren(...marks);
}

function moveCursor(time) {
  plot.cursor = time === null ? null : Math.min(Math.max(time, 0), plot.frame.end);
  drawCursor();
}

if (choices("traces", $("trace-pick"), traces.map(caseLabel), "energy traces")) {
  const first = data.scenes?.[0]; // what the animation shows, or the first
  const start = Math.max(0, traces.findIndex((trace) =>
    trace.query === first?.query && trace.vehicle === first?.vehicle
    && trace.duration === first?.duration));
  plot.item = traces[start];
  $("trace-what").hidden = $("trace-note").hidden = !EMULATED;
  if (EMULATED) {
    $("h-traces").textContent = "Base and energy against time";
    plot.key = $("trace-key").value;
    $("trace-key").addEventListener("change", (event) => {
      plot.key = event.target.value;
      drawTraces();
    });
  }
  $("trace-pick").value = start;
  redrawn(drawTraces);
  $("trace-pick").addEventListener("change", (event) => {
    plot.item = traces[event.target.value];
    plot.cursor = null;
    drawTraces();
  });
  $("trace-log").addEventListener("change", drawTraces);
  const node = $("trace-plot");
  node.addEventListener("pointermove", (event) => {
    moveCursor(plot.frame.time(event.clientX - node.getBoundingClientRect().left));
  });
  node.addEventListener("pointerleave", () => moveCursor(null));
  node.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    moveCursor((plot.cursor ?? 0) + step * plot.frame.end / (event.shiftKey ? 20 : 200));
  });
}

// -------------------------------------------------------------------- coupling maps

const MARGIN = { left: 44, right: 10, top: 10, bottom: 34 };

/** Maps of one query: a new group starts at another vehicle or a pair of joints seen before. */
function mapGroups(maps) {
  const groups = [];
  for (const map of maps) {
    const pair = String(map.joints);
    const last = groups.at(-1);
    if (!last || last.vehicle !== map.vehicle || last.pairs.has(pair)) {
      groups.push({ vehicle: map.vehicle, pairs: new Set(), maps: [] });
    }
    groups.at(-1).pairs.add(pair);
    groups.at(-1).maps.push(map);
  }
  return groups;
}

/** "bent · from (0, -45, 90)° to (90, 45, -45)°", put together from the cross-sections. */
function groupLabel({ vehicle, maps }) {
  const ends = { start: [], goal: [] };
  for (const map of maps) {
    for (const end of ["start", "goal"]) {
      map.joints.forEach((joint, k) => { if (map[end]) ends[end][joint - 1] = Math.round(map[end][k]); });
    }
  }
  const [from, to] = [ends.start, ends.goal].map((q) => Array.from(q, (v) => v ?? "·").join(", "));
  return from ? `${vehicle} · from (${from})° to (${to})°` : `${vehicle} · ${maps[0].title}`;
}

/** Bilinear value of the map at joint angles (x, y). */
function sample(map, x, y) {
  const at = (axis, value) => {
    const place = (value - axis[0]) / (axis.at(-1) - axis[0]) * (axis.length - 1);
    const i = Math.min(Math.max(Math.floor(place), 0), axis.length - 2);
    return [i, Math.min(Math.max(place - i, 0), 1)];
  };
  const [i, u] = at(map.x, x);
  const [j, v] = at(map.y, y);
  const m = map.most;
  return (1 - u) * ((1 - v) * m[i][j] + v * m[i][j + 1]) + u * ((1 - v) * m[i + 1][j] + v * m[i + 1][j + 1]);
}

function channels(hex) {
  return [1, 3, 5].map((k) => Number.parseInt(hex.slice(k, k + 2), 16));
}

/** Colours between weak and strong, as [r, g, b]. */
function shade(part) {
  const [weak, strong] = [channels(ink("--weak")), channels(ink("--strong"))];
  return (value) => weak.map((c, k) => Math.round(c + (strong[k] - c) * part(value)));
}

function backdrop(map, rgb) {
  const image = new ImageData(map.x.length, map.y.length);
  map.most.forEach((column, i) => column.forEach((value, j) => {
    const k = 4 * ((map.y.length - 1 - j) * map.x.length + i);
    image.data.set([...rgb(value), 255], k);
  }));
  const canvas = el("canvas", { width: image.width, height: image.height });
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas;
}

function mapFrame(map, w, h) {
  const [left, right, bottom, top] = [map.x[0], map.x.at(-1), map.y[0], map.y.at(-1)];
  const inner = { w: w - MARGIN.left - MARGIN.right, h: h - MARGIN.top - MARGIN.bottom };
  return {
    inner,
    x: (q) => MARGIN.left + inner.w * (q - left) / (right - left),
    y: (q) => MARGIN.top + inner.h * (1 - (q - bottom) / (top - bottom)),
    angles: (x, y) => [
      left + (right - left) * (x - MARGIN.left) / inner.w,
      bottom + (top - bottom) * (1 - (y - MARGIN.top) / inner.h),
    ],
  };
}

function polyline(ctx, f, points) {
  ctx.beginPath();
  points.forEach(([x, y], k) => (k ? ctx.lineTo(f.x(x), f.y(y)) : ctx.moveTo(f.x(x), f.y(y))));
}

function drawMap(map, canvas, top) {
  const { ctx, w, h } = sharp(canvas);
  const f = mapFrame(map, w, h);
  const rgb = shade((value) => value / top);
  ctx.save();
  ctx.beginPath();
  ctx.rect(MARGIN.left, MARGIN.top, f.inner.w, f.inner.h);
  ctx.clip();
  ctx.globalAlpha = 0.28;
  ctx.drawImage(backdrop(map, rgb), MARGIN.left, MARGIN.top, f.inner.w, f.inner.h);
  ctx.globalAlpha = 1;
  ctx.lineWidth = 1.4;
  for (const line of map.lines) {
    for (let k = 1; k < line.length; k++) {
      const [[a, b], [c, d]] = [line[k - 1], line[k]];
      ctx.strokeStyle = `rgb(${rgb(sample(map, (a + c) / 2, (b + d) / 2))})`;
      polyline(ctx, f, [line[k - 1], line[k]]);
      ctx.stroke();
    }
  }
  for (const { planner, points } of map.paths) {
    polyline(ctx, f, points);
    Object.assign(ctx, { lineWidth: 5.5, strokeStyle: ink("--card"), lineJoin: "round" });
    ctx.stroke();
    Object.assign(ctx, { lineWidth: 2.6, strokeStyle: ink(`--s${styleOf(planner)[0]}`) });
    ctx.setLineDash(dash(planner).split(" ").filter(Boolean).map(Number));
    ctx.stroke();
    ctx.setLineDash([]);
  }
  ctx.restore();
  drawEnds(ctx, f, map);
  drawMapAxes(ctx, f, map, w, h);
}

function drawEnds(ctx, f, map) {
  Object.assign(ctx, { lineWidth: 2, strokeStyle: ink("--card"), fillStyle: ink("--ink") });
  if (map.goal) {
    ctx.beginPath();
    ctx.rect(f.x(map.goal[0]) - 5.5, f.y(map.goal[1]) - 5.5, 11, 11);
    ctx.fill();
    ctx.stroke();
  }
  if (map.start) {
    ctx.beginPath();
    ctx.arc(f.x(map.start[0]), f.y(map.start[1]), 5.5, 0, 7);
    ctx.fill();
    ctx.stroke();
  }
}

function drawMapAxes(ctx, f, map, w, h) {
  Object.assign(ctx, { font: "11px system-ui, sans-serif", fillStyle: ink("--soft"), textAlign: "center" });
  const every = (axis) => ticks(axis[0] / 60, axis.at(-1) / 60, 4).map((k) => 60 * k);
  for (const q of every(map.x)) ctx.fillText(`${q}°`, f.x(q), h - MARGIN.bottom + 15);
  ctx.fillText(`joint ${map.joints[0]}`, MARGIN.left + f.inner.w / 2, h - 4);
  ctx.textAlign = "right";
  for (const q of every(map.y)) ctx.fillText(`${q}°`, MARGIN.left - 5, f.y(q) + 4);
  ctx.save();
  ctx.translate(10, MARGIN.top + f.inner.h / 2);
  ctx.rotate(-Math.PI / 2);
  ctx.textAlign = "center";
  ctx.fillText(`joint ${map.joints[1]}`, 0, 0);
  ctx.restore();
}

function showMaps(group) {
  const planners = [...new Set(group.maps.flatMap((map) => map.paths.map((path) => path.planner)))];
  $("map-legend").replaceChildren(
    ...planners.map((planner) => el("span", {}, swatch(planner), planner)),
    el("span", {}, "● start  ■ goal"),
    el("span", {}, "coupling 0", el("span", { class: "ramp" }), "greatest of the map"),
  );
  const drawings = group.maps.map((map) => {
    const canvas = el("canvas", { role: "img", "aria-label": `Coupling map, ${map.title}` });
    const top = Math.max(...map.most.map((row) => Math.max(...row)));
    const rest = `greatest coupling ${number(top)} J/rad²`;
    const now = el("span", { class: "now" }, rest);
    $("map-grid").append(el("figure", { class: "map" }, el("figcaption", {}, map.title, now), canvas));
    canvas.addEventListener("pointermove", (event) => {
      const [x, y] = mapFrame(map, canvas.clientWidth, canvas.clientHeight)
        .angles(event.offsetX, event.offsetY);
      const inside = x >= map.x[0] && x <= map.x.at(-1) && y >= map.y[0] && y <= map.y.at(-1);
      now.textContent = inside ? `q${map.joints[0]} = ${x.toFixed(0)}°, q${map.joints[1]} = `
        + `${y.toFixed(0)}°: ${number(sample(map, x, y))} J/rad²` : rest;
    });
    canvas.addEventListener("pointerleave", () => { now.textContent = rest; });
    return () => drawMap(map, canvas, top);
  });
  return () => drawings.forEach((draw) => draw());
}

{
  const groups = mapGroups(data.maps ?? []);
  if (choices("maps", $("map-pick"), groups.map(groupLabel), "coupling maps")) {
    let draw = showMaps(groups[0]);
    redrawn(() => draw());
    $("map-pick").addEventListener("change", (event) => {
      $("map-grid").replaceChildren();
      draw = showMaps(groups[event.target.value]);
      draw();
    });
  }
}
