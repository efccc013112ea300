// The base under a moving arm: linear, with the arm's inertia as the arm moves.
//
// With x = (Y, internal modes, e), e how far the joints q are from their command r, the momentum
// u = H_bm(q) r' of the commanded motion and P = M(q) x' + u (docs/physics.md, Prediction):
//
//     x' = M(q)^-1 (P - u),    P' = -D x' - K x + g,
//
// g of the joints alone: torque of the command at r less that at q, q' and the base's turning, and
// what the change of inertia takes, d/dt(H_bm^T) Y' + d/dt(H_m) e'. Solved
// by the implicit midpoint rule, which keeps the energy of undamped modes at any step. A motor
// at its torque limit pushes with that limit. Friction of a joint (viscous, and Coulomb's as a steep
// tanh of the rate, as the effect joint/coulomb) acts at the rate in the middle of the step. Energy of the base: E = 1/2 Y'^T M_t Y' +
// 1/2 Y^T K Y, M_t with the arm's composite inertia; E_mean over the motion and the tail.

const TAIL = 10; // s after the motion that E_mean covers
const STEP = 0.005; // s of the motion
const COARSE = 0.01; // s, while the path is dragged
const LEAST_STEPS = 160;
const TAIL_STEP = 0.01; // s of the tail
const SHOWN = 4; // s of the tail in what is drawn, as in studio.py
const RECORD = 0.01; // s between records
const CREEP = 0.01; // rad/s over which Coulomb friction builds up, as in effects/joint_friction.py
const ROUNDS = 12; // of its slope within a step, at most

// --------------------------------------------------------------------- linear algebra

/** Lower factor of a symmetric positive definite matrix, by rows. */
function cholesky(A, n) {
  const L = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) {
      let value = A[i * n + j];
      for (let k = 0; k < j; k++) value -= L[i * n + k] * L[j * n + k];
      L[i * n + j] = i === j ? Math.sqrt(value) : value / L[j * n + j];
    }
  }
  return L;
}

/** x with L L^T x = b, in the place of b. */
function solveFactored(L, n, b) {
  for (let i = 0; i < n; i++) {
    let value = b[i];
    for (let k = 0; k < i; k++) value -= L[i * n + k] * b[k];
    b[i] = value / L[i * n + i];
  }
  for (let i = n - 1; i >= 0; i--) {
    let value = b[i];
    for (let k = i + 1; k < n; k++) value -= L[k * n + i] * b[k];
    b[i] = value / L[i * n + i];
  }
  return b;
}

/** 1/2 x^T A x over the first m of n coordinates. */
function quadratic(A, n, m, x) {
  let total = 0;
  for (let i = 0; i < m; i++) {
    let row = 0;
    for (let j = 0; j < m; j++) row += A[i * n + j] * x[j];
    total += x[i] * row;
  }
  return 0.5 * total;
}

/** Eigenvalues (ascending) and eigenvectors (columns) of a symmetric matrix, by Jacobi. */
function eigenSymmetric(matrix, n) {
  const A = Float64Array.from(matrix);
  const V = new Float64Array(n * n);
  for (let i = 0; i < n; i++) V[i * n + i] = 1;
  for (let sweep = 0; sweep < 30; sweep++) {
    let [off, on] = [0, 0];
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) {
      if (i === j) on += A[i * n + i] ** 2;
      else off += A[i * n + j] ** 2;
    }
    if (off <= 1e-26 * on) break;
    for (let p = 0; p < n - 1; p++) for (let q = p + 1; q < n; q++) rotate(A, V, n, p, q);
  }
  const order = Array.from({ length: n }, (_, k) => k).sort((a, b) => A[a * n + a] - A[b * n + b]);
  const vectors = new Float64Array(n * n);
  order.forEach((from, to) => { for (let i = 0; i < n; i++) vectors[i * n + to] = V[i * n + from]; });
  return { values: order.map((k) => A[k * n + k]), vectors };
}

function rotate(A, V, n, p, q) {
  const apq = A[p * n + q];
  if (apq === 0) return;
  const theta = (A[q * n + q] - A[p * n + p]) / (2 * apq);
  const t = (theta >= 0 ? 1 : -1) / (Math.abs(theta) + Math.sqrt(theta * theta + 1));
  const c = 1 / Math.sqrt(t * t + 1);
  const s = t * c;
  for (let k = 0; k < n; k++) {
    const [a, b] = [A[k * n + p], A[k * n + q]];
    A[k * n + p] = c * a - s * b;
    A[k * n + q] = s * a + c * b;
  }
  for (let k = 0; k < n; k++) {
    const [a, b] = [A[p * n + k], A[q * n + k]];
    A[p * n + k] = c * a - s * b;
    A[q * n + k] = s * a + c * b;
    const [x, y] = [V[k * n + p], V[k * n + q]];
    V[k * n + p] = c * x - s * y;
    V[k * n + q] = s * x + c * y;
  }
}

