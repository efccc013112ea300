// Two motions side by side: charts of what they do, on one time cursor.

const MODES = 4; // strongest ones that are drawn
const LINE_COLOURS = [3, 1, 4, 2, 5, 6, 0]; // of joints and modes, places in the palette
const LINE_DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3], [], [7, 3], [2, 2]];
const BORDER = { left: 52, right: 8, top: 8, bottom: 20 };
const CALM = 90; // ms between drawings while a path is dragged
const norm3 = (v) => Math.hypot(v[0], v[1], v[2]);

/** Index of the last time at or before t. */
function placeAt(times_, t) {
  let [low, high] = [0, times_.length - 1];
  while (low < high) {
    const middle = Math.ceil((low + high) / 2);
    if (times_[middle] <= t) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** A column of a track at time t, between its samples. */
function columnAt(track, name, t) {
  const rows = track[name];
  const i = placeAt(track.t, t);
  const j = Math.min(i + 1, track.t.length - 1);
  if (i === j || t <= track.t[i]) return rows[i];
  const u = Math.min((t - track.t[i]) / (track.t[j] - track.t[i]), 1);
  if (typeof rows[i] === "number") return rows[i] + u * (rows[j] - rows[i]);
  return Array.from(rows[i], (value, k) => value + u * (rows[j][k] - value));
}

// ------------------------------------------------------------------------ what is drawn

const perJoint = (key, factor) => (track) => (track[key] === null ? []
  : track[key][0].map((_, j) => ({ name: jointName(j, track), values: track[key].map((row) => factor * row[j]) })));

const limitsOf = (low, high, factor) => (track) => machineOf(track).arm.links
  .map((link) => [factor * low(link), factor * high(link)]);

const AT_HOME = [0, 0, 0, 0, 0, 0];

/** Lines of the six legs [mm, mm/s] from what one sample has of them [m, m/s]. */
const perLeg = (measure) => (track) => {
  const { platform } = machineOf(track);
  if (!platform) return [];
  const home = legLengths(platform, AT_HOME);
  const rows = track.y.map((y, i) => measure(platform, home, y, track.yd[i]));
  return home.map((_, leg) => ({ name: `leg ${leg + 1}`, values: rows.map((row) => 1e3 * row[leg]) }));
};

const legLimits = (ends) => (track) => {
  const { platform } = machineOf(track);
  return platform ? legLengths(platform, AT_HOME).map((home) => ends(platform, home).map((end) => 1e3 * end)) : [];
};

const CHARTS = [
  { key: "E", label: "Energy of the base", unit: "J", floor: true,
    lines: (track) => [{ name: "E", values: track.E }] },
  { key: "modes", label: "Energy by mode of the base", unit: "J", floor: true, lines: modeLines },
  { key: "q", label: "Joint angles", unit: "deg", lines: perJoint("q", DEG),
    limits: limitsOf((l) => l.q_min, (l) => l.q_max, DEG) },
  { key: "v", label: "Joint speeds", unit: "deg/s", lines: perJoint("v", DEG),
    limits: limitsOf((l) => -l.v_max, (l) => l.v_max, DEG) },
  { key: "tau", label: "Motor torques", unit: "N m", lines: perJoint("tau", 1),
    limits: limitsOf((l) => -l.tau_max, (l) => l.tau_max, 1) },
  { key: "tool", label: "Tool error", unit: "mm", floor: true,
    lines: (track) => [{ name: "tool", values: toolErrors(track).map((value) => 1e3 * value) }] },
  { key: "y", label: "Base displacement", unit: "mm", floor: true,
    lines: (track) => [{ name: "|Y|", values: track.y.map((row) => 1e3 * norm3(row)) }] },
  { key: "ydd", label: "Base acceleration", unit: "m/s²", floor: true,
    lines: (track) => (track.ydd === null ? []
      : [{ name: "|Y″|", values: track.ydd.map(norm3) }]) },
  { key: "legs", label: "Leg lengths, from home", unit: "mm", absent: "no platform",
    lines: perLeg((platform, home, y) => legLengths(platform, y).map((length, i) => length - home[i])),
    limits: legLimits(({ length_min: low, length_max: high }, home) => [low - home, high - home]) },
  { key: "legSpeeds", label: "Leg speeds", unit: "mm/s", absent: "no platform",
    lines: perLeg((platform, home, y, yd) => legSpeeds(platform, y, yd)),
    limits: legLimits(({ speed_max: most }) => [-most, most]) },
];

/** Way of the tool from where the command puts it on a base at rest [m]; of logs it is in the file. */
function toolErrors(track) {
  const { arm } = machineOf(track);
  track.tool ??= track.t.map((_, i) => {
    const [at, meant] = [track.q[i], track.cmd[i]].map((q) => jointPositions(arm, q).at(-1));
    return norm3(plus(plus(turned(at, track.y[i].slice(3)), track.y[i]), meant, -1));
  });
  return track.tool;
}

/** The strongest modes of a track, by their frequency. */
function modeLines(track) {
  if (!track.modes) return [];
  const peak = (k) => track.modes.reduce((most, row) => Math.max(most, row[k]), 0);
  return track.omega.map((omega, k) => ({ k, omega, peak: peak(k) }))
    .sort((a, b) => b.peak - a.peak).slice(0, MODES).sort((a, b) => a.omega - b.omega)
    .map(({ k, omega }) => ({ name: `${number(omega / (2 * Math.PI), 2)} Hz`, values: track.modes.map((row) => row[k]) }));
}

// ------------------------------------------------------------------------------ views

const charts = []; // rows: { spec, cells: [{ canvas, cursor, values, lines, scale }] }

function makeCharts() {
  for (const spec of CHARTS) {
    const row = { spec, cells: [0, 1].map((side) => chartCell(spec, side)) };
    charts.push(row);
    $("charts").append(...row.cells.map((cell) => cell.figure));
  }
  followers.push(moveCursors);
  $("chart-limits").addEventListener("click", (event) => {
    charts.limits = !charts.limits;
    event.currentTarget.setAttribute("aria-pressed", charts.limits);
    drawCharts();
  });
}

function chartCell(spec, side) {
  const canvas = el("canvas", { "aria-hidden": "true" }); // the slider around it has the name
  const cursor = el("div", { class: "cursor" });
  const values = el("span", { class: "legend" });
  const who = el("span", { class: "who" });
  const plot = el("div", {
    class: "plotted", tabindex: 0, role: "slider", "aria-valuemin": 0, "aria-valuenow": 0,
    "aria-label": `${spec.label}, motion ${"AB"[side]}: time`,
  }, canvas, cursor);
  const figure = el("figure", { class: "chart" },
    el("figcaption", {}, el("strong", {}, spec.label, el("span", { class: "unit" }, ` [${spec.unit}]`), who), values), plot);
  const cell = { who, canvas, cursor, values, plot, figure, lines: [], scale: null };
  const scrub = (event) => {
    if (event.buttons && cell.scale) seek(cell.scale.time(event.clientX - canvas.getBoundingClientRect().x));
  };
  plot.addEventListener("pointerdown", (event) => {
    plot.setPointerCapture(event.pointerId);
    scrub(event);
  });
  plot.addEventListener("pointermove", scrub);
  plot.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.5 : 0.05;
    const to = { ArrowLeft: film.t - step, ArrowRight: film.t + step, Home: 0, End: film.end }[event.key];
    if (to === undefined) return;
    seek(to);
    event.preventDefault();
  });
  return cell;
}

