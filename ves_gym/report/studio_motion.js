// Joint motions: quintic B-splines in time from rest to rest, as ves_gym/mechanics/motion.py.

const DEGREE = 5;
const GRADING = 0.6; // of the knots, closer together near the ends
const HELD = 3; // equal control points at each end: at rest there
const CONTROLS = 48; // of a motion through way-points

/** Clamped knots on [0, 1] for m control points. */
function splineKnots(m) {
  const count = m - DEGREE + 1;
  const inside = Array.from({ length: count }, (_, k) => {
    const even = k / (count - 1);
    return even - GRADING * Math.sin(2 * Math.PI * even) / (2 * Math.PI);
  });
  return [...new Array(DEGREE).fill(0), ...inside, ...new Array(DEGREE).fill(1)];
}

/** The p + 1 functions of degree p, or their derivatives, that are not zero on a span. */
function splineBasis(knots, p, span, u, derivative = 0) {
  if (derivative > 0) {
    const lower = splineBasis(knots, p - 1, span, u, derivative - 1);
    return Array.from({ length: p + 1 }, (_, j) => {
      const i = span - p + j;
      const left = j > 0 ? lower[j - 1] / (knots[i + p] - knots[i]) : 0;
      const right = j < p ? lower[j] / (knots[i + p + 1] - knots[i + 1]) : 0;
      return p * (left - right);
    });
  }
  const out = [1];
  for (let k = 1; k <= p; k++) {
    let carry = 0;
    for (let r = 0; r < k; r++) {
      const [high, low] = [knots[span + r + 1], knots[span + 1 - k + r]];
      const part = out[r] / (high - low);
      out[r] = carry + (high - u) * part;
      carry = (u - low) * part;
    }
    out[k] = carry;
  }
  return out;
}

const designs = new Map(); // basis functions of a grid of times, made once

/** Rows of the design of m control points at N + 1 even times: first index and three orders. */
function design(m, N) {
  const key = `${m}/${N}`;
  if (designs.has(key)) return designs.get(key);
  const knots = splineKnots(m);
  let span = DEGREE;
  const rows = Array.from({ length: N + 1 }, (_, k) => {
    const u = k / N;
    while (span < m - 1 && u >= knots[span + 1]) span++;
    return { first: span - DEGREE, orders: [0, 1, 2].map((d) => splineBasis(knots, DEGREE, span, u, d)) };
  });
  if (designs.size > 24) designs.clear();
  designs.set(key, rows);
  return rows;
}

/** Angles, rates and accelerations of a motion at N + 1 even times. */
function sampleMotion({ duration, control }, N) {
  const n = control[0].length;
  const [q, v, a] = [[], [], []];
  for (const { first, orders } of design(control.length, N)) {
    [q, v, a].forEach((into, order) => {
      const row = new Array(n).fill(0);
      for (let k = 0; k <= DEGREE; k++) {
        const weight = orders[order][k] / duration ** order;
        for (let j = 0; j < n; j++) row[j] += weight * control[first + k][j];
      }
      into.push(row);
    });
  }
  return { q, v, a };
}

/** The quintic from rest to rest along a straight line in joint space. */
function straightMotion(start, goal, duration) {
  return { duration, control: [start, start, start, goal, goal, goal] };
}

/** Second derivatives of the interpolating spline: quadratic of 3 points, else not-a-knot. */
function splineCurvature(x, y) {
  const n = x.length;
  const h = x.slice(1).map((value, k) => value - x[k]);
  const slope = h.map((step, k) => (y[k + 1] - y[k]) / step);
  if (n === 3) return new Array(3).fill(2 * (slope[1] - slope[0]) / (h[0] + h[1]));
  const A = Array.from({ length: n }, () => new Array(n).fill(0));
  const b = new Array(n).fill(0);
  A[0].splice(0, 3, h[1], -h[0] - h[1], h[0]);
  A[n - 1].splice(n - 3, 3, h[n - 2], -h[n - 3] - h[n - 2], h[n - 3]);
  for (let k = 1; k < n - 1; k++) {
    A[k].splice(k - 1, 3, h[k - 1], 2 * (h[k - 1] + h[k]), h[k]);
    b[k] = 6 * (slope[k] - slope[k - 1]);
  }
  return solveDense(A, b);
}

