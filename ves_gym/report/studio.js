// The studio: the path, what follows from it, and the two motions that are shown.

const STRAIGHT = "straight line";
const DRAWN = "drawn path";
STYLES[STRAIGHT] = [0, ""];
STYLES[DRAWN] = [1, ""];
const WAY = 80; // points of a path on the map
const SETTLED = 200; // ms without a change, then energies are computed finely
const FRAME = 0.05; // s between frames of the moving picture
const path = {
  points: [data.start, ...data.via, data.goal].map((q) => [...q]),
  selected: data.via.length ? 1 : 0, pair: [0, Math.min(1, data.start.length - 1)], duration: data.duration,
  motions: {}, tracks: {}, runs: {}, ways: {},
};
const chosen = [STRAIGHT, DRAWN];
const shown = [null, null]; // tracks of the two motions
const todo = { scheduled: false, ends: true, last: -Infinity, finer: 0 };

const links = data.machine.arm.links;
const jointName = (j, track) => (track ? machineOf(track).arm.links : links)[j].name;
const degrees = (angle) => number(Math.round(angle * DEG * 10) / 10 + 0, 3);
const withinLimits = (j, angle) => Math.min(Math.max(angle, links[j].q_min), links[j].q_max);

// ----------------------------------------------------------------------- what is played

/** Columns of a simulated motion, and the energy of each mode with the arm at the goal. */
function trackOf(name, machine, run, goal) {
  const { records } = run;
  const column = (key) => records.map((row) => row[key]);
  const modes = baseModes(machine, goal);
  return {
    name, machine, duration: run.duration, E_mean: run.E_mean, E_peak: run.E_peak, saturated: run.saturated,
    t: column("t"), q: column("q"), v: column("v"), tau: column("tau"), E: column("E"), ydd: column("ydd"), cmd: column("cmd"),
    y: records.map((row) => Array.from(row.x.subarray(0, 6))), u: records.map((row) => Array.from(row.x.subarray(6))),
    yd: records.map((row) => Array.from(row.rate.subarray(0, 6))),
    omega: floats(machine) ? null : modes.omega,
    modes: floats(machine) ? null : records.map((row) => modalEnergies(modes, row.x, row.rate)),
  };
}

function playMotion(name, machine, motion, step = STEP) {
  return trackOf(name, machine, simulateMotion(machine, motion, { detail: true, step }), motion.control.at(-1));
}

const frames = new WeakMap(); // of tracks, until the film is longer or shorter

function framesOf(track) {
  const made = frames.get(track);
  if (made?.end === film.end) return made.run;
  const run = makeFrames(track);
  frames.set(track, { end: film.end, run });
  return run;
}

/** The frames of a track for the moving picture. */
function makeFrames(track) {
  const machine = machineOf(track);
  const { beam } = machine;
  machine.around ??= surroundings(machine);
  const run = {
    around: machine.around, planner: track.name, dt: FRAME, arm: [], base: [], beam: beam ? [] : null, E: [],
    rest_beam: beam?.rest ?? null, platform: machine.platform,
  };
  const count = Math.round(film.end / FRAME);
  for (let f = 0; f <= count; f++) {
    const t = Math.min(f * FRAME, track.t.at(-1));
    const [y, q] = [columnAt(track, "y", t), columnAt(track, "q", t)];
    run.base.push(y);
    run.E.push(columnAt(track, "E", t));
    run.arm.push(jointPositions(machine.arm, q).map((p) => plus(turned(p, y.slice(3)), y)));
    if (!beam) continue;
    const x = [...y, ...(track.u ? columnAt(track, "u", t) : [])];
    run.beam.push(beam.rest.map((p, k) => p.map((value, i) => beam.shape[k][i]
      .reduce((at, weight, c) => at + weight * (x[c] ?? 0), value))));
  }
  return run;
}

/** Where the arm of a machine can be at all, so that its views do not jump while a path is drawn. */
function surroundings(machine) {
  const arms = [];
  const { arm: { links }, beam } = machine;
  for (let k = 0; k < 60; k++) {
    const q = links.map(({ q_min: low, q_max: high }, j) => low + (high - low) * ((k + 0.5) * (0.618 + 0.137 * j) % 1));
    arms.push(jointPositions(machine.arm, q));
  }
  return { rest_beam: beam?.rest ?? null, runs: [{ arm: arms, base: arms.map(() => [0, 0, 0, 0, 0, 0]) }] };
}

