"""Mode emulated: the arm on a platform under gravity that moves as the vehicle would.

Each control period: the force sensor is read, the estimated weight subtracted, the vehicle's
equation advanced by the rest, and the platform sent the motion of the period before.
"""

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from benchmarks.trial.arm import Array, Bodies, Table, arm_bodies, rotation, twist_matrix
from benchmarks.trial.hidden import Hidden, Signals
from benchmarks.trial.joints import Joints
from benchmarks.trial.platforms import read_platform
from benchmarks.trial.servo import Motion, Servo, command
from benchmarks.trial.space import Run, late
from benchmarks.trial.structure import base_body, read_base


def sensor_frame(table: Table) -> Array:
    """Return the matrix (6, 6) from a wrench on the platform to the sensor's signals."""
    R, r = np.diag([1.0, -1.0, -1.0]), np.asarray(table["offset"], float)
    cross = np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])
    return np.block([[R, np.zeros((3, 3))], [-R @ cross, R]])


def resting_signals(description: Table) -> Array:
    """Return the sensor's signals (6,) under the weight of the arm as described, at q = 0."""
    arm = arm_bodies(description["arm"])
    z = np.zeros(6 + arm.n)
    return np.asarray(sensor_frame(description["emulator"]["sensor"]) @ arm.weight(z)[:6])


class Sensor:
    """Six-axis force sensor: second-order Butterworth filter, gains in a frame of its own."""

    def __init__(self, table: Table, h: float, signals: Signals) -> None:
        w = 2 * np.pi * table["cutoff"] * signals.sensor_cutoff
        A = np.zeros((4, 4))  # output, its rate, input, slope of the input
        A[0, 1] = A[2, 3] = 1.0
        A[1, :3] = -w * w, -np.sqrt(2) * w, w * w
        E = sla.expm(A * h)
        self.hold, now, slope = E[:2, :2], E[:2, 2], E[:2, 3]
        self.old, self.new = now - slope / h, slope / h
        X = sensor_frame(table)
        back = np.linalg.inv(X)
        self.gain = back @ signals.sensor_gain @ X
        self.bias = back @ signals.sensor_bias
        self.x, self.w = np.zeros((2, 6)), np.zeros(6)

    def start(self, w: Array) -> None:
        """Settle at a constant wrench (6,)."""
        self.x, self.w = np.array([w, np.zeros(6)]), w

    def jump(self, w: Array) -> None:
        """Go on from another wrench (6,) at this instant."""
        self.w = w

    def advance(self, w: Array) -> None:
        """Pass half a step, in which the wrench went to `w` (6,) along a line."""
        self.x = self.hold @ self.x + np.outer(self.old, self.w) + np.outer(self.new, w)
        self.w = w

    def read(self) -> Array:
        """Return the wrench (6,) as reported."""
        return np.asarray(self.gain @ self.x[0] + self.bias)


class Vehicle:
    """The vehicle in the computer: its motion under a wrench held for a control period."""

    def __init__(
        self,
        vehicle: Table,
        dt: float,
        force: Callable[[Array, Array], Array] | None = None,
    ) -> None:
        base = read_base(dict(vehicle))
        self.size, self.dt, self.force = 6 + base.inner, dt, force
        self.body = base_body(base)
        m = self.size
        self.X = np.zeros(2 * m)
        if self.body is None:
            A = np.zeros((2 * m + 6, 2 * m + 6))
            A[:m, m : 2 * m] = np.eye(m)
            A[m : 2 * m, : 2 * m] = -np.linalg.solve(base.M, np.hstack([base.K, base.D]))
            A[m : 2 * m, 2 * m :] = np.linalg.solve(base.M, np.eye(m)[:, :6])
            E = sla.expm(A * dt)
            self.phi, self.gamma = E[: 2 * m, : 2 * m], E[: 2 * m, 2 * m :]

    @property
    def pose(self) -> Array:
        """Pose of the flange (6,)."""
        return self.X[:6]

    @property
    def speed(self) -> Array:
        """Rate of the pose (6,)."""
        return self.X[self.size : self.size + 6]

    def _rate(self, X: Array, w: Array) -> Array:
        assert self.body is not None
        M, c = self.body.terms(X[:6], X[6:])
        pull = twist_matrix(X[:6]).T @ w
        return np.concatenate([X[6:], np.linalg.solve(M, pull - c)])

    def advance(self, w: Array) -> None:
        """Move on for a period under the wrench w (6,) in platform axes."""
        if self.body is None:
            push = twist_matrix(self.pose).T @ w
            if self.force is not None:
                push = push + self.force(self.pose, self.speed)
            self.X = self.phi @ self.X + self.gamma @ push
            return
        X, h = self.X, self.dt
        a = self._rate(X, w)
        b = self._rate(X + h / 2 * a, w)
        c = self._rate(X + h / 2 * b, w)
        d = self._rate(X + h * c, w)
        self.X = X + h / 6 * (a + 2 * b + 2 * c + d)