// -------------------------------------------------------------------------- the model

/** Matrices of a machine, made once: D and K of base and servos, sizes, torque limits. */
function linearModel(machine) {
  if (machine.linear) return machine.linear;
  const { base, servo, arm } = machine;
  const n = arm.links.length;
  const b = base.M.length;
  const size = b + (servo ? n : 0);
  const wide = (rows, joints) => {
    const out = new Float64Array(size * size);
    rows.forEach((row, i) => row.forEach((value, j) => { out[i * size + j] = value; }));
    if (servo) joints.forEach((value, j) => { out[(b + j) * size + b + j] = value; });
    return out;
  };
  machine.linear = {
    n, b, size, K: wide(base.K, servo?.kp), D: wide(base.D, servo?.kd), M: wide(base.M, new Array(n).fill(0)),
    limit: arm.links.map((link) => link.tau_max),
    friction: arm.links.map((link) => [link.damping, link.friction]),
    rubs: Boolean(servo) && arm.links.some((link) => link.damping || link.friction),
  };
  return machine.linear;
}

/** Inertia of x from the arm's inertia matrix H. */
function massOf({ n, b, size, M }, H) {
  const out = Float64Array.from(M);
  const width = 6 + n;
  for (let i = 0; i < 6; i++) for (let j = 0; j < 6; j++) out[i * size + j] += H[i * width + j];
  for (let j = 0; b + j < size; j++) {
    for (let i = 0; i < 6; i++) {
      out[i * size + b + j] += H[i * width + 6 + j];
      out[(b + j) * size + i] += H[i * width + 6 + j];
    }
    for (let i = 0; i < n; i++) out[(b + i) * size + b + j] += H[(6 + i) * width + 6 + j];
  }
  return out;
}

/** Natural modes of the base with the arm held at q: omega [rad/s] and rows that give their
 * coordinates from x. */
function baseModes(machine, q) {
  const model = linearModel(machine);
  const { b, size, K } = model;
  const mass = massOf(model, inertiaMatrix(machine.arm, q));
  const crop = (A) => Float64Array.from({ length: b * b }, (_, k) => A[Math.floor(k / b) * size + k % b]);
  const L = cholesky(crop(mass), b);
  const W = crop(K); // L^-1 K L^-T, both sides by forward substitution
  for (let side = 0; side < 2; side++) {
    for (let c = 0; c < b; c++) {
      for (let i = 0; i < b; i++) {
        let value = W[i * b + c];
        for (let k = 0; k < i; k++) value -= L[i * b + k] * W[k * b + c];
        W[i * b + c] = value / L[i * b + i];
      }
    }
    for (let i = 0; i < b; i++) for (let j = 0; j < i; j++) {
      [W[i * b + j], W[j * b + i]] = [W[j * b + i], W[i * b + j]];
    }
  }
  const { values, vectors } = eigenSymmetric(W, b);
  const rows = Array.from({ length: b }, (_, m) => Float64Array.from({ length: b }, (_, j) => {
    let value = 0;
    for (let i = 0; i <= j; i++) value += vectors[i * b + m] * L[j * b + i];
    return value;
  }));
  return { omega: values.map((value) => Math.sqrt(Math.max(value, 0))), rows };
}

/** Energy of each mode [J]. */
function modalEnergies({ omega, rows }, x, rate) {
  return rows.map((row, m) => {
    let [at, speed] = [0, 0];
    row.forEach((weight, j) => {
      at += weight * x[j];
      speed += weight * rate[j];
    });
    return 0.5 * (speed * speed + (omega[m] * at) ** 2);
  });
}

// ---------------------------------------------------------------------- the simulation

/** Friction of a joint over its rate v: the slope of a straight law that gives as much there. */
const frictionSlope = ([viscous, coulomb], v) => viscous
  + coulomb * (Math.abs(v) < 1e-9 ? 1 / CREEP : Math.tanh(v / CREEP) / v);

/** One step of x and P; `pinned` are the signs of joints whose motor is at its limit. */
class Stepper {
  constructor(model) {
    this.model = model;
    this.slopes = Float64Array.from(model.friction, (law) => frictionSlope(law, 0));
    this.used = this.slopes.slice(); // of them, for the step that was solved last
    this.A = new Float64Array(model.size ** 2);
    this.d = new Float64Array(model.size);
    this.factors = new Map(); // of a mass that stays, by what is pinned
  }