// ---------------------------------------------------------------------------- refresh

function schedule(part) {
  if (part) todo[part] = true;
  if (todo.scheduled) return;
  todo.scheduled = true;
  requestAnimationFrame(refresh);
}

/** Play what changed: coarsely while it goes on changing, finely as soon as it does not. */
function refresh() {
  todo.scheduled = false;
  clearTimeout(todo.finer);
  const coarse = performance.now() - todo.last < SETTLED;
  todo.last = performance.now();
  if (coarse) {
    todo.finer = setTimeout(() => {
      todo.last = -SETTLED;
      schedule("ends");
    }, SETTLED);
  }
  const [start, goal] = [path.points[0], path.points.at(-1)];
  if (todo.ends) path.motions[STRAIGHT] = straightMotion(start, goal, path.duration);
  path.motions[DRAWN] = motionThrough(path.points, path.duration);
  for (const name of [STRAIGHT, DRAWN]) {
    if (name === STRAIGHT && !todo.ends) continue;
    path.tracks[name] = playMotion(name, data.machine, path.motions[name], coarse ? COARSE : STEP);
    path.ways[name] = sampleMotion(path.motions[name], WAY).q;
  }
  todo.ends = false;
  rememberSoon();
  showEnergies();
  showMotions(coarse);
  workOnMap();
}

/** The two motions in the views and charts, as they are now. */
function showMotions(coarse = false) {
  chosen.forEach((name, side) => { shown[side] = trackNamed(name); });
  film.end = Math.max(...shown.map((track) => Math.min(track.duration + SHOWN, track.t.at(-1))));
  const runs = shown.map(framesOf);
  film.item = { rest_beam: null, duration: Math.max(...shown.map((track) => track.duration)), runs };
  film.peak = Math.max(1e-12, ...runs.map((run) => Math.max(...run.E)));
  film.t = Math.min(film.t, film.end);
  $("scene-time").max = film.end;
  const first = film.views.length === 0;
  if (first || film.views.some((view, k) => view.run.planner !== runs[k].planner)) {
    film.views = runs.map((run) => makeView(film.item, run));
    $("panels").replaceChildren(...film.views.map((view) => view.figure));
    if (first) {
      $("scene-magnify").value = defaultStep({ ...film.item, rest_beam: data.machine.beam?.rest });
      film.t = tellingMoment(film.item);
    }
    magnified();
  } else {
    runs.forEach((run, k) => { film.views[k].run = run; });
    drawScene();
  }
  $("stops").textContent = shown.flatMap((track) => (track.stops ?? [])
    .map(({ time, reason }) => `${track.name}: the platform stopped at ${number(time)} s: ${reason}.`)).join(" ");
  drawCharts(coarse);
}

function trackNamed(name) {
  if (path.tracks[name]) return path.tracks[name];
  const entry = opened.find((one) => one.name === name);
  if (entry.live) return playMotion(name, entry.machine, path.motions[DRAWN]);
  entry.track ??= playMotion(name, entry.machine ?? data.machine, entry.motion);
  return entry.track;
}

/** Energies of the two paths, and what the arm cannot do of them. */
function showEnergies() {
  const [straight, drawn] = [path.tracks[STRAIGHT], path.tracks[DRAWN]];
  for (const [id, track] of [["straight", straight], ["drawn", drawn]]) {
    $(`${id}-mean`).textContent = number(track.E_mean);
    $(`${id}-peak`).textContent = number(track.E_peak);
    const warnings = beyond(track);
    $(`${id}-beyond`).textContent = warnings.join("; ");
    $(`${id}-beyond`).hidden = warnings.length === 0;
  }
  $("ratio").textContent = straight.E_mean > 0 ? `${number(drawn.E_mean / straight.E_mean, 2)} ×` : "–";
}

