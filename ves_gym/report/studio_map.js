// The coupling map of two joints, and the points of the path that are dragged on it.
//
// Q = A^T K A with A = M_t^-1 H_bm, or Q_T with each mode of the base weighted by what a quintic
// of the duration excites; of a base that floats freely how far a joint motion turns it
// (ves_gym/planners/coupling.py). Shade: along the worst direction of the two joints; strokes:
// the direction that couples least.

const CELLS = 41; // per axis
const DARKEST = 0.7; // of the ramp, so that strokes and paths are seen on it
const BUDGET = 7; // ms of a frame for cells
const PAUSE = 60; // ms without a change of the path, then cells are computed
const EDGES = { left: 60, right: 18, top: 12, bottom: 38 };
const chart = { cells: null, next: 0, key: "", image: null, frame: null, drag: null, working: false };
const DEG = 180 / Math.PI;

/** |int_0^1 e^(-jxu) s'(u) du| of the quintic law: 15 |j_2(h)| / h^2 with h = x / 2. */
function quinticSpectrum(x) {
  const h = x / 2;
  if (h < 0.2) return 1 - h * h / 14 + h ** 4 / 504;
  const j2 = (3 / h ** 3 - 1 / h) * Math.sin(h) - 3 / h ** 2 * Math.cos(h);
  return 15 * Math.abs(j2) / h ** 2;
}

const floats = (machine) => machine.base.K.every((row) => row.every((value) => value === 0));

/** What a cell needs for any duration: frequencies, and what each mode feels of two joints. */
function couplingCell(machine, q, pair) {
  const model = linearModel(machine);
  const { n, b, size } = model;
  const H = inertiaMatrix(machine.arm, q);
  const wide = massOf(model, H);
  const mass = Float64Array.from({ length: b * b }, (_, k) => wide[Math.floor(k / b) * size + k % b]);
  const L = cholesky(mass, b);
  const A = pair.map((joint) => {
    const column = new Float64Array(b);
    for (let k = 0; k < 6; k++) column[k] = H[k * (6 + n) + 6 + joint];
    return solveFactored(L, b, column);
  });
  if (floats(machine)) return { turn: A.map((column) => [...column.slice(3, 6)]) };
  const { omega, rows } = baseModes(machine, q);
  const felt = rows.map((row) => A.map((column) => row.reduce((sum_, w, k) => sum_ + w * column[k], 0)));
  return { omega, felt };
}

/** The two joints' block of Q, or of Q_T for a duration: [aa, ab, bb]. */
function couplingBlock(cell, duration) {
  const out = [0, 0, 0];
  const add = ([a, b], weight) => {
    out[0] += weight * a * a;
    out[1] += weight * a * b;
    out[2] += weight * b * b;
  };
  if (cell.turn) {
    [0, 1, 2].forEach((k) => add([cell.turn[0][k], cell.turn[1][k]], 1));
  } else {
    cell.felt.forEach((pair, k) => {
      const part = duration === null ? 1 : quinticSpectrum(cell.omega[k] * duration);
      add(pair, (cell.omega[k] * part) ** 2);
    });
  }
  return out;
}

/** Eigenvalues of a symmetric 2 x 2, and the direction of the lesser. */
function principal([a, c, b]) {
  const [middle, half] = [(a + b) / 2, Math.hypot((a - b) / 2, c)];
  const angle = 0.5 * Math.atan2(2 * c, a - b) + Math.PI / 2;
  return { most: middle + half, least: middle - half, direction: [Math.cos(angle), Math.sin(angle)] };
}

// -------------------------------------------------------------------------- the section

const mapDuration = () => ($("map-kind").value === "raw" ? null : path.duration);

/** The angles of a cell: the selected point's, but for the two joints of the map. */
function cellAngles(k) {
  const q = [...path.points[path.selected]];
  path.pair.forEach((joint, axis) => {
    const { q_min: low, q_max: high } = data.machine.arm.links[joint];
    const place = axis === 0 ? k % CELLS : Math.floor(k / CELLS);
    q[joint] = low + (high - low) * place / (CELLS - 1);
  });
  return q;
}

/** Begin the section anew where the joints that are not on it moved; go on with it if not. */
function workOnMap() {
  const others = path.points[path.selected].filter((_, j) => !path.pair.includes(j));
  const key = JSON.stringify([path.pair, others.map((value) => value.toFixed(4))]);
  if (key !== chart.key) Object.assign(chart, { key, cells: chart.cells ?? [], next: 0 });
  if (chart.next >= CELLS * CELLS || chart.working) return;
  chart.working = true;
  requestAnimationFrame(computeCells);
}

