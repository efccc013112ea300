// The arm on its swaying base, in small views that share one clock and one camera.

const scenes = data.scenes ?? [];
const STEPS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]; // magnification of base motion
const HOME = { yaw: -1.15, pitch: 0.22, zoom: 1 };
const film = { item: null, t: 0, playing: false, last: 0, swap: false, views: [], end: 1, peak: 1 };
const followers = []; // called with the time whenever it is drawn
const camera = { ...HOME };

// ------------------------------------------------------------------------- geometry

const plus = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const mix = (a, b, u) => a.map((v, i) => v + u * (b[i] - v));

/** The beam at rest: of the run's own machine, or that of all; a platform stands in its place. */
const restBeam = (run) => (run.platform ? null : run.rest_beam ?? film.item.rest_beam);

/** Arm, beam and energy of a run at time t, base displacement magnified by m. */
function pose(run, t, m) {
  const place = Math.min(Math.max(t / run.dt, 0), run.arm.length - 1);
  const i = Math.min(Math.floor(place), run.arm.length - 1);
  const j = Math.min(i + 1, run.arm.length - 1);
  const between = (frames) => frames[i].map((p, k) => mix(p, frames[j][k], place - i));
  const base = mix(run.base[i], run.base[j], place - i);
  const shift = base.slice(0, 3).map((v) => (m - 1) * v);
  const rest = restBeam(run);
  return {
    base, shift, frame: i,
    E: run.E[i] + (place - i) * (run.E[j] - run.E[i]),
    arm: between(run.arm).map((p) => plus(p, shift)),
    beam: run.beam && rest ? between(run.beam).map((p, k) => plus(rest[k], plus(p, rest[k], -1), m)) : null,
  };
}

/** Directions of the screen in the world: right, up. Orthographic, so lengths keep scale. */
function screen({ yaw, pitch }) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return { right: [-s, c, 0], up: [-Math.sin(pitch) * c, -Math.sin(pitch) * s, Math.cos(pitch)] };
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const range = (values) => values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);

/** Pivot and extent of points as seen from the home position, where they shall fill a view. */
function bounds(points) {
  const pivot = [0, 1, 2].map((k) => range(points.map((p) => p[k]))).map(([a, b]) => (a + b) / 2);
  const { right, up } = screen(HOME);
  const from = points.map((p) => plus(p, pivot, -1));
  return { pivot, x: range(from.map((p) => dot(p, right))), y: range(from.map((p) => dot(p, up))) };
}

/** Projection into a box: about the pivot, as large as fits at home, at the lower edge or centred. */
function projection({ pivot, x, y }, box, size, low) {
  const scale = size * 0.86 * Math.min(box.w / (x[1] - x[0] || 1), box.h / (y[1] - y[0] || 1));
  const rise = low ? 0.45 * box.h + scale * y[0] : scale * (y[0] + y[1]) / 2;
  const middle = [box.x + box.w / 2 - scale * (x[0] + x[1]) / 2, box.y + box.h / 2 + rise];
  const { right, up } = screen(camera);
  const to = (p) => {
    const from = plus(p, pivot, -1);
    return [middle[0] + scale * dot(from, right), middle[1] - scale * dot(from, up)];
  };
  return { to, scale };
}

/** What the two views of a run must contain: its structure with the motion, the arm about its base. */
function extents(scene, m, { platform }) {
  const arm = scene.runs.flatMap((run) => run.arm.flatMap((points, f) =>
    points.map((p) => plus(p, run.base[f].slice(0, 3), -1))));
  const swing = scene.runs.flatMap((run) => run.base.map((y) => y.slice(0, 3).map((v) => m * v)));
  const beam = platform ? platformPoints(platform) : scene.rest_beam ?? [];
  const held = platform ? [] : beam.length ? [-0.8, 0.8].map((r) => plus(beam[0], [r, r, r]))
    : [[0.5, 0.5, -0.6], [-0.5, -0.5, -0.6]]; // the wall, or the box under the arm
  return {
    structure: bounds([...beam, ...held, ...arm, ...swing]),
    arm: bounds([...arm, [0, 0, -0.7]]),
  };
}

// -------------------------------------------------------------------------- drawing

function stroke(ctx, points, width, style, offset = 0) {
  ctx.beginPath();
  points.forEach(([x, y], k) => (k ? ctx.lineTo(x + offset, y + offset) : ctx.moveTo(x + offset, y + offset)));
  Object.assign(ctx, { lineWidth: width, strokeStyle: style, lineJoin: "round", lineCap: "round" });
  ctx.stroke();
}

/** A tube: dark rim, body, light towards the upper left. */
function tube(ctx, points, width) {
  stroke(ctx, points, width, ink("--tube-edge"));
  stroke(ctx, points, 0.72 * width, ink("--tube"));
  stroke(ctx, points, 0.26 * width, ink("--tube-light"), -0.14 * width);
}

