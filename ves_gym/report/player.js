// Clock, camera and controls of the animation. `around` of a run: what its views must show, where
// that is not what is moving.

/** Magnification that makes the largest base displacement about a twelfth of the structure. */
function defaultStep(scene) {
  const norm = (p) => Math.hypot(...p.slice(0, 3));
  const largest = Math.max(1e-9, ...scene.runs.map((run) => Math.max(...run.base.map(norm))));
  const size = Math.max(2, ...(scene.rest_beam ?? []).map(norm));
  const wanted = size / 12 / largest;
  return Math.max(0, STEPS.findLastIndex((m) => m <= wanted));
}

/** The moment to show first: where the first run's base is furthest from rest. */
function tellingMoment(scene) {
  const run = scene.runs[0];
  const distance = run.base.map((y) => Math.hypot(y[0], y[1], y[2]));
  return run.dt * distance.indexOf(Math.max(...distance));
}

function showScene(scene) {
  film.item = scene;
  film.end = Math.max(...scene.runs.map((run) => run.dt * (run.arm.length - 1)));
  film.peak = Math.max(1e-12, ...scene.runs.map((run) => Math.max(...run.E)));
  film.t = tellingMoment(scene);
  $("scene-time").max = film.end;
  $("scene-magnify").value = defaultStep(scene);
  film.views = scene.runs.map((run) => makeView(scene, run));
  $("panels").replaceChildren(...film.views.map((view) => view.figure));
  const count = scene.runs.length;
  $("panels").style.setProperty("--columns", count > 4 ? Math.ceil(count / 2) : count);
  magnified();
}

function makeView(scene, run) {
  const canvas = el("canvas", {
    class: "view", tabindex: 0, role: "img",
    "aria-label": `${run.planner}: the arm on its base; arrow keys turn the view, + and − zoom`,
  });
  const strip = el("canvas", {
    class: "strip", role: "img", "aria-label": `${run.planner}: energy in the base against time`,
  });
  const now = el("span", { class: "now" });
  const figure = el("figure", { class: "panel" },
    el("figcaption", {}, el("span", {}, swatch(run.planner), run.planner), now), canvas, strip);
  rotatable(canvas);
  const scrub = (event) => {
    if (event.buttons) seek((event.offsetX - 6) / (strip.clientWidth - 12) * film.end);
  };
  strip.addEventListener("pointerdown", scrub);
  strip.addEventListener("pointermove", scrub);
  return { run, canvas, strip, now, figure, extents: null };
}

function rotatable(canvas) {
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) turn(-0.008 * event.movementX, 0.008 * event.movementY);
  });
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return; // the page scrolls until a view is clicked
    event.preventDefault();
    zoom(Math.exp(-0.0015 * event.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    const zooms = { "+": 1.2, "=": 1.2, "-": 1 / 1.2 };
    if (turns[event.key]) turn(...turns[event.key]);
    else if (zooms[event.key]) zoom(zooms[event.key]);
    else return;
    event.preventDefault();
  });
}

function turn(yaw, pitch) {
  camera.yaw += yaw;
  camera.pitch = Math.min(Math.max(camera.pitch + pitch, -1.5), 1.5);
  drawScene();
}

function zoom(factor) {
  camera.zoom = Math.min(Math.max(camera.zoom * factor, 0.3), 20);
  drawScene();
}

function magnified() {
  const m = STEPS[$("scene-magnify").value];
  for (const view of film.views) view.extents = extents(view.run.around ?? film.item, m, view.run);
  $("scene-magnify-out").textContent = m === 1 ? "true scale" : `× ${m}`;
  drawScene();
}

function seek(t) {
  film.t = Math.min(Math.max(t, 0), film.end);
  drawScene();
}

function play(on) {
  film.playing = on;
  $("scene-play").textContent = on ? "Pause" : "Play";
  if (!on) return;
  film.last = performance.now();
  requestAnimationFrame(advance);
}

function advance(stamp) {
  if (!film.playing) return;
  const passed = Math.max(0, Math.min(stamp - film.last, 100)) / 1000;
  film.last = stamp;
  const next = film.t + passed * Number($("scene-speed").value);
  seek(next > film.end ? 0 : next); // again from the start
  requestAnimationFrame(advance);
}

/** Let the controls of the page act. */
function connectPlayer() {
  $("scene-magnify").max = STEPS.length - 1;
  redraws.push(drawScene);
  $("scene-magnify").addEventListener("input", magnified);
  $("scene-time").addEventListener("input", (event) => seek(Number(event.target.value)));
  $("scene-play").addEventListener("click", () => play(!film.playing));
  $("scene-swap").addEventListener("click", (event) => {
    film.swap = !film.swap;
    event.currentTarget.setAttribute("aria-pressed", film.swap);
    drawScene();
  });
  $("scene-reset").addEventListener("click", () => {
    Object.assign(camera, HOME);
    drawScene();
  });
}