/** Limits that a motion breaks, in words. */
function beyond(track) {
  const out = [];
  links.forEach((link, j) => {
    const fastest = track.v.reduce((most, row) => Math.max(most, Math.abs(row[j])), 0);
    if (fastest > 1.001 * link.v_max) out.push(`${link.name}: ${number(fastest * DEG)} °/s, limit ${number(link.v_max * DEG)} °/s`);
    const away = path.ways[track.name]?.find((q) => q[j] < link.q_min - 1e-6 || q[j] > link.q_max + 1e-6);
    if (away) out.push(`${link.name} leaves its range`);
  });
  if (track.saturated) out.push("a motor is at its torque limit: energies are then less true than said below");
  return out;
}

// ------------------------------------------------------------------------- the points

function setPoint(k, q) {
  path.points[k] = q;
  showSliders();
  schedule(k === 0 || k === path.points.length - 1 ? "ends" : null);
}

function selectPoint(k) {
  if (path.selected === k) return;
  path.selected = k;
  showPoints();
  schedule();
}

function addPoint() {
  const k = Math.max(1, Math.min(path.selected + 1, path.points.length - 1));
  const [a, b] = [path.points[k - 1], path.points[k]];
  path.points.splice(k, 0, a.map((value, j) => (value + b[j]) / 2));
  path.selected = k;
  pointsChanged();
}

function removePoint(k = path.selected) {
  if (k === 0 || k === path.points.length - 1) return;
  path.points.splice(k, 1);
  path.selected = Math.min(k, path.points.length - 1);
  pointsChanged();
  $("map-handles").children[path.selected].focus();
}

function pointsChanged() {
  makeHandles();
  showPoints();
  schedule("ends");
}

function showPoints() {
  $("points").replaceChildren(...path.points.map((_, k) => {
    const button = el("button", { type: "button", "aria-pressed": k === path.selected }, pointName(k));
    button.addEventListener("click", () => selectPoint(k));
    return button;
  }));
  $("point-remove").disabled = path.selected === 0 || path.selected === path.points.length - 1;
  showSliders();
}

function makeSliders() {
  $("sliders").replaceChildren(...links.map((link, j) => {
    const input = el("input", { type: "range", id: `joint-${j}`, min: link.q_min * DEG, max: link.q_max * DEG, step: 0.5 });
    const output = el("output", { for: `joint-${j}` });
    input.addEventListener("input", () => {
      const q = [...path.points[path.selected]];
      q[j] = withinLimits(j, Number(input.value) / DEG);
      setPoint(path.selected, q);
    });
    return el("label", { class: "slider" }, el("span", { title: link.name }, link.name), input, output);
  }));
}

function showSliders() {
  [...$("sliders").children].forEach((label, j) => {
    const angle = path.points[path.selected][j];
    label.querySelector("input").value = angle * DEG;
    label.querySelector("output").textContent = `${degrees(angle)}°`;
  });
}

function makePairs() {
  const pairs = links.flatMap((_, i) => links.slice(i + 1).map((__, k) => [i, i + 1 + k]));
  pairs.forEach(([i, j]) => $("map-pair").append(el("option", { value: `${i},${j}` }, `${links[i].name}, ${links[j].name}`)));
  $("map-pair").addEventListener("change", (event) => {
    path.pair = event.target.value.split(",").map(Number);
    schedule();
  });
}

// ------------------------------------------------------------------------ two motions

function showDuration() {
  $("duration").value = path.duration;
  $("duration-out").textContent = `${number(path.duration, 2)} s`;
}

function fillChoices() {
  ["a", "b"].forEach((letter, side) => {
    const select = $(`motion-${letter}`);
    select.replaceChildren(...[STRAIGHT, DRAWN, ...opened.map((entry) => entry.name)]
      .map((name) => el("option", { value: name }, name)));
    select.value = chosen[side];
  });
}

function choose(side, name) {
  chosen[side] = name;
  $(`motion-${"ab"[side]}`).value = name;
  showMotions();
}

// ------------------------------------------------------------------------ how true it is

function off(value) {
  const text = (100 * Math.abs(value)).toFixed(2);
  return `${Number(text) === 0 ? "" : value > 0 ? "+" : "−"}${text} %`;
}

const numberCell = (text) => el("td", { class: "number" }, text);

/** A row of three cells per measure: the simulator's, the page's, the difference. */
const compared = (name, triples) => el("tr", {}, el("td", {}, name), ...triples.flatMap(([theirs, ours]) => [
  numberCell(number(theirs, 4)), numberCell(number(ours, 4)), numberCell(theirs === null ? "stopped" : off(ours / theirs - 1))]));