/** The wall that holds the root of the beam: a square across its first piece. */
function wall(ctx, to, beam) {
  const along = plus(beam[1], beam[0], -1);
  const axis = along.map(Math.abs).indexOf(Math.max(...along.map(Math.abs)));
  const [u, v] = [0, 1, 2].filter((k) => k !== axis);
  const corners = [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([a, b]) => {
    const p = [...beam[0]];
    p[u] += 0.8 * a;
    p[v] += 0.8 * b;
    return to(p);
  });
  stroke(ctx, [...corners, corners[0]], 1.2, ink("--tube-edge"));
  ctx.fillStyle = ink("--ghost");
  ctx.fill();
}

/** Turned by Z-Y-X fixed angles (a, b, c): Rz(c) Ry(b) Rx(a). */
function turned([x, y, z], [a, b, c]) {
  [y, z] = [y * Math.cos(a) - z * Math.sin(a), y * Math.sin(a) + z * Math.cos(a)];
  [x, z] = [x * Math.cos(b) + z * Math.sin(b), z * Math.cos(b) - x * Math.sin(b)];
  return [x * Math.cos(c) - y * Math.sin(c), x * Math.sin(c) + y * Math.cos(c), z];
}

/** What the arm must not touch: the edges of boxes, the outlines of spheres. */
function obstacles(ctx, to, scale) {
  for (const item of film.item.obstacles ?? []) {
    ctx.globalAlpha = 0.75;
    if (item.kind === "sphere") {
      const [x, y] = to(item.centre);
      ctx.beginPath();
      ctx.arc(x, y, item.radius * scale, 0, 7);
      Object.assign(ctx, { fillStyle: ink("--ghost"), strokeStyle: ink("--soft"), lineWidth: 1.2 });
      ctx.fill();
      ctx.stroke();
    } else {
      const half = item.size.map((s) => s / 2);
      const corner = (...signs) => to(plus(item.centre,
        turned(signs.map((s, k) => s * half[k]), item.angles ?? [0, 0, 0])));
      const square = [[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]];
      for (const z of [-1, 1]) stroke(ctx, square.map(([x, y]) => corner(x, y, z)), 1.2, ink("--soft"));
      for (const [x, y] of square) stroke(ctx, [corner(x, y, -1), corner(x, y, 1)], 1.2, ink("--soft"));
    }
    ctx.globalAlpha = 1;
  }
}

/** A link that tapers from a to b. */
function link(ctx, a, b, from, into) {
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]) || 1;
  const n = [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
  ctx.beginPath();
  [[a, from], [b, into], [b, -into], [a, -from]].forEach(([p, r]) =>
    ctx.lineTo(p[0] + n[0] * r, p[1] + n[1] * r));
  ctx.closePath();
  Object.assign(ctx, { fillStyle: ink("--link"), strokeStyle: ink("--link-edge"), lineWidth: 1 });
  ctx.fill();
  ctx.stroke();
}

function arm(ctx, points, scale) {
  const radius = (k) => Math.max((0.105 - 0.02 * k) * scale, 2.6 - 0.4 * k);
  for (let k = 1; k < points.length; k++) link(ctx, points[k - 1], points[k], radius(k - 1), radius(k));
  points.slice(1).forEach(([x, y], k) => {
    ctx.beginPath();
    ctx.arc(x, y, 0.75 * radius(k), 0, 7);
    ctx.fillStyle = ink("--joint");
    ctx.fill();
  });
}

/** Where the tool has been (line, fading) and will go (dots); close up, as the base sees it. */
function trail(ctx, view, to, now, m, closeUp) {
  const { run } = view;
  const held = Math.min(Math.ceil(film.item.duration / run.dt), run.arm.length - 1);
  const moved = closeUp
    ? (f) => plus(now.arm[0], plus(run.arm[f].at(-1), run.base[f].slice(0, 3), -1))
    : (f) => plus(run.arm[f].at(-1), run.base[f].slice(0, 3), m - 1);
  const tool = (f) => to(moved(f));
  const hue = ink(`--s${styleOf(run.planner)[0]}`);
  ctx.fillStyle = hue;
  ctx.globalAlpha = 0.5;
  for (let f = now.frame + 1; f <= held; f += 2) {
    const [x, y] = tool(f);
    ctx.fillRect(x - 0.8, y - 0.8, 1.6, 1.6);
  }
  for (let f = 1; f <= now.frame; f++) {
    ctx.globalAlpha = Math.max(0.12, 1 - (now.frame - f) * run.dt / 3);
    stroke(ctx, [tool(f - 1), tool(f)], 2.2, hue);
  }
  ctx.globalAlpha = 1;
  stroke(ctx, [tool(now.frame), to(now.arm.at(-1))], 2.2, hue);
}