  /** Forget the factors: mass or step are no longer what they were. */
  renew() {
    this.factors.clear();
  }

  /** Factor of the step's matrix. */
  factor(mass, h, pinned) {
    const { b, size, K, D } = this.model;
    const key = pinned.reduce((code, side) => 3 * code + side + 1, 0);
    if (!this.factors.has(key)) {
      for (let k = 0; k < this.A.length; k++) this.A[k] = mass[k] + h / 2 * D[k] + h * h / 4 * K[k];
      pinned.forEach((side, j) => {
        const at = (b + j) * size + b + j;
        if (side) this.A[at] = mass[at];
        if (this.model.rubs) this.A[at] += h / 2 * this.slopes[j];
      });
      this.factors.set(key, cholesky(this.A, size));
    }
    return this.factors.get(key);
  }

  step(mass, h, x, P, { u, ahead, v: rates, kick }, pinned) {
    const { d, slopes, used, model: { b, size, K, D, limit, rubs } } = this;
    for (let attempt = 0; attempt < (rubs ? ROUNDS : 5); attempt++) {
      if (rubs) {
        this.renew();
        used.set(slopes);
      }
      for (let i = 0; i < size; i++) {
        let pull = 0;
        for (let j = 0; j < size; j++) pull += K[i * size + j] * x[j];
        const side = i >= b ? pinned[i - b] : 0;
        if (side) pull = ahead[i - b] - side * limit[i - b];
        if (rubs && i >= b) pull += slopes[i - b] * rates[i - b];
        d[i] = h * (P[i] - (i < 6 ? u[i] : 0)) - h * h / 2 * pull;
        if (i >= b) d[i] += h / 2 * kick[i - b];
      }
      solveFactored(this.factor(mass, h, pinned), size, d);
      if (size === b) break;
      const repinned = this.repin(h, x, ahead, pinned);
      if (!(rubs && this.regrade(h, rates)) && !repinned) break;
    }
    for (let i = 0; i < size; i++) {
      let push = 0;
      for (let j = 0; j < size; j++) push += D[i * size + j] * d[j] + h * K[i * size + j] * (x[j] + d[j] / 2);
      const side = i >= b ? pinned[i - b] : 0;
      P[i] -= side ? h * (ahead[i - b] - side * limit[i - b]) : push;
      if (i >= b) P[i] += kick[i - b];
      if (rubs && i >= b) P[i] -= used[i - b] * (h * rates[i - b] + d[i]);
    }
    for (let i = 0; i < size; i++) x[i] += d[i];
  }

  /** Take friction at the rates in the middle of the step; true if it changed by 0.1 %. */
  regrade(h, rates) {
    const { d, slopes, model: { b, friction } } = this;
    let changed = false;
    friction.forEach((law, j) => {
      const v = rates[j] + d[b + j] / h;
      const slope = frictionSlope(law, v);
      if (Math.abs((slope - slopes[j]) * v) > 1e-3 * (law[1] + Math.abs(law[0] * v))) changed = true;
      slopes[j] = slope;
    });
    return changed;
  }

  /** Find whose motors are at their limits in the middle of the step; true if that changed. */
  repin(h, x, ahead, pinned) {
    const { d, model: { b, size, K, D, limit } } = this;
    let changed = false;
    for (let j = 0; j < limit.length; j++) {
      const i = b + j;
      const asked = ahead[j] - K[i * size + i] * (x[i] + d[i] / 2) - D[i * size + i] * d[i] / h;
      const side = asked > limit[j] ? 1 : asked < -limit[j] ? -1 : 0;
      if (side !== pinned[j]) changed = true;
      pinned[j] = side;
    }
    return changed;
  }
}

function average(out, a, b) {
  for (let k = 0; k < a.length; k++) out[k] = (a[k] + b[k]) / 2;
}

/** What a motion needs at a node: inertia, momentum of the joints, torques on a base at rest, and
 * how much less they are at the command than where arm and base are (`x`, at its rate `dx`). */
function nodeOf(model, arm, r, v, a, x, dx) {
  const { n, b, size } = model;
  const given = (row, from) => (size === b ? row : row.map((value, j) => value + from[b + j]));
  const q = given(r, x);
  const H = inertiaMatrix(arm, q);
  const u = new Float64Array(6);
  for (let k = 0; k < 6; k++) for (let j = 0; j < n; j++) u[k] += H[k * (6 + n) + 6 + j] * v[j];
  const ahead = inverseDynamics(arm, r, v, a).tau;
  const there = size === b ? ahead : inverseDynamics(arm, q, given(v, dx), a, Array.from(dx.subarray(3, 6))).tau;
  return { mass: massOf(model, H), u, v, ahead, drift: ahead.map((value, j) => value - there[j]) };
}

