"""Acceleration, displacement, tool error and filtered motion of the linear base.

The base of `prediction` under its load u(t), with a filter's states l beside it:

    s = (x, v, l),   x' = v,   M v' = -u' - (D + M') v - K x,   l_j' = w_j (z - l_j).

Everything here is affine in the samples of u, so the same text gives the motion under one u
and, with a column per sample, the matrices of quadratic forms in u.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array
from ves_gym.mechanics.modes import root
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import skew
from ves_gym.planners.case import Query
from ves_gym.planners.prediction import (
    FINE,
    NODES,
    BaseState,
    LinearBase,
    gramian,
    inertia_along,
)
from ves_gym.system.disturbance import Disturbance, mount_of
from ves_gym.system.energy import TAIL
from ves_gym.system.frequency_weight import FrequencyWeight

# Measures of a disturbance, and the quantities whose means, ends and peaks they are.
MEANS = {
    "acceleration": "acceleration",
    "angular": "angular",
    "tip": "tip",
    "E_weighted": "filtered",
}
ENDS = {"tip_end": "tip", "attitude_end": "rotation"}
PEAKS = {
    "acceleration_peak": "acceleration",
    "angular_peak": "angular",
    "tip_peak": "tip",
    "displacement_peak": "displacement",
    "rotation_peak": "rotation",
}


class Quantity(NamedTuple):
    """A vector of r entries that is affine in the columns of a response."""

    nodes: Array  # (N, r, C) while the joints move
    after: Array  # (r, S) per state afterwards


class LinearResponse:
    """Motion of the linear base at even nodes, per column of its input.

    Args:
        linear: the base under the arm.
        at: (n,) configuration whose inertia holds [rad], or a motion: that along it.
        path: of the joints, for the place of the tool.
        t: (N,) nodes, even [s]; the joints are at rest afterwards.
        u: (N, k, C) load of the motion (`LinearBase.load`), linear between nodes.
        weight: filter of the quantity `filtered`.
        base: its motion at the start, in the last column; None: at rest.
        parts: steps between nodes that share one inertia.
    """

    def __init__(
        self,
        linear: LinearBase,
        at: npt.ArrayLike | Motion,
        path: Motion,
        t: Array,
        u: Array,
        weight: FrequencyWeight,
        *,
        base: BaseState | None = None,
        parts: int = 1,
    ) -> None:
        self.linear, self.path, self.t, self.u, self.weight = linear, path, t, u, weight
        self.M, middle = inertia_along(linear, at, t)
        self.change = slope(self.M, t[1]) if len(self.M) > 1 else np.zeros_like(self.M)
        size, b = linear.size, linear.b
        self.s = np.zeros((len(t), 2 * size + b * len(weight.rates), u.shape[-1]))
        if base is not None:
            z, zd = linear.coordinates(base)
            self.s[0, :b, -1], self.s[0, size : size + b, -1] = z, zd
            for k in range(len(weight.rates)):  # the filter begins on the base's position
                self.s[0, self._low(k), -1] = z
        change = self.change
        if len(middle) > 1:
            middle = middle[(parts - 1) // 2 :: parts]
            change = (change[:-1] + change[1:])[(parts - 1) // 2 :: parts] / 2
        Phi, push = self._steps(middle, change)
        for k, du in enumerate(np.diff(u, axis=0)):
            i = k // parts if len(Phi) > 1 else 0
            self.s[k + 1] = Phi[i] @ self.s[k] + push[i] @ du

    def _steps(self, M: Array, change: Array) -> tuple[Array, Array]:
        """Exact steps (k, S, S) under constant M and u', and their push per change of u."""
        A, size = self._plant(M, change), self.linear.size
        n, dt, driven = A.shape[-1], self.t[1], self.linear.driven
        block = np.zeros((len(M), n + len(driven), n + len(driven)))
        block[:, :n, :n] = A * dt
        block[:, size : 2 * size, n:] = -np.linalg.inv(M)[:, :, driven]
        E = scipy.linalg.expm(block)
        return E[:, :n, :n], E[:, :n, n:]

    def _low(self, k: int) -> slice:
        """Rows of the state that hold the k-th low-pass of the base's coordinates."""
        begin = 2 * self.linear.size + k * self.linear.b
        return slice(begin, begin + self.linear.b)

    def _plant(self, M: Array, change: Array) -> Array:
        """A of s' = A s while u is constant (k, S, S).

        Args:
            M: (k, size, size) inertia. change: its rate.
        """
        size, b = self.linear.size, self.linear.b
        A = np.zeros((len(M), self.s.shape[1], self.s.shape[1]))
        A[:, :size, size : 2 * size] = np.eye(size)
        A[:, size : 2 * size, : 2 * size] = self._forced(M, change)
        for k, w in enumerate(self.weight.rates):
            low = self._low(k)
            A[:, low, :b], A[:, low, low] = w * np.eye(b), -w * np.eye(b)
        return A

    def _forced(self, M: Array, change: Array) -> Array:
        """v' per (x, v) while u is constant (k, size, 2 size)."""
        K = np.broadcast_to(self.linear.K, M.shape)
        return -np.linalg.solve(M, np.concatenate([K, self.linear.D + change], axis=-1))

    # ------------------------------------------------------------------- quantities

    def quantity(self, name: str) -> Quantity:
        """Vectors of three; `filtered`: of which the square is an energy.

        Args:
            name: acceleration, angular, tip, displacement, rotation or filtered.
        """
        if name == "tip":
            return self._tip()
        if name == "filtered":
            return self._filtered()
        size = self.linear.size
        rows = np.eye(3, size, 3 if name in ("angular", "rotation") else 0)
        if name in ("acceleration", "displacement"):
            rows[:, 3:6] = -skew(mount_of(self.linear.system.arm))
        if name in ("displacement", "rotation"):
            return Quantity(rows @ self.s[:, :size], self._widened(rows))
        constant = self._forced(self.M[-1:], np.zeros_like(self.M[-1:]))[0]
        return Quantity(rows @ self._acceleration, self._widened(rows @ constant))

    def _widened(self, rows: Array) -> Array:
        """Rows for x, or (x, v), as rows for the whole state."""
        return np.hstack([rows, np.zeros((len(rows), self.s.shape[1] - rows.shape[1]))])

    @cached_property
    def _acceleration(self) -> Array:
        """v' at the nodes (N, size, C), from the equation of motion."""
        out = self._forced(self.M, self.change) @ self.s[:, : 2 * self.linear.size]
        out -= np.linalg.inv(self.M)[:, :, self.linear.driven] @ slope(self.u, self.t[1])
        return np.asarray(out, np.float64)

    def _tip(self) -> Quantity:
        """Way of the tool: the base's, its turn about the tool's place, the joints' way."""
        linear = self.linear
        rows = linear.tool(self.path.at(self.t).q)
        return Quantity(rows @ self.s[:, : linear.size], self._widened(rows[-1]))

    def _filtered(self) -> Quantity:
        """Roots of strain and kinetic energy of the filtered coordinates of the base."""
        b, size, weight = self.linear.b, self.linear.size, self.weight
        rows = np.zeros((2 * b, self.s.shape[1]))  # filtered z and z' per state
        rows[:b, :b] = rows[b:, size : size + b] = weight.gains[-1] * np.eye(b)
        for k, (w, step) in enumerate(zip(weight.rates, weight.steps, strict=True)):
            low = self._low(k)
            rows[:b, low] = step * np.eye(b)
            rows[b:, :b] += step * w * np.eye(b)
            rows[b:, low] = -step * w * np.eye(b)
        roots = np.zeros((len(self.M), 2 * b, 2 * b))
        roots[:, :b, :b] = root(self.linear.base_stiffness / 2)
        roots[:, b:, b:] = [root(self.linear.base_mass(M) / 2) for M in self.M]
        return Quantity(roots @ (rows @ self.s), roots[-1] @ rows)

    # --------------------------------------------------------------------- measures

    def mean_square(self, name: str) -> tuple[Array, Array]:
        """Rows R and G with the mean square |R c|^2 + c^T G c of the columns' sum by c (C,).

        Over the motion and the tail, as `E_mean` is; G is for the tail, (C, C).
        """
        quantity = self.quantity(name)
        span = float(self.t[-1]) + TAIL
        share = np.full(len(self.t), self.t[1] / span)
        share[[0, -1]] /= 2
        rows = (np.sqrt(share)[:, None, None] * quantity.nodes).reshape(-1, self.u.shape[-1])
        S = gramian(self._tail_dynamics, quantity.after.T @ quantity.after, TAIL) / span
        return rows, self.s[-1].T @ S @ self.s[-1]

    @cached_property
    def _tail_dynamics(self) -> Array:
        """A while the joints are held, after the motion (S, S)."""
        last = self.M[-1:]
        return np.asarray(self._plant(last, np.zeros_like(last))[0])

    def samples(self, name: str, step: float, span: float) -> Array:
        """A quantity at the nodes and at even times after them (K, r, C), over a span [s]."""
        quantity = self.quantity(name)
        Phi = scipy.linalg.expm(self._tail_dynamics * step)
        states = [self.s[-1]]
        for _ in range(int(span / step)):
            states.append(Phi @ states[-1])
        return np.concatenate([quantity.nodes, quantity.after @ np.stack(states[1:])])