def estimated_weight(arm: Bodies, q: Array, y: Array, signals: Signals) -> Array:
    """Return the weight's wrench (6,), platform axes, of the arm as described.

    Args:
        arm: as described.
        q: (n,) measured angles; y: (6,) measured pose.
        signals: what is wrong with the estimate.
    """
    pose = y.copy()
    pose[3:] = pose[3:] + signals.tilt
    z = np.concatenate([pose, q])
    w = np.linalg.solve(twist_matrix(pose).T, arm.weight(z)[:6])
    w = w * signals.weight_scale
    w[:3] += rotation(pose[3:]).T @ np.array([0.0, 0.0, -9.81 * signals.weight_mass])
    return np.asarray(w)


def _between(poses: list[tuple[Array, Array]], at: float) -> tuple[Array, Array]:
    """Angles and pose at a past instant, `at` in periods, by a line between two."""
    k = max(int(np.floor(at)), 0)
    share = max(at - k, 0.0)
    if share == 0.0:
        return poses[k]
    (q, y), (q1, y1) = poses[k], poses[k + 1]
    return q + share * (q1 - q), y + share * (y1 - y)


class Laboratory:
    """The joints on a platform whose motion is given."""

    def __init__(self, machine: Table, joints: Joints) -> None:
        arm = machine["arm"]
        self.arm = Bodies(arm["base"], joints.links_without_rotors(arm))
        self.joints, self.n = joints, self.arm.n
        self.balanced = bool(machine["emulator"]["joint_balance"])
        self.last = np.zeros(6)

    def rate(
        self, t: float, c: Array, x: Array, platform: Array, seen: tuple[Array, Array] | None,
        wrench: bool = False,
    ) -> Array:  # fmt: skip
        """Return x' of x = (q, v, memory) while the platform moves as (3, 6) says."""
        n = self.n
        q, v, s = x[:n], x[n : 2 * n], x[2 * n :]
        z = np.concatenate([platform[0], q])
        M, h = self.arm.terms(z, np.concatenate([platform[1], v]))
        torque, ds = self.joints.torque(t, c, q, v, s, seen)
        pull = self.arm.weight(z) if wrench or not self.balanced else None
        force = torque - h[6:] - M[6:, :6] @ platform[2]
        if not self.balanced and pull is not None:
            force = force + pull[6:]
        a = np.linalg.solve(M[6:, 6:], force)
        if wrench and pull is not None:
            left = M[:6, :6] @ platform[2] + M[:6, 6:] @ a + h[:6] - pull[:6]
            self.last = -np.linalg.solve(twist_matrix(platform[0]).T, left)
        return np.concatenate([v, a, ds])


