"""Platforms of the laboratory: how the platform top follows the computer's poses.

Each gives, over one control period, pose, rate and acceleration at the ends and the middle of
every physics step.
"""

from collections import deque
from typing import Any, Protocol

import numpy as np
import scipy.linalg as sla
import scipy.signal as sig

from benchmarks.trial.arm import Array, Table


def rotations(angles: Array) -> Array:
    """R = Rz Ry Rx (..., 3, 3) of angles (..., 3) about x, y, z [rad]."""
    cx, cy, cz = np.moveaxis(np.cos(angles), -1, 0)
    sx, sy, sz = np.moveaxis(np.sin(angles), -1, 0)
    rows = (
        (cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx),
        (sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx),
        (-sy, cy * sx, cy * cx),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


class Platform(Protocol):
    """What the laboratory's loop asks of a platform."""

    def start(self, y: Array) -> None:
        """Stand at rest at a pose (6,)."""

    def follow(self, y: Array, yd: Array) -> Array:
        """Follow a command for a period: (2 steps + 1, 3, 6) of Y, Y', Y'' each half step."""

    def measured(self) -> Array:
        """Return the pose (6,) that the transducers report."""


class PoseServo:
    """A second-order servo on each coordinate; the command moves on at its own rate."""

    def __init__(
        self, table: Table, h: float, steps: int, bandwidth: float, damping: float
    ) -> None:
        w = 2 * np.pi * table["bandwidth"] * bandwidth
        zeta = table["damping_ratio"] * damping
        A = np.array([[0.0, 1.0], [-w * w, -2 * zeta * w]])
        self.ahead = bool(table["rate_feedforward"])
        self.times = h / 2 * np.arange(2 * steps + 1)
        self.move = np.array([sla.expm(A * t) for t in self.times])
        self.pull = A[1]
        self.y, self.yd = np.zeros(6), np.zeros(6)

    def start(self, y: Array) -> None:
        """Stand at rest at a pose."""
        self.y, self.yd = y.copy(), np.zeros(6)

    def follow(self, y: Array, yd: Array) -> Array:
        """Follow the command for a period."""
        rate = yd if self.ahead else np.zeros(6)
        e = np.einsum("tij,ja->tia", self.move, np.array([self.y - y, self.yd - rate]))
        out = np.empty((len(self.times), 3, 6))
        out[:, 0] = y + self.times[:, None] * rate + e[:, 0]
        out[:, 1] = rate + e[:, 1]
        out[:, 2] = np.einsum("i,tia->ta", self.pull, e)
        self.y, self.yd = out[-1, 0].copy(), out[-1, 1].copy()
        return out

    def measured(self) -> Array:
        """The pose as it is."""
        return self.y


class SixLegs:
    """Six legs with servo, valve, transducer and a transverse mode that the transducer sees."""

    def __init__(
        self,
        table: Table,
        stewart: Table,
        h: float,
        steps: int,
        bandwidth: float,
        damping: float,
    ) -> None:
        self.base, self.top = np.array(stewart["base"]), np.array(stewart["top"])
        self.home = np.array([0.0, 0.0, stewart["home_height"]])
        self.short = stewart["length_min"]
        self.stroke = stewart["length_max"] - self.short
        self.t = table
        self.gain = bandwidth  # both gains; `damping` acts on the change of length alone
        self.brake = damping
        self.period = 1 / table["rate"]
        self.samples = round(2 * steps * h / 2 * table["rate"])
        self.h, self.per = h, round(self.period / h)
        self.wait = round(table["delay"] * table["rate"])
        filt = table.get("filter")
        self.place = filt["place"] if filt else None
        self.b, self.a = np.array([1.0]), np.array([1.0])
        if filt:
            self.b, self.a = sig.cheby2(
                filt["order"], filt["stop_db"], filt["corner"], fs=table["rate"]
            )
        self.steps = steps
        self.start(np.zeros(6))

    def lengths(self, y: Array) -> Array:
        """Leg lengths (..., 6) at poses (..., 6)."""
        ends = self.home + y[..., None, :3] + self._arms(y)
        return np.asarray(np.linalg.norm(ends - self.base, axis=-1))

    def _arms(self, y: Array) -> Array:
        """Upper ends of the legs (..., 6, 3) from the platform's origin."""
        return np.asarray(self.top @ np.swapaxes(rotations(y[..., 3:]), -1, -2))

    def jacobian(self, y: Array) -> Array:
        """Derivatives (..., 6, 6) of the lengths by the pose."""
        arms = self._arms(y)
        legs = self.home + y[..., None, :3] + arms - self.base
        unit = legs / np.linalg.norm(legs, axis=-1)[..., None]
        cy, cz, sy, sz = (f(y[..., k]) for f in (np.cos, np.sin) for k in (4, 5))
        none = np.zeros_like(cy)
        rows = ((cz * cy, -sz, none), (sz * cy, cz, none), (-sy, none, none + 1))
        spin = np.stack([np.stack(row, -1) for row in rows], -2)
        return np.concatenate([unit, np.cross(arms, unit) @ spin], axis=-1)

    def pose(self, lengths: Array, guess: Array) -> Array:
        """Poses (..., 6) of given lengths (..., 6), by Newton's method."""
        y = np.broadcast_to(guess, lengths.shape).copy()
        for _ in range(20):
            miss = self.lengths(y) - lengths
            y = y - np.linalg.solve(self.jacobian(y), miss[..., None])[..., 0]
            if np.abs(miss).max() < 1e-13:
                break
        return y

    def start(self, y: Array) -> None:
        """Stand at rest at a pose."""
        self.y = y.copy()
        rod = self.lengths(y)
        # per leg: rod's length, its speed, the valve's first lag; mode's displacement and rate
        self.x = np.zeros((5, 6))
        self.x[0] = rod
        self.before = rod.copy()
        order = len(self.b) - 1
        level = rod if self.place == "feedback" else 0 * rod
        self.memory = (
            np.array([sig.lfilter_zi(self.b, self.a) * v for v in level]).T
            if order
            else np.zeros((0, 6))
        )
        self.queue: deque[Array] = deque([np.zeros(6)] * self.wait)
        self.u = np.zeros(6)

    def _filtered(self, value: Array) -> Array:
        """The digital filter, transposed direct form."""
        if not len(self.memory):
            return value
        out = self.b[0] * value + self.memory[0]
        new = np.vstack([self.memory[1:], np.zeros(6)])
        self.memory = new + np.outer(self.b[1:], value) - np.outer(self.a[1:], out)
        return out

    def _transducers(self) -> Array:
        """Measured lengths (6,)."""
        l = self.x[0] + self.x[3]
        step = self.t["resolution"]
        return np.round(l / step) * step if step else l

    def _control(self, wanted: Array) -> None:
        """One sample of the legs' controllers."""
        l = self._transducers()
        if self.place == "feedback":
            l = self._filtered(l)
        e = wanted - l
        if self.place == "error":
            e = self._filtered(e)
        K1, K2 = self.t["K1"], self.t["K2"] * self.brake
        self.queue.append(self.gain * self.t["scale"] * (K1 * e - K2 * (l - self.before)))
        self.before = l
        self.u = self.queue.popleft()

    def _transition(self) -> Array:
        """Matrices (6, 6, 6) of all legs over half a physics step, valve input last."""
        extension = (self.x[0] - self.short) / self.stroke
        w = (
            2
            * np.pi
            * (self.t["mode_short"] + extension * (self.t["mode_long"] - self.t["mode_short"]))
        )
        A = np.zeros((6, 6, 6))
        lag = 2 / self.t["valve_lag"]  # pilot stage and spool share it
        A[:, 0, 1] = 1.0
        A[:, 1, 1], A[:, 1, 2] = -lag, lag
        A[:, 2, 2], A[:, 2, 5] = -lag, lag
        A[:, 3, 4] = 1.0
        A[:, 4, 3], A[:, 4, 4] = -(w**2), -2 * self.t["mode_damping"] * w
        A[:, 4, 1], A[:, 4, 2] = self.t["participation"] * lag, -self.t["participation"] * lag
        return np.array(sla.expm(A * self.h / 2))

    def _motion(self, x: Array) -> Array:
        """Y, Y', Y'' (k, 3, 6) of the platform top while the legs are at x (k, 5, 6)."""
        lag = 2 / self.t["valve_lag"]  # pilot stage and spool share it
        speed, acceleration = x[:, 1], lag * (x[:, 2] - x[:, 1])
        y = self.pose(x[:, 0], self.y)
        J = self.jacobian(y)
        yd = np.linalg.solve(J, speed[..., None])[..., 0]
        small = 1e-6 / np.maximum(1.0, np.abs(yd).max(axis=-1))[:, None]
        Jd = (self.jacobian(y + small * yd) - self.jacobian(y - small * yd)) / (
            2 * small[..., None]
        )
        turned = acceleration[..., None] - Jd @ yd[..., None]
        self.y = y[-1]
        return np.stack([y, yd, np.linalg.solve(J, turned)[..., 0]], axis=1)

    def follow(self, y: Array, yd: Array) -> Array:
        """Follow lengths for a period; the legs know nothing of the commanded rate."""
        wanted = self.lengths(y)
        path = []
        for k in range(2 * self.steps):
            if k % (2 * self.per) == 0:
                self._control(wanted)
                move = self._transition()
            path.append(self.x)
            full = np.vstack([self.x, self.u])
            self.x = np.einsum("lij,jl->il", move, full)[:5]
        return self._motion(np.array([*path, self.x]))

    def measured(self) -> Array:
        """Forward kinematics of the measured lengths."""
        return self.pose(self._transducers(), self.y)


def read_platform(
    emulator: dict[str, Any], h: float, steps: int, bandwidth: float, damping: float
) -> Platform:
    """Return the platform that a description's `[emulator]` means."""
    table = emulator["platform"]
    if table["kind"] == "pose":
        return PoseServo(table, h, steps, bandwidth, damping)
    return SixLegs(table, emulator["stewart"], h, steps, bandwidth, damping)
