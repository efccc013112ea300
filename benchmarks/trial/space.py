"""Mode ideal: arm and base in space, coupled, integrated by Runge-Kutta 4.

Coordinates z = (Y, eta, q). The arm's wrench on the base is what its equations leave over.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.trial.arm import Array, Bodies, Table, twist_matrix
from benchmarks.trial.hidden import Hidden
from benchmarks.trial.joints import Joints
from benchmarks.trial.servo import Motion, Servo, command
from benchmarks.trial.structure import base_body, read_base


@dataclass
class Run:
    """Signals without noise at the times of the log; optional ones are none."""

    t: Array
    q_cmd: Array
    v_cmd: Array
    q: Array
    v: Array
    tau: Array
    y: Array
    w: Array
    y_cmd: Array | None = None
    wg: Array | None = None
    yd: Array | None = None
    yd_cmd: Array | None = None  # not logged


class Space:
    """Equations of motion of a machine in space."""

    def __init__(self, machine: Table, extra_modes: int, joints: Joints) -> None:
        arm = machine["arm"]
        self.base = read_base(machine["vehicle"], extra_modes)
        self.arm = Bodies(arm["base"], joints.links_without_rotors(arm))
        self.body = base_body(self.base)
        self.joints, self.n, self.m = joints, self.arm.n, self.base.inner
        self.f = 6 + self.m  # coordinates of the base
        self.at = np.concatenate([np.arange(6), self.f + np.arange(self.n)])
        self._mixed = np.ix_(self.at, self.at)
        self.size = self.f + self.n
        self._M = np.zeros((self.size, self.size))
        self._M[: self.f, : self.f] = self.base.M
        self.last = (np.zeros((0, 0)), np.zeros(0), np.zeros(0))

    def rate(self, t: float, c: Array, x: Array, seen: tuple[Array, Array] | None) -> Array:
        """Return x' of x = (z, z', memory), under the command c (n,)."""
        N, f = self.size, self.f
        z, zd, s = x[:N], x[N : 2 * N], x[2 * N :]
        H, h = self.arm.terms(z[self.at], zd[self.at])
        torque, ds = self.joints.torque(t, c, z[f:], zd[f:], s, seen)
        M = self._M.copy()
        M[self._mixed] += H
        force = np.empty(N)
        force[:f] = -self.base.D @ zd[:f] - self.base.K @ z[:f]
        force[f:] = torque
        force[self.at] -= h
        if self.body is not None:
            Hb, hb = self.body.terms(z[:6], zd[:6])
            M[:6, :6] += Hb
            force[:6] -= hb
        for law, part in zip(self.joints.hidden.laws, self.joints.parts, strict=True):
            extra = law.base(t, z[:6], zd[:6], s[part], ds[part])
            if extra is not None:
                force[:6] += extra
        zdd = np.linalg.solve(M, force)
        self.last = (H, h, zdd[self.at])
        return np.concatenate([zd, zdd, ds])

    def wrench(self, y: Array) -> Array:
        """Return the arm's wrench (6,) on the base at the last rates asked for."""
        H, h, zdd = self.last
        return np.asarray(-np.linalg.solve(twist_matrix(y).T, H[:6] @ zdd + h[:6]))


def late(
    history: list[Array],
    at: float,
    parts: tuple[slice, slice],
    now: tuple[float, Array] | None = None,
) -> tuple[Array, Array]:
    """Return angles and rates at a past instant, by lines between knots.

    Args:
        history: what was read at steps 0, 1, ...
        at: the instant, in steps.
        parts: angles and rates of it.
        now: a later instant in steps, within the step being taken, and what is read there.
    """
    k = min(max(int(np.floor(at)), 0), len(history) - 1)
    a, b, width = history[k], history[min(k + 1, len(history) - 1)], 1.0
    if now is not None and k + 1 == len(history) and now[0] > k:
        b, width = now[1], now[0] - k
    x = a + min(max(at - k, 0.0) / width, 1.0) * (b - a)
    return x[parts[0]], x[parts[1]]


def simulate(
    description: Table,
    machine: Table,
    servo: Servo,
    motion: Motion,
    hidden: Hidden,
    *,
    duration: float,
    record_dt: float,
    extra_modes: int = 0,
    applied: Servo | None = None,
) -> Run:
    """Play a motion on a machine in space.

    Args:
        description: the machine as described; the feed-forward knows nothing else.
        machine: the machine as it is, in the same form.
        servo: as described; motion: of the joints; hidden: laws and signals.
        duration: of the log [s]; record_dt: between its samples [s], whole physics steps.
        extra_modes: inner modes of the base beyond the described.
        applied: the servo as it is, where it differs.
    """
    h = float(description["physics_dt"])
    every = round(record_dt / h)
    steps = round(duration / h)
    t = np.asarray(h * np.arange(steps + 1), float)
    c = command(description, applied or servo, motion, t, hidden.signals.command_delay, False)
    q0 = motion(np.zeros(1))[0][0]
    joints = Joints(machine["arm"], applied or servo, hidden, q0)
    space = Space(machine, extra_modes, joints)
    N, f = space.size, space.f
    x = np.zeros(2 * N + len(joints.start))
    x[f:N], x[2 * N :] = q0, joints.start
    delay = hidden.signals.reading_delay / h
    history: list[Array] = []
    rows: list[tuple[Array, ...]] = []

    def seen(at: float, x: Array) -> tuple[Array, Array] | None:
        if delay == 0.0:
            return None
        now = at, np.concatenate(joints.read(x[f:N], x[N + f : 2 * N], x[2 * N :]))
        return late(history, at - delay, (slice(0, space.n), slice(space.n, None)), now)

    for k in range(steps + 1):
        if delay:
            history.append(np.concatenate(joints.read(x[f:N], x[N + f : 2 * N], x[2 * N :])))
        k1 = space.rate(t[k], c[k], x, seen(k, x))
        if k % every == 0:
            reading = seen(k, x) or joints.read(x[f:N], x[N + f : 2 * N], x[2 * N :])
            tau = joints.asked(c[k], reading)
            rows.append((*reading, tau, x[:6], space.wrench(x[:6]), x[N : N + 6]))
        if k == steps:
            break
        middle = (c[k] + c[k + 1]) / 2
        x2 = x + h / 2 * k1
        k2 = space.rate(t[k] + h / 2, middle, x2, seen(k + 0.5, x2))
        x3 = x + h / 2 * k2
        k3 = space.rate(t[k] + h / 2, middle, x3, seen(k + 0.5, x3))
        x4 = x + h * k3
        k4 = space.rate(t[k + 1], c[k + 1], x4, seen(k + 1, x4))
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if not np.isfinite(x).all():
            raise FloatingPointError(f"the run diverged at {t[k]:.3f} s")
    q, v, tau, y, w, yd = (np.array([row[i] for row in rows]) for i in range(6))
    told = motion(t[::every])
    return Run(t[::every], told[0], told[1], q, v, tau, y, w, yd=yd)