def simulate(
    description: Table,
    machine: Table,
    servo: Servo,
    motion: Motion,
    hidden: Hidden,
    *,
    duration: float,
    applied: Servo | None = None,
    reading_noise: Array | None = None,
    vehicle_force: Callable[[Array, Array], Array] | None = None,
    led: Run | None = None,
) -> Run:
    """Play a motion on the emulated machine; one row of the log per control period.

    Args:
        description, machine, servo, motion, hidden, applied: see `space.simulate`.
        duration: of the log [s].
        reading_noise: (periods, 6) noise of the force sensor's readings.
        vehicle_force: further force (6,) on the emulated vehicle at pose and rate.
        led: the platform is sent the commands of this run, whatever the sensor reads.
    """
    dt, emulator = float(description["control_dt"]), machine["emulator"]
    # legs shake the platform within a step of the description; a pose servo does not
    finer = 2 if emulator["platform"]["kind"] == "legs" else 1
    h = float(description["physics_dt"]) / finer
    per = round(dt / h)
    if emulator["payload_compensation"] or emulator["operation"] != "microgravity":
        raise ValueError("emulator: expected microgravity without payload compensation")
    periods = round(duration / dt)
    signals = hidden.signals
    t = np.asarray(h * np.arange(periods * per + 1), float)
    c = command(
        description, applied or servo, motion, t, signals.command_delay,
        not emulator["joint_balance"],
    )  # fmt: skip
    q = motion(np.zeros(1))[0][0]
    joints = Joints(machine["arm"], applied or servo, hidden, q)
    lab, known = Laboratory(machine, joints), arm_bodies(description["arm"])
    n = lab.n
    x = np.concatenate([q, np.zeros(n), joints.start])
    platform = read_platform(emulator, h, per, signals.bandwidth, signals.damping)
    platform.start(np.zeros(6))
    path = np.zeros((1, 3, 6))
    lab.rate(0.0, c[0], x, path[-1], None, True)
    sensor = Sensor(emulator["sensor"], h / 2, signals)
    sensor.start(lab.last)
    vehicle = Vehicle(machine["vehicle"], dt, vehicle_force)
    queue = [(np.zeros(6), np.zeros(6))] * int(emulator["delay"])
    sent: list[Array] = []
    history: list[Array] = []
    poses: list[tuple[Array, Array]] = []
    rows: list[tuple[Array, ...]] = []

    def seen(at: float, x: Array) -> tuple[Array, Array] | None:
        if signals.reading_delay == 0.0:
            return None
        now = at, np.concatenate(joints.read(x[:n], x[n : 2 * n], x[2 * n :]))
        return late(history, at - signals.reading_delay / h, (slice(0, n), slice(n, None)), now)

    command_now = (np.zeros(6), np.zeros(6))
    for k in range(periods + 1):
        now = k * per
        if signals.reading_delay and not history:
            history.append(np.concatenate(joints.read(x[:n], x[n : 2 * n], x[2 * n :])))
        measured = platform.measured()
        angles = seen(now, x) or joints.read(x[:n], x[n : 2 * n], x[2 * n :])
        poses.append((angles[0], measured))
        known_pose = _between(poses, k - signals.weight_delay / dt)
        w = sensor.read()
        if reading_noise is not None:
            w = w + reading_noise[k]
        wg = w - estimated_weight(known, *known_pose, signals)
        rows.append(
            (
                *angles,
                joints.asked(c[now], angles),
                path[-1][0],
                command_now[0],
                w,
                wg,
                path[-1][1],
                command_now[1],
            )
        )
        if k == periods:
            break
        if led is None or led.y_cmd is None or led.yd_cmd is None:
            vehicle.advance(wg)
            queue.append((vehicle.pose.copy(), vehicle.speed.copy()))
            command_now = queue.pop(0)
        else:
            command_now = led.y_cmd[k + 1], led.yd_cmd[k + 1]
        sent.append(np.concatenate(command_now))
        received = command_now
        if signals.platform_delay:
            both = late(sent, k - signals.platform_delay / dt, (slice(0, 6), slice(6, None)))
            received = both if k * dt >= signals.platform_delay else (np.zeros(6), np.zeros(6))
        path = platform.follow(*received)
        lab.rate(t[now], c[now], x, path[0], seen(now, x), True)
        sensor.jump(lab.last)  # a new command changes the platform's acceleration at once
        for i in range(per):
            a, b, m = now + i, now + i + 1, (c[now + i] + c[now + i + 1]) / 2
            middle = path[2 * i + 1]
            k1 = lab.rate(t[a], c[a], x, path[2 * i], seen(a, x))
            x2 = x + h / 2 * k1
            k2 = lab.rate(t[a] + h / 2, m, x2, middle, seen(a + 0.5, x2))
            x3 = x + h / 2 * k2
            k3 = lab.rate(t[a] + h / 2, m, x3, middle, seen(a + 0.5, x3))
            lab.rate(t[a] + h / 2, m, x3, middle, seen(a + 0.5, x3), True)
            sensor.advance(lab.last)
            x4 = x + h * k3
            k4 = lab.rate(t[b], c[b], x4, path[2 * i + 2], seen(b, x4))
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if signals.reading_delay:
                history.append(np.concatenate(joints.read(x[:n], x[n : 2 * n], x[2 * n :])))
            lab.rate(t[b], c[b], x, path[2 * i + 2], seen(b, x), True)
            sensor.advance(lab.last)
        if not np.isfinite(x).all() or np.abs(vehicle.pose).max() > 1.5:
            raise FloatingPointError(f"the emulation diverged at {t[now]:.3f} s")
    q_, v_, tau, y, y_cmd, w_, wg_, yd, yd_cmd = (
        np.array([row[i] for row in rows]) for i in range(9)
    )
    told = motion(t[::per])
    return Run(
        t[::per],
        told[0],
        told[1],
        q_,
        v_,
        tau,
        y,
        w_,
        y_cmd=y_cmd,
        wg=wg_,
        yd=yd,
        yd_cmd=yd_cmd,
    )