/** Gaussian elimination with row exchange, of a small system. */
function solveDense(A, b) {
  const n = b.length;
  for (let k = 0; k < n; k++) {
    let best = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(A[i][k]) > Math.abs(A[best][k])) best = i;
    [A[k], A[best]] = [A[best], A[k]];
    [b[k], b[best]] = [b[best], b[k]];
    for (let i = k + 1; i < n; i++) {
      const factor = A[i][k] / A[k][k];
      for (let j = k; j < n; j++) A[i][j] -= factor * A[k][j];
      b[i] -= factor * b[k];
    }
  }
  const x = new Array(n);
  for (let i = n - 1; i >= 0; i--) {
    let rest = b[i];
    for (let j = i + 1; j < n; j++) rest -= A[i][j] * x[j];
    x[i] = rest / A[i][i];
  }
  return x;
}

const quintic = (u) => u ** 3 * (10 + u * (6 * u - 15));

/** Places along the spline through way-points, quintic in its length. */
function alongPath(way, samples) {
  const lengths = way.slice(1).map((p, k) => Math.hypot(...p.map((value, j) => value - way[k][j])));
  const total = lengths.reduce((a, b) => a + b);
  const x = [0];
  for (const length of lengths) x.push(x.at(-1) + length / total);
  x[x.length - 1] = 1;
  const columns = way[0].map((_, j) => way.map((p) => p[j]));
  const bends = columns.map((y) => splineCurvature(x, y));
  let piece = 0;
  return Array.from({ length: samples }, (_, k) => {
    const s = quintic(k / (samples - 1));
    while (piece < x.length - 2 && s >= x[piece + 1]) piece++;
    const h = x[piece + 1] - x[piece];
    const [u, w] = [(s - x[piece]) / h, (x[piece + 1] - s) / h];
    return columns.map((y, j) => w * y[piece] + u * y[piece + 1]
      + h * h / 6 * ((w ** 3 - w) * bends[j][piece] + (u ** 3 - u) * bends[j][piece + 1]));
  });
}

let fitting = null; // design of the fit and the factor of its normal equations

function fitter() {
  if (fitting) return fitting;
  const rows = design(CONTROLS, 20 * CONTROLS);
  const inside = CONTROLS - 2 * HELD;
  const normal = new Float64Array(inside * inside);
  for (const { first, orders: [N] } of rows) {
    for (let a = 0; a <= DEGREE; a++) {
      for (let b = 0; b <= DEGREE; b++) {
        const [i, j] = [first + a - HELD, first + b - HELD];
        if (i >= 0 && i < inside && j >= 0 && j < inside) normal[i * inside + j] += N[a] * N[b];
      }
    }
  }
  fitting = { rows, inside, factor: cholesky(normal, inside) };
  return fitting;
}

/** A smooth motion along way-points, quintic in the length of its path. */
function motionThrough(points, duration) {
  const way = points.filter((p, k) => k === 0
    || Math.hypot(...p.map((value, j) => value - points[k - 1][j])) > 1e-12);
  const [start, goal] = [points[0], points.at(-1)];
  if (way.length < 3) return straightMotion(start, goal, duration);
  const { rows, inside, factor } = fitter();
  const q = alongPath(way, rows.length);
  q[0] = start;
  q[q.length - 1] = goal;
  const control = Array.from({ length: CONTROLS }, (_, k) => (k < HELD ? [...start]
    : k >= CONTROLS - HELD ? [...goal] : new Array(start.length)));
  start.forEach((_, j) => {
    const right = new Float64Array(inside);
    rows.forEach(({ first, orders: [N] }, k) => {
      let rest = q[k][j];
      for (let a = 0; a <= DEGREE; a++) {
        if (first + a < HELD) rest -= N[a] * start[j];
        if (first + a >= CONTROLS - HELD) rest -= N[a] * goal[j];
      }
      for (let a = 0; a <= DEGREE; a++) {
        const i = first + a - HELD;
        if (i >= 0 && i < inside) right[i] += N[a] * rest;
      }
    });
    solveFactored(factor, inside, right);
    right.forEach((value, i) => { control[HELD + i][j] = value; });
  });
  return { duration, control };
}