def slope(values: Array, step: float) -> Array:
    """Time derivative of even samples (N, ...), of fourth order."""
    out = np.empty_like(values)
    out[2:-2] = (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / 12
    ends = np.array([[-25.0, 48, -36, 16, -3], [-3, -10, 18, -6, 1]]) / 12
    out[:2] = np.tensordot(ends, values[:5], 1)
    out[-2:] = -np.tensordot(ends, values[:-6:-1], 1)[::-1]
    return out / step


_AFTER = 3.0  # s after the motion in which peaks are looked for: a swing of 0.2 Hz


def predict_disturbance(query: Query, motion: Motion) -> Disturbance:
    """Predict the disturbance measures of an answer to a query.

    Small angles; the inertia follows the arm, joints give way on their servo.
    """
    linear = LinearBase(query.system, query.servo, motion.start)
    t = np.linspace(0.0, motion.duration, NODES * FINE + 1)
    u = linear.load(motion, t)
    response = LinearResponse(
        linear, motion, motion, t, u[..., None], query.weight, base=query.base, parts=FINE
    )

    out: dict[str, float] = {}
    for measure, name in MEANS.items():
        rows, tail = response.mean_square(name)
        square = float(np.sum(rows**2) + tail[0, 0])
        out[measure] = square if measure == "E_weighted" else square**0.5
    for measure, name in ENDS.items():
        out[measure] = float(np.linalg.norm(response.quantity(name).nodes[-1]))
    for measure, name in PEAKS.items():
        samples = response.samples(name, float(t[1]), _AFTER)[..., 0]
        out[measure] = float(np.linalg.norm(samples, axis=-1).max())
    return Disturbance(**out)