/** Some cells of this frame, unless the path still moves: then the frame is the path's. */
function computeCells() {
  const until = performance.now() + BUDGET;
  if (until - BUDGET - todo.last > PAUSE) {
    while (chart.next < CELLS * CELLS && performance.now() < until) {
      chart.cells[chart.next] = couplingCell(data.machine, cellAngles(chart.next), path.pair);
      chart.next += 1;
    }
  }
  chart.working = chart.next < CELLS * CELLS;
  if (chart.working) requestAnimationFrame(computeCells);
  else shadeMap();
}

/** Colours and least directions of all cells for the duration meant. */
function shadeMap() {
  if (!chart.cells || chart.cells.length < CELLS * CELLS) return;
  const all = chart.cells.map((cell) => principal(couplingBlock(cell, mapDuration())));
  const [low, top] = range(all.map((one) => one.most));
  const [weak, strong] = ["--weak", "--strong"].map((name) => ink(name))
    .map((hex) => [1, 3, 5].map((k) => Number.parseInt(hex.slice(k, k + 2), 16)));
  const image = new ImageData(CELLS, CELLS);
  all.forEach(({ most }, k) => {
    const part = DARKEST * (most - low) / (top - low || 1);
    const [i, j] = [k % CELLS, CELLS - 1 - Math.floor(k / CELLS)];
    image.data.set([...weak.map((c, m) => Math.round(c + (strong[m] - c) * part)), 255], 4 * (j * CELLS + i));
  });
  const canvas = el("canvas", { width: CELLS, height: CELLS });
  canvas.getContext("2d").putImageData(image, 0, 0);
  Object.assign(chart, { image: canvas, all });
  const unit = floats(data.machine) ? "" : " J/rad²";
  $("map-low").textContent = number(low);
  $("map-top").textContent = `${number(top)}${unit}`;
  paintMap();
}

// ---------------------------------------------------------------------------- drawing

function mapScales(w, h) {
  const [a, b] = path.pair.map((joint) => data.machine.arm.links[joint])
    .map(({ q_min: low, q_max: high }) => [low, high]);
  const room = { w: w - EDGES.left - EDGES.right, h: h - EDGES.top - EDGES.bottom };
  return {
    room, a, b,
    to: ([x, y]) => [EDGES.left + room.w * (x - a[0]) / (a[1] - a[0]),
      EDGES.top + room.h * (1 - (y - b[0]) / (b[1] - b[0]))],
    from: ([x, y]) => [a[0] + (a[1] - a[0]) * (x - EDGES.left) / room.w,
      b[0] + (b[1] - b[0]) * (1 - (y - EDGES.top) / room.h)],
  };
}

const onMap = (q) => path.pair.map((joint) => q[joint]);

function strokes(ctx, f) {
  ctx.beginPath();
  const length = 1.3 * f.room.w / (CELLS - 1);
  for (let j = 1; j < CELLS; j += 2) for (let i = 1; i < CELLS; i += 2) {
    const { direction: [u, v] } = chart.all[j * CELLS + i];
    const [x, y] = f.to([f.a[0] + (f.a[1] - f.a[0]) * i / (CELLS - 1), f.b[0] + (f.b[1] - f.b[0]) * j / (CELLS - 1)]);
    const [dx, dy] = [u * f.room.w / (f.a[1] - f.a[0]), -v * f.room.h / (f.b[1] - f.b[0])];
    const scale = length / Math.hypot(dx, dy) / 2;
    ctx.moveTo(x - scale * dx, y - scale * dy);
    ctx.lineTo(x + scale * dx, y + scale * dy);
  }
  Object.assign(ctx, { lineWidth: 1.1, strokeStyle: ink("--ink"), globalAlpha: 0.4 });
  ctx.stroke();
  ctx.globalAlpha = 1;
}

function paintMap() {
  const { ctx, w, h } = sharp($("map-canvas"));
  const f = mapScales(w, h);
  chart.frame = f;
  ctx.save();
  ctx.beginPath();
  ctx.rect(EDGES.left, EDGES.top, f.room.w, f.room.h);
  ctx.clip();
  ctx.fillStyle = ink("--wash");
  ctx.fillRect(EDGES.left, EDGES.top, f.room.w, f.room.h);
  if (chart.image) {
    const half = [f.room.w, f.room.h].map((size) => size / (CELLS - 1) / 2);
    ctx.drawImage(chart.image, EDGES.left - half[0], EDGES.top - half[1], f.room.w + 2 * half[0], f.room.h + 2 * half[1]);
    strokes(ctx, f);
  }
  for (const name of [STRAIGHT, DRAWN]) {
    const points = (path.ways[name] ?? []).map((q) => f.to(onMap(q)));
    stroke(ctx, points, 6, ink("--card"));
    ctx.setLineDash(name === STRAIGHT ? [7, 5] : []);
    stroke(ctx, points, 2.8, ink(`--s${styleOf(name)[0]}`));
    ctx.setLineDash([]);
  }
  ctx.restore();
  paintNow(ctx, f);
  mapAxes(ctx, f, w, h);
  placeHandles(f);
}