/** Draw the rows that are seen, not at every frame of a drag; the others when there is time. */
function drawCharts(coarse = false) {
  if (coarse && performance.now() - charts.drawn < CALM) return;
  charts.drawn = performance.now();
  for (const row of charts) {
    const box = row.cells[0].figure.getBoundingClientRect();
    const other = row.cells[1].figure.getBoundingClientRect();
    row.stale = true;
    if (Math.max(box.bottom, other.bottom) > -200 && Math.min(box.top, other.top) < innerHeight + 200) drawRow(row);
  }
  clearTimeout(charts.rest);
  if (!coarse) charts.rest = setTimeout(drawStaleCharts, CALM);
}

function drawStaleCharts() {
  if (charts.some((row) => row.stale)) charts.filter((row) => row.stale).forEach(drawRow);
}

function drawRow(row) {
  row.stale = false;
  row.cells.forEach((cell, side) => { cell.lines = row.spec.lines(shown[side]); });
  const empty = row.cells.every((cell) => cell.lines.length === 0);
  for (const cell of row.cells) cell.figure.hidden = empty;
  if (empty) return;
  const [low, high] = extentOf(row);
  row.cells.forEach((cell, side) => drawCell(row, cell, shown[side], low, high));
  moveCursors(film.t);
}

/** One vertical range for both motions; limits are in it where the motion comes near. */
function extentOf({ spec, cells }) {
  let [low, high] = [spec.floor ? 0 : Infinity, -Infinity];
  cells.forEach((cell, side) => {
    for (const { values } of cell.lines) for (const value of values) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    (spec.limits?.(shown[side]) ?? []).forEach(([least, most], j) => {
      const values = cell.lines[j]?.values ?? [];
      const near = charts.limits ? Infinity : 0.15 * (most - least);
      if (values.some((value) => value > most - near)) high = Math.max(high, most);
      if (values.some((value) => value < least + near)) low = Math.min(low, least);
    });
  });
  if (!(high > low)) return [0, 1];
  const margin = 0.06 * (high - low);
  return [spec.floor ? 0 : low - margin, high + margin];
}