/** Play a motion: energies [J], and with `detail` the records that are drawn. */
function simulateMotion(machine, motion, { detail = false, step = STEP } = {}) {
  const model = linearModel(machine);
  const { n, b, size, K, limit } = model;
  const { arm, servo } = machine;
  const T = motion.duration;
  const N = Math.max(LEAST_STEPS, Math.ceil(T / step));
  const s = sampleMotion(motion, N);
  const [x, P, rate, before] = [1, 2, 3, 4].map(() => new Float64Array(size));
  const pinned = new Array(n).fill(0);
  const still = new Array(n).fill(0);
  const stepper = new Stepper(model);
  const middle = {
    mass: new Float64Array(size * size), u: new Float64Array(6), v: new Float64Array(n), ahead: new Float64Array(n),
    drift: new Float64Array(n), kick: new Float64Array(n),
  };
  const run = { E_peak: 0, E_res: 0, E_mean: 0, saturated: false, records: [], duration: T };
  const measure = (factor, { mass, u }) => {
    before.set(rate);
    for (let i = 0; i < size; i++) rate[i] = P[i] - (i < 6 ? u[i] : 0);
    solveFactored(factor, size, rate);
    const E = quadratic(mass, size, b, rate) + quadratic(K, size, b, x);
    run.E_peak = Math.max(run.E_peak, E);
    return E;
  };
  const record = (t, E, cmd, v, ahead, h) => {
    const tau = ahead.map((value, j) => {
      const asked = servo ? value - servo.kp[j] * x[b + j] - servo.kd[j] * rate[b + j] : value;
      return Math.min(Math.max(asked, -limit[j]), limit[j]);
    });
    const give = (row, from) => row.map((value, j) => (servo ? value + from[b + j] : value));
    run.records.push({
      t, E, tau, cmd, q: give(cmd, x), v: give(v, rate), x: x.slice(0, b), rate: rate.slice(0, b),
      ydd: Array.from({ length: 6 }, (_, k) => (t > 0 ? (rate[k] - before[k]) / h : 0)),
    });
  };

  let h = T / N;
  let every = Math.max(1, Math.round(RECORD / h));
  let [integral, E] = [0, 0];
  let node = nodeOf(model, arm, s.q[0], s.v[0], s.a[0], x, rate);
  const [guess, onward, half] = [1, 2, 3].map(() => new Float64Array(size)); // x, x' of the next node; x' before it
  if (detail) record(0, 0, s.q[0], s.v[0], node.ahead, h);
  for (let k = 1; k <= N; k++) {
    for (let i = 0; i < size; i++) {
      half[i] = 1.5 * rate[i] - 0.5 * before[i];
      onward[i] = 2 * rate[i] - before[i];
      guess[i] = x[i] + h * half[i];
    }
    const next = nodeOf(model, arm, s.q[k], s.v[k], s.a[k], guess, onward);
    for (const part of ["mass", "u", "v", "ahead", "drift"]) average(middle[part], node[part], next[part]);
    for (let j = 0; b + j < size; j++) {
      middle.kick[j] = h * middle.drift[j];
      const row = (b + j) * size;
      for (let i = 0; i < size; i++) middle.kick[j] += (next.mass[row + i] - node.mass[row + i]) * half[i];
    }
    stepper.renew();
    stepper.step(middle.mass, h, x, P, middle, pinned);
    run.saturated ||= pinned.some(Boolean);
    node = next;
    const now = measure(cholesky(node.mass, size), node);
    integral += h * (E + now) / 2;
    E = now;
    if (detail && (k % every === 0 || k === N)) record(k * h, E, s.q[k], s.v[k], node.ahead, h);
  }
  run.E_res = E;

  h = TAIL_STEP;
  every = Math.round(2 * RECORD / h);
  const steps = Math.round(TAIL / h);
  const held = { mass: node.mass, u: new Float64Array(6), ahead: still, v: still, kick: still };
  const factor = cholesky(held.mass, size);
  stepper.renew();
  for (let k = 1; k <= steps; k++) {
    stepper.step(held.mass, h, x, P, held, pinned);
    const now = measure(factor, held);
    integral += h * (E + now) / 2;
    E = now;
    if (detail && k % every === 0 && k * h <= SHOWN + 1e-9) record(T + k * h, E, s.q[N], still, still, h);
  }
  run.E_mean = integral / (T + TAIL);
  return run;
}