/** Where both motions are at the time of the cursor. */
function paintNow(ctx, f) {
  for (const name of [STRAIGHT, DRAWN]) {
    const track = path.tracks[name];
    if (!track) continue;
    const [x, y] = f.to(onMap(columnAt(track, "q", film.t)));
    ctx.beginPath();
    ctx.arc(x, y, 4, 0, 7);
    Object.assign(ctx, { fillStyle: ink(`--s${styleOf(name)[0]}`), strokeStyle: ink("--card"), lineWidth: 1.5 });
    ctx.fill();
    ctx.stroke();
  }
}

function mapAxes(ctx, f, w, h) {
  Object.assign(ctx, { font: "12px system-ui, sans-serif", fillStyle: ink("--soft"), textAlign: "center" });
  const marks = ([low, high], size) => {
    const step = [15, 30, 45, 60, 90, 120, 180].find((k) => (high - low) * DEG / k <= size / 56) ?? 360;
    return ticks(low * DEG / step, high * DEG / step, (high - low) * DEG / step).map((k) => Math.round(k) * step)
      .filter((angle) => angle >= low * DEG - 1e-6 && angle <= high * DEG + 1e-6);
  };
  const text = (angle) => `${angle}°`.replace("-", "−");
  for (const angle of new Set(marks(f.a, f.room.w))) ctx.fillText(text(angle), f.to([angle / DEG, 0])[0], h - EDGES.bottom + 16);
  ctx.fillText(`${jointName(path.pair[0])} [deg]`, EDGES.left + f.room.w / 2, h - 5);
  ctx.textAlign = "right";
  for (const angle of new Set(marks(f.b, f.room.h))) ctx.fillText(text(angle), EDGES.left - 6, f.to([0, angle / DEG])[1] + 4);
  ctx.save();
  ctx.translate(11, EDGES.top + f.room.h / 2);
  ctx.rotate(-Math.PI / 2);
  ctx.textAlign = "center";
  ctx.fillText(`${jointName(path.pair[1])} [deg]`, 0, 0);
  ctx.restore();
}

// ---------------------------------------------------------------------------- handles

const pointName = (k) => (k === 0 ? "start" : k === path.points.length - 1 ? "goal" : `via ${k}`);

/** One button per point of the path: dragged, or moved with the arrow keys. */
function makeHandles() {
  $("map-handles").replaceChildren(...path.points.map((_, k) => {
    const sign = k === 0 ? "S" : k === path.points.length - 1 ? "G" : String(k);
    const handle = el("button", { type: "button", class: "handle", "data-point": k }, sign);
    handle.addEventListener("pointerdown", (event) => {
      handle.setPointerCapture(event.pointerId);
      chart.drag = k;
      selectPoint(k);
    });
    handle.addEventListener("pointermove", (event) => {
      if (chart.drag !== k) return;
      const box = $("map-canvas").getBoundingClientRect();
      movePoint(k, chart.frame.from([event.clientX - box.x, event.clientY - box.y]));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      handle.addEventListener(end, () => { chart.drag = null; });
    }
    handle.addEventListener("focus", () => selectPoint(k));
    handle.addEventListener("keydown", (event) => handleKey(event, k));
    return handle;
  }));
}

function handleKey(event, k) {
  const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  if (event.key === "Delete" || event.key === "Backspace") removePoint(k);
  else if (ways[event.key]) {
    const size = (event.shiftKey ? 10 : 1) / DEG;
    movePoint(k, onMap(path.points[k]).map((value, axis) => value + size * ways[event.key][axis]));
  } else return;
  event.preventDefault();
}

function movePoint(k, angles) {
  const q = [...path.points[k]];
  path.pair.forEach((joint, axis) => { q[joint] = withinLimits(joint, angles[axis]); });
  setPoint(k, q);
}

function placeHandles(f) {
  for (const handle of $("map-handles").children) {
    const k = Number(handle.dataset.point);
    const [x, y] = f.to(onMap(path.points[k]));
    handle.style.transform = `translate(${x}px, ${y}px)`;
    handle.setAttribute("aria-pressed", k === path.selected);
    const angles = path.pair.map((joint) => `${jointName(joint)} ${degrees(path.points[k][joint])}°`);
    handle.setAttribute("aria-label", `${pointName(k)}: ${angles.join(", ")}`);
    handle.title = `${pointName(k)}: ${angles.join(", ")}`;
  }
}