function drawCell({ spec }, cell, track, low, high) {
  const { E_mean: mean, E_peak: peak } = track;
  const total = spec.key === "E" ? `: mean ${number(mean)} J, peak ${number(peak)} J` : limitShare(spec, cell, track);
  cell.who.textContent = ` · ${track.name}${total}`;
  cell.canvas.setAttribute("aria-label", `${spec.label} in ${spec.unit} against time, ${track.name}`);
  const { ctx, w, h } = sharp(cell.canvas);
  const room = { w: w - BORDER.left - BORDER.right, h: h - BORDER.top - BORDER.bottom };
  const x = (t) => BORDER.left + room.w * t / film.end;
  const y = (value) => BORDER.top + room.h * (1 - (value - low) / (high - low));
  cell.scale = { x, time: (at) => (at - BORDER.left) / room.w * film.end };
  Object.assign(ctx, { font: "11px system-ui, sans-serif", fillStyle: ink("--wash") });
  ctx.fillRect(x(0), BORDER.top, x(Math.min(track.duration, film.end)) - x(0), room.h);
  limitBands(ctx, spec, track, y, room);
  ctx.textAlign = "right";
  for (const mark of ticks(low, high, 5).filter((value) => value <= high)) {
    stroke(ctx, [[BORDER.left, y(mark)], [w - BORDER.right, y(mark)]], 1, ink("--line"));
    ctx.fillStyle = ink("--soft");
    ctx.fillText(String(Number(mark.toPrecision(3))).replace("-", "−"), BORDER.left - 6, y(mark) + 4);
  }
  ctx.textAlign = "center";
  const marks = ticks(0, film.end, Math.min(8, w / 60));
  for (const t of marks) ctx.fillText(t === marks.at(-1) ? `${t} s` : String(t), x(t), h - 5);
  cell.lines.forEach(({ values }, k) => {
    ctx.setLineDash(LINE_DASHES[k % LINE_DASHES.length]);
    stroke(ctx, values.map((value, i) => [x(track.t[i]), y(value)]), 1.7, lineColour(spec, track, k));
  });
  ctx.setLineDash([]);
  ctx.fillStyle = ink("--soft");
  if (cell.lines.length === 0) ctx.fillText(spec.absent ?? "not recorded", w / 2, h / 2);
}