/** Largest way from home and speed of a leg in what is drawn of a motion [m, m/s]. */
function legPeaks(platform, { records }) {
  const home = legLengths(platform, AT_HOME);
  const peak = { way: 0, speed: 0 };
  for (const { x, rate } of records) {
    const [y, yd] = [x, rate].map((values) => Array.from(values.subarray(0, 6)));
    legLengths(platform, y).forEach((length, i) => { peak.way = Math.max(peak.way, Math.abs(length - home[i])); });
    for (const speed of legSpeeds(platform, y, yd)) peak.speed = Math.max(peak.speed, Math.abs(speed));
  }
  return peak;
}

/** Compare with the simulator, one motion at a time so that the page stays alive. */
async function checkReferences() {
  const { platform } = data.machine;
  $("legs-true").hidden = !platform;
  let worst = 0;
  for (const reference of data.references) {
    await new Promise((go) => { setTimeout(go, 0); });
    const run = simulateMotion(data.machine, reference.motion, { detail: Boolean(platform) });
    const errors = ["E_mean", "E_peak"].map((key) => run[key] / reference[key] - 1);
    worst = Math.max(worst, ...errors.map(Math.abs));
    $("references").append(compared(reference.name, ["E_mean", "E_peak"].map((key) => [reference[key], run[key]])));
    if (!platform) continue;
    const [theirs, ours] = [reference.legs, legPeaks(platform, run)];
    const mm = (value) => (value === null ? null : 1e3 * value);
    $("legs-compared").append(compared(reference.name, ["way", "speed"].map((key) => [mm(theirs[key]), mm(ours[key])])));
  }
  const count = data.references.length;
  $("truth").textContent = count ? `${(100 * worst).toFixed(2)} %` : "–";
  $("truth-note").textContent = count ? `largest difference from the simulator, ${count} motions` : "no motion to compare with";
  $("truth").dataset.done = "yes";
}

// ------------------------------------------------------------------------------ begin

function begin() {
  $("eyebrow").textContent = `Studio · ${data.machine.name}`;
  makePairs();
  makeSliders();
  makeHandles();
  showPoints();
  makeCharts();
  connectPlayer();
  if (floats(data.machine)) {
    $("map-kind").replaceChildren(el("option", { value: "raw" }, "turn of the base per joint motion"));
  }
  showDuration();
  $("duration").addEventListener("input", (event) => {
    path.duration = Number(event.target.value);
    showDuration();
    schedule("ends");
    shadeMap();
  });
  $("map-kind").addEventListener("change", shadeMap);
  $("point-add").addEventListener("click", addPoint);
  $("point-remove").addEventListener("click", () => removePoint());
  $("save").addEventListener("click", saveDrawn);
  $("files").addEventListener("change", (event) => openFiles(event.target.files));
  ["a", "b"].forEach((letter, side) => {
    $(`motion-${letter}`).addEventListener("change", (event) => choose(side, event.target.value));
  });
  data.planned.forEach(takeItem);
  const entries = data.opened.map(takeItem).filter(Boolean);
  fillChoices();
  followers.push(paintMap);
  addEventListener("scroll", drawStaleCharts, { passive: true });
  redraws.push(() => {
    shadeMap();
    paintMap();
    drawCharts();
  });
  refresh();
  document.body.dataset.drawn = performance.now().toFixed(0); // ms until there is a picture
  if (entries.length) choose(0, entries[0].name);
  if (entries.length > 1) choose(1, entries[1].name);
  connectShare();
  requestAnimationFrame(() => setTimeout(checkReferences, 0));
}

begin();

/** For the console, and for whoever checks the page's numbers. */
globalThis.vesStudio = {
  data, path, film, chart, opened, inertiaMatrix, inverseDynamics, jointPositions, baseModes, couplingCell, couplingBlock,
  principal, motionThrough, straightMotion, sampleMotion, simulateMotion, readItems, caseOfDrawn, setPoint, refresh, seek,
  legLengths, legSpeeds, legPeaks, stateOfPage, pictureOfMap, pictureOfCharts,
};
