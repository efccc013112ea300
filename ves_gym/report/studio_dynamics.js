// Rigid-body dynamics of a serial arm on its base, as ves_gym/mechanics/dynamics.py has it.
//
// Frame: the platform-top frame; wrench and twist at its origin, linear part first. A rotation
// is nine numbers, column by column.

const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const times = (s, v) => [s * v[0], s * v[1], s * v[2]];
const sum = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const less = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const inner = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const apply = (R, v) => [
  R[0] * v[0] + R[3] * v[1] + R[6] * v[2],
  R[1] * v[0] + R[4] * v[1] + R[7] * v[2],
  R[2] * v[0] + R[5] * v[1] + R[8] * v[2],
];

// ------------------------------------------------------------------------ kinematics

/** Pose of every link frame at joint angles q [rad], with axis and origin of its joint. */
function linkFrames(arm, q) {
  let { R, p } = arm.mount;
  return arm.links.map((link, i) => {
    const axis = [R[6], R[7], R[8]];
    const origin = p;
    const angle = link.slides ? link.offset : q[i] + link.offset;
    const d = link.slides ? link.d + q[i] : link.d;
    const [c, s] = [Math.cos(angle), Math.sin(angle)];
    const x = [c * R[0] + s * R[3], c * R[1] + s * R[4], c * R[2] + s * R[5]];
    const y = [c * R[3] - s * R[0], c * R[4] - s * R[1], c * R[5] - s * R[2]];
    p = sum(p, sum(times(d, axis), times(link.a, x)));
    R = [...x, ...sum(times(link.ca, y), times(link.sa, axis)),
      ...less(times(link.ca, axis), times(link.sa, y))];
    if (link.sb) {
      const [from, up] = [R.slice(0, 3), R.slice(6)];
      R = [...less(times(link.cb, from), times(link.sb, up)), R[3], R[4], R[5],
        ...sum(times(link.sb, from), times(link.cb, up))];
    }
    return { R, p, axis, origin, slides: link.slides };
  });
}

/** Origins of the platform frame and of every link frame [m]; the last is the tool. */
function jointPositions(arm, q) {
  return [[0, 0, 0], ...linkFrames(arm, q).map((frame) => frame.p)];
}

// -------------------------------------------------------------------- inertia matrix

/** Moment of inertia about the centre of mass in platform axes: xx, yy, zz, xy, xz, yz. */
function turnedMoment(R, I) {
  const columns = [apply(R, I[0]), apply(R, I[1]), apply(R, I[2])];
  const entry = (i, j) => columns[0][i] * R[j] + columns[1][i] * R[3 + j] + columns[2][i] * R[6 + j];
  return [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)];
}

const turning = (J, w) => [
  J[0] * w[0] + J[3] * w[1] + J[4] * w[2],
  J[3] * w[0] + J[1] * w[1] + J[5] * w[2],
  J[4] * w[0] + J[5] * w[1] + J[2] * w[2],
];

const UPRIGHT = [1, 0, 0, 0, 1, 0, 0, 0, 1];

/** Mass, first moment and second moment of a body about the origin. */
function aboutOrigin({ mass, inertia }, R, com) {
  const J = turnedMoment(R, inertia);
  const [x, y, z] = com;
  return {
    mass, moment: times(mass, com),
    J: [J[0] + mass * (y * y + z * z), J[1] + mass * (x * x + z * z), J[2] + mass * (x * x + y * y),
      J[3] - mass * x * y, J[4] - mass * x * z, J[5] - mass * y * z],
  };
}

function together(a, b) {
  return { mass: a.mass + b.mass, moment: sum(a.moment, b.moment), J: a.J.map((v, k) => v + b.J[k]) };
}

/** Force, or moment about the origin, that a joint's coordinate feels. */
const along = (joint, force, moment) => (joint.slides ? inner(joint.axis, force)
  : inner(joint.axis, moment) + inner(cross(joint.origin, joint.axis), force));