/** In words: how far the motion goes towards the nearest limit, from the middle between two. */
function limitShare(spec, { lines }, track) {
  if (!spec.limits) return "";
  const limits = spec.limits(track);
  let most = { share: -1, name: "" };
  lines.forEach(({ name, values }, k) => {
    const [low, high] = limits[k];
    for (const value of values) {
      const share = Math.abs(2 * value - low - high) / (high - low);
      if (share > most.share) most = { share, name };
    }
  });
  return most.share >= 0 ? `: ${most.name} reaches ${number(100 * most.share, 2)} % of its limit` : "";
}

const lineColour = (spec, track, k) => (spec.lines(track).length === 1 ? ink(`--s${styleOf(track.name)[0]}`)
  : ink(`--s${LINE_COLOURS[k % LINE_COLOURS.length]}`));

/** Shade what lies beyond the limits of each joint or leg, or of all where they are the same. */
function limitBands(ctx, spec, track, y, room) {
  const all = spec.limits?.(track) ?? [];
  const common = all.every((pair) => pair.every((limit, k) => Math.abs(limit - all[0][k]) < 1e-9 * Math.abs(limit)));
  (common ? all.slice(0, 1) : all).forEach(([least, most], j) => {
    const hue = common ? ink("--soft") : ink(`--s${LINE_COLOURS[j % LINE_COLOURS.length]}`);
    const inside = (at) => Math.min(Math.max(at, BORDER.top), BORDER.top + room.h);
    for (const [limit, edge] of [[most, BORDER.top], [least, BORDER.top + room.h]]) {
      const at = inside(y(limit));
      if (at === edge) continue;
      Object.assign(ctx, { fillStyle: hue, globalAlpha: common ? 0.14 : Math.max(0.05, 0.3 / all.length) });
      ctx.fillRect(BORDER.left, Math.min(at, edge), room.w, Math.abs(edge - at));
      ctx.globalAlpha = 1;
      ctx.setLineDash([3, 3]);
      stroke(ctx, [[BORDER.left, at], [BORDER.left + room.w, at]], 1, hue);
      ctx.setLineDash([]);
    }
  });
}

/** The time cursor of all charts, and the values there. */
function moveCursors(t) {
  for (const { spec, cells, stale } of charts) {
    cells.forEach((cell, side) => {
      if (!cell.scale || stale) return;
      const track = shown[side];
      cell.cursor.style.transform = `translateX(${cell.scale.x(t)}px)`;
      cell.plot.setAttribute("aria-valuenow", t.toFixed(2));
      cell.plot.setAttribute("aria-valuemax", film.end.toFixed(2));
      const i = placeAt(track.t, t);
      const texts = cell.lines.map(({ name, values }) => `${name} ${number(values[i])}`);
      cell.plot.setAttribute("aria-valuetext", `${t.toFixed(2)} s: ${texts.join(", ")}`);
      if (cell.values.children.length !== texts.length || cell.named !== track.name) {
        cell.named = track.name;
        cell.values.replaceChildren(...texts.map((_, k) => el("span", {}, lineSwatch(cell.lines, track, k), el("span", {}))));
      }
      texts.forEach((text, k) => { cell.values.children[k].lastChild.textContent = text; });
    });
  }
}

function lineSwatch(lines, track, k) {
  const place = lines.length === 1 ? styleOf(track.name)[0] : LINE_COLOURS[k % LINE_COLOURS.length];
  return svg("svg", { class: "swatch", viewBox: "0 0 22 12", "aria-hidden": "true" }, svg("line", {
    x1: 0, x2: 22, y1: 6, y2: 6, "stroke-width": 3, style: `stroke:var(--s${place})`,
    "stroke-dasharray": LINE_DASHES[k % LINE_DASHES.length].join(" "),
  }));
}
