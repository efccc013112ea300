"""The machine in motion: joints, platform, force sensor and control loop, stepped in time.

One state vector, classical Runge-Kutta, a control tick per sample. What a healthy machine
has none of (elasticity, friction, backlash, ...) is a number that is zero. Functions work in
place on preallocated arrays: the loop is compiled by numba.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.benchmark.blind.compiled import compiled
from ves_gym.diagnosis.benchmark.blind.mechanics import (
    BodyParameters,
    conjugate,
    fill_trig,
    newton_euler,
    platform_motion,
    solve3,
    unit_column,
)

# state: link angle, rate; motor angle, rate; bristle; age of rest; platform pose, rate;
# filtered wrench, its rate
Q, V, TH, OM, BR, AGE, Y, YD, FILT, FILTD, SIZE = 0, 3, 6, 9, 12, 15, 18, 24, 30, 36, 42
# columns of `Plant.friction`
COULOMB, STICTION, FADE, VISCOUS, ONE_WAY, LOAD, RESTING, BRISTLE = range(8)


class BlindPlant(NamedTuple):
    """Numbers of one machine; joints n = 3."""

    bodies: BodyParameters
    rotor: Array  # (3,) kg m^2, reflected
    kp: Array  # (3,) N m/rad
    kd: Array  # (3,) N m s/rad
    gain: Array  # (3,) torque per stated torque
    limit: Array  # (3,) N m, of the drive's command
    ceiling: Array  # (3,) N m, what the motor gives at most
    stiffness: Array  # (3,) N m/rad of the gear; 0: rigid
    loss: Array  # (3,) N m s/rad of the gear
    gap: Array  # (3,) rad, half the backlash; 0: none
    friction: Array  # (3, 8) N m, ...; columns above
    ripple: Array  # (3, 3) N m, periods per turn, phase
    hose: Array  # (6,) N m/rad, share of each joint, slack angle and softness [rad]
    filter: float  # rad/s, Butterworth of the force sensor
    to_signal: Array  # (6, 6) wrench -> sensor signals
    to_wrench: Array  # (6, 6) signals -> wrench as calibrated
    offset: Array  # (6,) of the signals
    creep: Array  # (6,) of the signals, reached in the long run
    creep_time: float  # s
    pickup: Array  # (6,) amplitude of mains in the signals
    mains: Array  # (2,) rad/s, phase
    resolution: Array  # (6,) of the signals; 0: not quantised
    encoder: Array  # (3,) rad, resolution
    zero: Array  # (3,) rad, error of the encoders' zero
    age: float  # s, of the joint readings that servo, gravity estimate and log get
    servo: Array  # (3,) platform: rad/s, damping ratio, rate feed-forward (0 or 1)
    late: float  # s, the platform's extra delay
    legs: Array  # (6, 6) leg lengths per pose
    stroke: Array  # (6,) m, of each leg about home
    drag: Array  # (6,) against the base's speed squared [N s^2/m^2, N m s^2]
    floor: Array  # (k, 5) m/s^2, rad/s, phase, direction x, direction z
    rock: Array  # (3,) rad about x, rad/s, phase
    estimate: BodyParameters  # what the gravity compensation believes
    surplus: float  # kg too much in its force
    tilt: Array  # (3,) rad, error of the pose it is given
    scale: float  # of the whole estimate
    phi: Array  # (2z, 2z) admittance, one period
    gamma: Array  # (2z, 6)
    delay: int  # periods from reading to command


class PlantInputs(NamedTuple):
    """Commands and noise of one run of N samples."""

    q: Array  # (M, 3) commanded angle at half steps, warm-up included [rad]
    v: Array
    ff: Array  # feed-forward torque [N m]
    warm: int  # periods before the record
    substeps: int  # per period
    dt: float  # control period [s]
    noise_q: Array  # (N, 3)
    noise_v: Array
    noise_tau: Array
    noise_y: Array  # (N, 6)
    noise_w: Array  # (N, 6) of the signals
    lost: Array  # (N,) 1 where a wrench packet is lost


class Scratch(NamedTuple):
    """Room for intermediate results."""

    work: Array
    trig: Array
    tau: Array
    wrench: Array
    zero: Array
    zero6: Array
    columns: Array
    H: Array
    rhs: Array
    acc: Array
    spin: Array
    turn: Array
    pull: Array
    pose: Array
    rate: Array
    sway: Array
    angle: Array
    pace: Array
    motor: Array
    passed: Array


def scratch() -> Scratch:
    """Return fresh room for three joints."""
    z = np.zeros
    return Scratch(
        z((4, 12)), z((3, 4)), z(3), z(6), z(3), z(6), z((3, 9)), z((3, 3)), z(3), z(3),
        z(3), z(3), z(3), z(6), z(6), z(6), z(3), z(3), z(3), z(3),
    )  # fmt: skip


@compiled
def servo_torque(p, s, q, v, ff, j):  # type: ignore[no-untyped-def]
    """Return the torque that the drive asks of motor j, within the limit [N m]."""
    torque = p.kp[j] * (q[j] - s.angle[j]) + p.kd[j] * (v[j] - s.pace[j]) + ff[j]
    return min(max(torque, -p.limit[j]), p.limit[j])


@compiled
def rates(p, x, q, v, ff, goal, speed, t, dx, s):  # type: ignore[no-untyped-def]
    """Compute dx/dt of the machine under its commands; `s.wrench` becomes the arm's wrench.

    Args:
        p, s: plant and scratch.
        x: (42,) state.
        q, v, ff: (3,) commanded angle, rate, feed-forward torque.
        goal, speed: (6,) that the platform's servo follows.
        t: s.
        dx: (42,) output.
    """
    w, zeta = p.servo[0], p.servo[1]
    for i in range(6):
        dx[Y + i] = x[YD + i]
        error = x[Y + i] - goal[i]
        dx[YD + i] = -(w * w) * error - 2 * zeta * w * (x[YD + i] - p.servo[2] * speed[i])
        s.pose[i], s.rate[i], s.sway[i] = x[Y + i], x[YD + i], dx[YD + i]
    for k in range(len(p.floor)):
        shake = p.floor[k, 0] * math.sin(p.floor[k, 1] * t + p.floor[k, 2])
        s.sway[0] += shake * p.floor[k, 3]
        s.sway[2] += shake * p.floor[k, 4]
    if p.rock[0] != 0.0:
        arg = p.rock[1] * t + p.rock[2]
        s.pose[3] += p.rock[0] * (math.sin(arg) - math.sin(p.rock[2]))
        s.rate[3] += p.rock[0] * p.rock[1] * math.cos(arg)
        s.sway[3] -= p.rock[0] * p.rock[1] ** 2 * math.sin(arg)
    platform_motion(s.pose, s.rate, s.sway, s.spin, s.turn, s.pull)
    rate = x[V : V + 3]
    fill_trig(p.bodies, x[Q : Q + 3], s.trig)
    for j in range(3):
        unit_column(p.bodies, s.trig, j, s.work, s.columns[j])
        for i in range(3):
            s.H[i, j] = s.columns[j, i]
    newton_euler(
        p.bodies, s.trig, rate, s.zero, s.spin, s.turn, s.pull, s.work, s.tau, s.wrench
    )
    along = 0.0
    for j in range(3):
        along += p.hose[1 + j] * x[Q + j]
    stretch = along - p.hose[4]
    tension = p.hose[0] * 0.5 * (stretch + math.sqrt(stretch * stretch + p.hose[5] ** 2))
    for j in range(3):
        om, f = x[OM + j], p.friction[j]
        drive = p.gain[j] * servo_torque(p, s, q, v, ff, j)
        drive = min(max(drive, -p.ceiling[j]), p.ceiling[j])
        drive += p.ripple[j, 0] * math.sin(p.ripple[j, 1] * x[TH + j] + p.ripple[j, 2])
        z = x[BR + j]
        level = f[COULOMB] + f[STICTION] * math.exp(-((om / f[FADE]) ** 2))
        level += f[RESTING] * x[AGE + j]
        drive -= level * z + f[VISCOUS] * om + f[ONE_WAY] * z * z
        # at high speed over a time, not a length, that the integrator can follow
        dx[BR + j] = (om - abs(om) * z) / max(f[BRISTLE], abs(om) * 1e-3)
        dx[AGE + j] = (1 - x[AGE + j]) / 1.5 - abs(om) / 0.01 * x[AGE + j]
        s.rhs[j] = -s.tau[j] - tension * p.hose[1 + j]
        if p.stiffness[j] > 0:
            wind, slide, give = x[TH + j] - x[Q + j], om - x[V + j], 1.0
            if p.gap[j] > 0:  # teeth meet softly over a tenth of the half gap
                edge, soft = p.gap[j], 0.1 * p.gap[j]
                above, below = wind - edge, -wind - edge
                high, low = math.sqrt(above**2 + soft**2), math.sqrt(below**2 + soft**2)
                wind = 0.5 * (above + high - below - low)
                give = 0.5 * (2.0 + above / high + below / low)
            s.passed[j] = p.stiffness[j] * wind + p.loss[j] * give * slide
            s.rhs[j] += s.passed[j]
        else:
            s.H[j, j] += p.rotor[j]
            s.rhs[j] += drive
        s.motor[j] = drive
    solve3(s.H, s.rhs, s.acc)
    loaded = False
    for j in range(3):
        if p.friction[j, LOAD] > 0:
            loaded = True
            through = s.passed[j]
            if p.stiffness[j] <= 0:
                through = s.motor[j] - p.rotor[j] * s.acc[j]
            drag = p.friction[j, LOAD] * abs(through) * x[BR + j]
            s.motor[j] -= drag
            if p.stiffness[j] <= 0:
                s.rhs[j] -= drag
    if loaded:
        solve3(s.H, s.rhs, s.acc)
    for j in range(3):
        dx[Q + j], dx[V + j] = x[V + j], s.acc[j]
        dx[TH + j], dx[OM + j] = x[OM + j], s.acc[j]
        if p.stiffness[j] > 0:
            dx[OM + j] = (s.motor[j] - s.passed[j]) / p.rotor[j]
    for i in range(6):
        for j in range(3):
            s.wrench[i] += s.columns[j, 3 + i] * s.acc[j]
    b = p.filter
    for i in range(6):
        dx[FILT + i] = x[FILTD + i]
        dx[FILTD + i] = b * b * (s.wrench[i] - x[FILT + i]) - math.sqrt(2.0) * b * x[FILTD + i]


@compiled
def platform_command(p, sent, k, dt, t, goal, speed):  # type: ignore[no-untyped-def]
    """Compute pose and rate that the platform's servo follows, delay and stroke in.

    Args:
        p: plant.
        sent: (samples + 1, 12) commands of every period.
        k: period.
        dt: its length [s].
        t: time [s].
        goal, speed: (6,) outputs.
    """
    when = (t - p.late) / dt
    row = min(math.floor(when), k)
    if row < 0:
        for i in range(6):
            goal[i], speed[i] = 0.0, 0.0
        return
    ahead = (when - row) * dt * p.servo[2]
    for i in range(6):
        goal[i], speed[i] = sent[row, i] + ahead * sent[row, 6 + i], sent[row, 6 + i]
    most, length, pace = 1.0, 0.0, 0.0
    for i in range(6):
        reach, change = 0.0, 0.0
        for j in range(6):
            reach += p.legs[i, j] * goal[j]
            change += p.legs[i, j] * speed[j]
        if abs(reach) > most * p.stroke[i]:
            most, length, pace = abs(reach) / p.stroke[i], reach, change
    if most > 1.0:  # held back on its way from home, sliding along the tightest leg's end
        for i in range(6):
            speed[i] = (speed[i] - goal[i] * pace / length) / most
            goal[i] /= most


@compiled
def observe(p, x, past, row, within, h, s):  # type: ignore[no-untyped-def]
    """Compute motor angles and rates as their readings show them, into `s.angle`, `s.pace`.

    Args:
        p, s: plant and scratch.
        x: (42,) state.
        past: angles, rates and accelerations (rows, 9) at the steps so far, `row` the last.
        within: time since that step [s].
        h: step [s].
    """
    back = (within - p.age) / h
    for j in range(3):
        if p.age <= 0.0:
            s.angle[j], s.pace[j] = x[TH + j], x[OM + j]
        elif row + back <= 0.0:
            s.angle[j], s.pace[j] = past[0, j], 0.0
        elif back > 0.0:
            t = back * h
            s.pace[j] = past[row, 3 + j] + t * past[row, 6 + j]
            s.angle[j] = past[row, j] + t * (past[row, 3 + j] + t / 2 * past[row, 6 + j])
        else:  # Hermite's cubic between two steps
            k = min(math.floor(row + back), row - 1)
            u = row + back - k
            a, b = past[k, j], past[k + 1, j]
            c, d = h * past[k, 3 + j], h * past[k + 1, 3 + j]
            k2, k3 = 3 * (b - a) - 2 * c - d, 2 * (a - b) + c + d
            s.angle[j] = a + u * (c + u * (k2 + u * k3))
            s.pace[j] = (c + u * (2 * k2 + 3 * u * k3)) / h


@compiled
def run_plant(p, u, x, s, out):  # type: ignore[no-untyped-def]
    """Play a run.

    Args:
        p, u, s: plant, inputs and scratch.
        x: (42,) state at the start, changed in place.
        out: (N, 33) output: q 3, v 3, tau 3, y 6, y_cmd 6, w 6, wg 6.
    """
    samples, h = len(out), u.dt / u.substeps
    k1, k2, k3, k4 = np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE)
    mid, goal, speed = np.zeros(SIZE), np.zeros(6), np.zeros(6)
    z = np.zeros(len(p.phi))
    sent, queue = np.zeros((samples + 1, 12)), np.zeros((p.delay + 1, 12))
    reading, static, net, force = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    signal, q_meas, pose = np.zeros(6), np.zeros(3), np.zeros(6)
    turning, torque = np.zeros(3), np.zeros(3)
    past = np.zeros(((samples + u.warm) * u.substeps + 1, 9))
    row, half = 0, 0  # index of the step, of the half step reached
    for j in range(3):
        past[0, j] = x[TH + j]
    for tick in range(-u.warm, samples):
        t = tick * u.dt
        if tick >= 0:
            observe(p, x, past, row, 0.0, h, s)
            for j in range(3):
                angle = s.angle[j] + p.zero[j] + u.noise_q[tick, j]
                if p.encoder[j] > 0:
                    angle = round(angle / p.encoder[j]) * p.encoder[j]
                q_meas[j] = angle
                drive_torque = servo_torque(p, s, u.q[half], u.v[half], u.ff[half], j)
                out[tick, j] = angle
                out[tick, 3 + j] = s.pace[j] + u.noise_v[tick, j]
                out[tick, 6 + j] = drive_torque + u.noise_tau[tick, j]
            for i in range(6):
                out[tick, 9 + i] = x[Y + i] + u.noise_y[tick, i]
                out[tick, 15 + i] = sent[max(tick - 1, 0), i]
                pose[i] = out[tick, 9 + i] + (p.tilt[i - 3] if i > 2 else 0.0)
            if u.lost[tick] == 0.0:
                mains = math.sin(p.mains[0] * t + p.mains[1])
                for i in range(6):
                    value = 0.0
                    for j in range(6):
                        value += p.to_signal[i, j] * x[FILT + j]
                    value += p.offset[i] + p.creep[i] * (1 - math.exp(-t / p.creep_time))
                    value += p.pickup[i] * mains + u.noise_w[tick, i]
                    if p.resolution[i] > 0:
                        value = round(value / p.resolution[i]) * p.resolution[i]
                    signal[i] = value
                for i in range(6):
                    value = 0.0
                    for j in range(6):
                        value += p.to_wrench[i, j] * signal[j]
                    reading[i] = value
            platform_motion(pose, s.zero6, s.zero6, s.spin, turning, s.pull)
            fill_trig(p.estimate, q_meas, s.trig)
            newton_euler(
                p.estimate,
                s.trig,
                s.zero,
                s.zero,
                s.zero,
                s.zero,
                s.pull,
                s.work,
                torque,
                static,
            )
            for i in range(6):
                extra = -p.surplus * s.pull[i] if i < 3 else 0.0
                net[i] = reading[i] - p.scale * static[i] - extra
                out[tick, 21 + i], out[tick, 27 + i] = reading[i], net[i]
            conjugate(z, net, force)
            for i in range(6):
                speed_i = z[len(z) // 2 + i]
                force[i] -= p.drag[i] * abs(speed_i) * speed_i
            z = p.phi @ z + p.gamma @ force
            size = len(z) // 2
            for i in range(6):
                queue[p.delay, i], queue[p.delay, 6 + i] = z[i], z[size + i]
            for i in range(12):
                sent[tick, i] = queue[0, i]
                for k in range(p.delay):
                    queue[k, i] = queue[k + 1, i]
        period = max(tick, 0)
        for step in range(u.substeps):
            start = t + step * h
            platform_command(p, sent, period, u.dt, start + 1e-9, goal, speed)
            observe(p, x, past, row, 0.0, h, s)
            rates(p, x, u.q[half], u.v[half], u.ff[half], goal, speed, start, k1, s)
            for j in range(3):
                past[row, 6 + j] = k1[OM + j]
            for i in range(SIZE):
                mid[i] = x[i] + h / 2 * k1[i]
            platform_command(p, sent, period, u.dt, start + h / 2, goal, speed)
            a, b, c = u.q[half + 1], u.v[half + 1], u.ff[half + 1]
            observe(p, mid, past, row, h / 2, h, s)
            rates(p, mid, a, b, c, goal, speed, start + h / 2, k2, s)
            for i in range(SIZE):
                mid[i] = x[i] + h / 2 * k2[i]
            observe(p, mid, past, row, h / 2, h, s)
            rates(p, mid, a, b, c, goal, speed, start + h / 2, k3, s)
            for i in range(SIZE):
                mid[i] = x[i] + h * k3[i]
            platform_command(p, sent, period, u.dt, start + h - 1e-9, goal, speed)
            a, b, c = u.q[half + 2], u.v[half + 2], u.ff[half + 2]
            observe(p, mid, past, row, h, h, s)
            rates(p, mid, a, b, c, goal, speed, start + h, k4, s)
            for i in range(SIZE):
                x[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
            half, row = half + 2, row + 1
            for j in range(3):
                past[row, j], past[row, 3 + j] = x[TH + j], x[OM + j]