/** One picture of the structure in a box; the arm's view follows the base. */
function structure(ctx, view, box, now, closeUp, { size = 1, low = false, clip = box } = {}) {
  const m = STEPS[$("scene-magnify").value];
  const frame = projection(view.extents[closeUp ? "arm" : "structure"], box, size, low);
  const to = closeUp ? (p) => frame.to(plus(p, now.arm[0], -1)) : frame.to;
  const width = Math.max(0.18 * frame.scale, closeUp ? 5 : 8);
  ctx.save();
  ctx.beginPath();
  ctx.rect(clip.x, clip.y, clip.w, clip.h);
  ctx.clip();
  const rest = restBeam(view.run);
  if (rest) stroke(ctx, rest.map(to), width, ink("--ghost"));
  if (rest && rest.length > 1) wall(ctx, to, rest);
  if (now.beam) tube(ctx, now.beam.map(to), width);
  else if (view.run.platform) drawPlatform(ctx, to, view.run.platform, now.base, now.shift, frame.scale);
  else body(ctx, to, now, view.run);
  obstacles(ctx, to, frame.scale);
  trail(ctx, view, to, now, m, closeUp);
  arm(ctx, now.arm.map(to), frame.scale);
  ctx.restore();
  return frame;
}

/** A base without a beam: a box of half a metre under the arm, turned as the base is. */
function body(ctx, to, now, run) {
  const turn = (p) => turned(p, run.base[now.frame].slice(3));
  const corner = (x, y, z) => to(plus(now.arm[0], turn([0.25 * x, 0.25 * y, 0.25 * z - 0.25])));
  const square = [[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]];
  for (const z of [-1, 1]) stroke(ctx, square.map(([x, y]) => corner(x, y, z)), 1.6, ink("--tube-edge"));
  for (const [x, y] of square) stroke(ctx, [corner(x, y, -1), corner(x, y, 1)], 1.6, ink("--tube-edge"));
}

/** Length of one metre, and the axes. */
function ruler(ctx, scale, w, h) {
  const metres = [0.2, 0.5, 1, 2, 5].findLast((k) => k * scale < 70) ?? 0.2;
  Object.assign(ctx, { font: "11px system-ui, sans-serif", fillStyle: ink("--soft"), textAlign: "left" });
  stroke(ctx, [[12, h - 12], [12 + metres * scale, h - 12]], 2, ink("--soft"));
  ctx.fillText(`${metres} m`, 12, h - 18);
  const { right, up } = screen(camera);
  const [x, y] = [w - 34, h - 26];
  ["x", "y", "z"].forEach((name, k) => {
    const tip = [x + 18 * right[k], y - 18 * up[k]];
    stroke(ctx, [[x, y], tip], 1.2, ink("--soft"));
    ctx.fillText(name, x + 25 * right[k] - 3, y - 25 * up[k] + 4);
  });
}

function drawInset(ctx, view, box, now) {
  Object.assign(ctx, { fillStyle: ink("--card"), strokeStyle: ink("--line"), lineWidth: 1 });
  ctx.beginPath();
  ctx.roundRect(box.x, box.y, box.w, box.h, 6);
  ctx.fill();
  ctx.stroke();
  structure(ctx, view, box, now, !film.swap);
}

function drawView(view) {
  const { ctx, w, h } = sharp(view.canvas);
  const now = pose(view.run, film.t, STEPS[$("scene-magnify").value]);
  const whole = { x: 0, y: 0, w, h };
  const box = { ...whole, h: film.swap ? 0.75 * h : h - 34 };
  const frame = structure(ctx, view, box, now, film.swap,
    { size: camera.zoom, low: !film.swap, clip: whole });
  const inset = film.swap // where the large picture leaves room
    ? { x: 0.62 * w, y: 0.64 * h, w: 0.38 * w - 8, h: 0.36 * h - 8 }
    : { x: 0.56 * w, y: 8, w: 0.44 * w - 8, h: 0.42 * h };
  if (restBeam(view.run)) drawInset(ctx, view, inset, now);
  ruler(ctx, frame.scale, film.swap ? inset.x : w, h);
  view.now.textContent = `${number(now.E)} J`;
}

/** E(t) of all planners, this one's strong, with the time cursor. */
function drawStrip(view) {
  const { ctx, w, h } = sharp(view.strip);
  const x = (t) => 6 + (w - 12) * t / film.end;
  const y = (E) => h - 5 - (h - 12) * E / film.peak;
  ctx.fillStyle = ink("--wash");
  ctx.fillRect(x(0), 0, x(film.item.duration) - x(0), h);
  for (const run of [...film.item.runs.filter((r) => r !== view.run), view.run]) {
    ctx.globalAlpha = run === view.run ? 1 : 0.28;
    stroke(ctx, run.E.map((E, k) => [x(k * run.dt), y(E)]), run === view.run ? 2 : 1,
      ink(`--s${styleOf(run.planner)[0]}`));
  }
  ctx.globalAlpha = 1;
  stroke(ctx, [[x(film.t), 0], [x(film.t), h]], 1, ink("--ink"));
}

function drawScene() {
  for (const view of film.views) {
    drawView(view);
    drawStrip(view);
  }
  $("scene-time").value = film.t;
  const phase = film.t < film.item.duration ? "moving" : "holding";
  $("scene-clock").textContent = `${film.t.toFixed(2)} s of ${film.end.toFixed(1)} s · ${phase}`;
  for (const follow of followers) follow(film.t);
}