/** Inertia matrix of arm and base link, rows of (6 + n): [[H_b, H_bm], [H_bm^T, H_m]]. */
function inertiaMatrix(arm, q) {
  const n = arm.links.length;
  const size = 6 + n;
  const frames = linkFrames(arm, q);
  const H = new Float64Array(size * size);
  let all = null;
  for (let j = n - 1; j >= 0; j--) {
    const frame = frames[j];
    const link = arm.links[j];
    const one = aboutOrigin(link, frame.R, sum(frame.p, apply(frame.R, link.com)));
    all = all === null ? one : together(all, one);
    // unit rate of joint j: linear and angular momentum of all that it moves
    let linear = times(all.mass, frame.axis);
    let angular = cross(all.moment, frame.axis);
    if (!frame.slides) {
      const slide = cross(frame.origin, frame.axis);
      linear = sum(times(all.mass, slide), cross(frame.axis, all.moment));
      angular = sum(cross(all.moment, slide), turning(all.J, frame.axis));
    }
    [...linear, ...angular].forEach((value, k) => {
      H[k * size + 6 + j] = value;
      H[(6 + j) * size + k] = value;
    });
    for (let i = 0; i <= j; i++) {
      const value = along(frames[i], linear, angular) + (i === j ? link.rotor : 0);
      H[(6 + i) * size + 6 + j] = value;
      H[(6 + j) * size + 6 + i] = value;
    }
  }
  spatialInto(H, size, together(all, aboutOrigin(arm.base, UPRIGHT, arm.base.com)));
  return H;
}

/** The first six rows and columns: spatial inertia of a composite at the origin. */
function spatialInto(H, size, { mass, moment, J }) {
  const both = (i, j, value) => {
    H[i * size + j] = value;
    H[j * size + i] = value;
  };
  const [x, y, z] = moment;
  for (let i = 0; i < 3; i++) {
    both(i, i, mass);
    both(3 + i, 3 + i, J[i]);
  }
  [[0, 4, z], [1, 5, x], [2, 3, y], [0, 5, -y], [1, 3, -z], [2, 4, -x],
    [3, 4, J[3]], [3, 5, J[4]], [4, 5, J[5]]].forEach((entry) => both(...entry));
}

// ------------------------------------------------------------------ inverse dynamics

/** Torques [N m] of a motion on a base that stands still or turns at a rate, and the wrench on it. */
function inverseDynamics(arm, q, v, a, spin = [0, 0, 0]) {
  const frames = linkFrames(arm, q);
  const moved = (at, w, dw, r) => sum(at, sum(cross(dw, r), cross(w, cross(w, r))));
  let [w, dw, accel, point] = [spin, [0, 0, 0], [0, 0, 0], arm.mount.p];
  const pushes = frames.map((frame, i) => {
    const link = arm.links[i];
    const rate = times(v[i], frame.axis);
    if (frame.slides) {
      accel = sum(accel, sum(times(a[i], frame.axis), times(2, cross(w, rate))));
    } else {
      dw = sum(dw, sum(times(a[i], frame.axis), cross(w, rate)));
      w = sum(w, rate);
    }
    const com = sum(frame.p, apply(frame.R, link.com));
    const force = times(link.mass, moved(accel, w, dw, less(com, point)));
    const J = turnedMoment(frame.R, link.inertia);
    const spun = sum(turning(J, dw), cross(w, turning(J, w)));
    accel = moved(accel, w, dw, less(frame.p, point));
    point = frame.p;
    return { force, moment: sum(spun, cross(com, force)) };
  });
  let [force, moment] = [[0, 0, 0], [0, 0, 0]];
  const tau = new Array(frames.length);
  for (let i = frames.length - 1; i >= 0; i--) {
    force = sum(force, pushes[i].force);
    moment = sum(moment, pushes[i].moment);
    tau[i] = along(frames[i], force, moment) + arm.links[i].rotor * a[i];
  }
  return { tau, wrench: [...force, ...moment].map((value) => -value) };
}
