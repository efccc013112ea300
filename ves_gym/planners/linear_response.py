"""Acceleration, displacement, tool error and filtered motion of the linear base.

The base of `prediction` under its load u(t), with a filter's states l beside it:

    s = (x, v, l),   x' = v,   M v' = -u' - (D + M') v - K x,   l_j' = w_j (z - l_j).

Everything here is linear in the samples of u, so the same text gives the motion under one u
and, with a column per unknown, its derivative. A measure is the largest norm of its `rows`.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
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

# Measures of a disturbance, and the quantities whose means, ends and peaks they are; the mean
# of `filtered` is a root here, and an energy in `Disturbance`.
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
QUANTITIES = MEANS | ENDS | PEAKS
UNFILTERED = FrequencyWeight(corners=(), gains=(1.0,))
NEVER = np.zeros(0)


class Quantity(NamedTuple):
    """A vector of r entries, linear in the state and in the rate of the load."""

    state: Array  # (N or 1, r, S) while the joints move
    rate: Array | None  # (N, r, k) per rate of the load
    after: Array  # (r, S) per state afterwards


class Course(NamedTuple):
    """The base's motion under C columns of load."""

    s: Array  # (N, S, C) states at the nodes
    rate: Array  # (N, k, C) of the load
    later: Array  # (J, S, C) states after the motion


class LinearResponse:
    """Motion of the linear base under an arm that moves along a path or near it.

    Args:
        linear: the base under the arm.
        path: of the joints, for the inertia and the place of the tool.
        t: (N,) nodes [s]; the joints are at rest afterwards.
        weight: filter of the quantity `filtered`.
        after: (J,) times after the motion at which peaks are looked for, ascending [s].
        parts: even steps between nodes that share one inertia.
    """

    def __init__(
        self,
        linear: LinearBase,
        path: Motion,
        t: Array,
        weight: FrequencyWeight = UNFILTERED,
        after: Array = NEVER,
        parts: int = 1,
    ) -> None:
        self.linear, self.path, self.t, self.weight = linear, path, t, weight
        self.M, middle = inertia_along(linear, path, t)
        self.change = slope(self.M, t)
        self.inverse = np.linalg.inv(self.M)[:, :, linear.driven]
        self.size = 2 * linear.size + linear.b * len(weight.rates)
        self._parts, first = parts, (parts - 1) // 2
        change = (self.change[:-1] + self.change[1:])[first::parts] / 2
        self._steps = self._exact(middle[first::parts], change, np.diff(t)[first::parts])
        self._after = np.diff(after, prepend=0.0).round(12)
        self._quantities: dict[str, Quantity] = {}
        self._tails: dict[str, Array] = {}

    def course(self, u: Array, base: BaseState | None = None) -> Course:
        """Move the base.

        Args:
            u: (N, k, C) load of the motion (`LinearBase.load`), linear between nodes.
            base: its motion at the start, of the first column; None: at rest.
        """
        s = np.zeros((len(self.t), self.size, u.shape[-1]))
        if base is not None:
            b, (z, zd) = self.linear.b, self.linear.coordinates(base)
            s[0, :b, 0], s[0, self.linear.size : self.linear.size + b, 0] = z, zd
            for k in range(len(self.weight.rates)):  # the filter begins on the base's position
                s[0, self._low(k), 0] = z
        Phi, push = self._steps
        pushed = np.repeat(push, self._parts, axis=0) @ np.diff(u, axis=0)
        for k, added in enumerate(pushed):
            s[k + 1] = Phi[k // self._parts] @ s[k] + added
        exact = {h: scipy.linalg.expm(self._tail_dynamics * h) for h in set(self._after)}
        later = np.empty((len(self._after), *s.shape[1:]))
        last = s[-1]
        for k, h in enumerate(self._after):
            last = later[k] = exact[h] @ last
        return Course(s, slope(u, self.t), later)

    def _exact(self, M: Array, change: Array, dt: Array) -> tuple[Array, Array]:
        """Steps (k, S, S) under constant M and u', and their push per change of u."""
        n, size, driven = self.size, self.linear.size, self.linear.driven
        block = np.zeros((len(M), n + len(driven), n + len(driven)))
        block[:, :n, :n] = self._plant(M, change) * dt[:, None, None]
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
        A = np.zeros((len(M), self.size, self.size))
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
        """Vectors of three; `filtered`: of which the square is an energy; `base`: of six.

        Args:
            name: acceleration, angular, tip, displacement, rotation, filtered, or base for the
                acceleration of its pose.
        """
        if name not in self._quantities:
            make = {"tip": self._tip, "filtered": self._filtered}.get(name)
            self._quantities[name] = make() if make else self._of_the_mount(name)
        return self._quantities[name]

    def _of_the_mount(self, name: str) -> Quantity:
        size = self.linear.size
        first = 3 if name in ("angular", "rotation") else 0
        rows = np.eye(6 if name == "base" else 3, size, first)
        if name in ("acceleration", "displacement"):
            rows[:, 3:6] = -skew(mount_of(self.linear.system.arm))
        if name in ("displacement", "rotation"):
            wide = self._widened(rows)
            return Quantity(wide[None], None, wide)
        still = self._forced(self.M[-1:], np.zeros_like(self.M[-1:]))[0]
        moving = self._widened(rows @ self._forced(self.M, self.change))
        return Quantity(moving, -rows @ self.inverse, self._widened(rows @ still))

    def _widened(self, rows: Array) -> Array:
        """Rows for x, or (x, v), as rows for the whole state."""
        missing = self.size - rows.shape[-1]
        return np.concatenate([rows, np.zeros((*rows.shape[:-1], missing))], axis=-1)

    def _tip(self) -> Quantity:
        """Way of the tool: the base's, its turn about the tool's place, the joints' way."""
        wide = self._widened(self.linear.tool(self.path.at(self.t).q))
        return Quantity(wide, None, wide[-1])

    def _filtered(self) -> Quantity:
        """Roots of strain and kinetic energy of the filtered coordinates of the base."""
        b, size, weight = self.linear.b, self.linear.size, self.weight
        rows = np.zeros((2 * b, self.size))  # filtered z and z' per state
        rows[:b, :b] = rows[b:, size : size + b] = weight.gains[-1] * np.eye(b)
        for k, (w, step) in enumerate(zip(weight.rates, weight.steps, strict=True)):
            low = self._low(k)
            rows[:b, low] = step * np.eye(b)
            rows[b:, :b] += step * w * np.eye(b)
            rows[b:, low] = -step * w * np.eye(b)
        roots = np.zeros((len(self.M), 2 * b, 2 * b))
        roots[:, :b, :b] = root(self.linear.base_stiffness / 2)
        roots[:, b:, b:] = root(self.linear.base_mass(self.M) / 2)
        return Quantity(roots @ rows, None, roots[-1] @ rows)

    # --------------------------------------------------------------------- measures

    def along(self, name: str, course: Course) -> Array:
        """A quantity's vectors (N, r, C) at the nodes."""
        quantity = self.quantity(name)
        out = quantity.state @ course.s
        return out if quantity.rate is None else out + quantity.rate @ course.rate

    def rows(self, measure: str, course: Course) -> Array:
        """Vectors (G, r, C) of which a measure is the largest norm.

        Of a peak one for every node and time after the motion, of others one: a mean is over
        the motion and the tail, as `E_mean` is.
        """
        nodes = self.along(QUANTITIES[measure], course)
        if measure in ENDS:
            return nodes[-1:]
        if measure in PEAKS:
            after = self.quantity(QUANTITIES[measure]).after
            return np.concatenate([nodes, after @ course.later])
        steps = np.diff(self.t, prepend=self.t[0], append=self.t[-1])
        share = np.sqrt((steps[:-1] + steps[1:]) / 2 / (self.t[-1] + TAIL))
        moving = (share[:, None, None] * nodes).reshape(-1, nodes.shape[-1])
        return np.vstack([moving, self._tail(measure) @ course.s[-1]])[None]

    def _tail(self, measure: str) -> Array:
        """R (S, S) with |R s|^2 a measure's part of the tail, s the state at its begin."""
        if measure not in self._tails:
            after = self.quantity(QUANTITIES[measure]).after
            S = gramian(self._tail_dynamics, after.T @ after, TAIL)
            self._tails[measure] = root(S / (self.t[-1] + TAIL))
        return self._tails[measure]

    @cached_property
    def _tail_dynamics(self) -> Array:
        """A while the joints are held, after the motion (S, S)."""
        last = self.M[-1:]
        return np.asarray(self._plant(last, np.zeros_like(last))[0])


def slope(values: Array, t: Array) -> Array:
    """Time derivative of samples (N, ...) at smoothly spaced times (N,), of fourth order."""
    steps = _stencil(t)  # of time per sample
    return np.asarray(_stencil(values) / steps.reshape(-1, *(1,) * (values.ndim - 1)))


def _stencil(values: Array) -> Array:
    """Derivative by the number of the sample, along the first axis."""
    out = np.empty_like(values)
    out[2:-2] = (values[:-4] - 8 * values[1:-3] + 8 * values[3:-1] - values[4:]) / 12
    ends = np.array([[-25.0, 48, -36, 16, -3], [-3, -10, 18, -6, 1]]) / 12
    out[:2] = np.tensordot(ends, values[:5], 1)
    out[-2:] = -np.tensordot(ends, values[:-6:-1], 1)[::-1]
    return out


# s between instants of which the largest is a peak, and of the base's shortest period: instants
# that far apart miss at most 2.2 % of its peak
_LONGEST, _OF_PERIOD = 0.002, 1 / 15
_BETWEEN_STEPS = 2 / 3  # of that period: longer steps of the inertia ring the base
_AFTER = 3.0  # s after the motion in which peaks are looked for: a swing of 0.2 Hz


def predict_disturbance(query: Query, motion: Motion) -> Disturbance:
    """Predict the disturbance measures of an answer to a query.

    Small angles; the inertia follows the arm, joints give way on their servo.
    """
    linear = LinearBase(query.system, query.servo, motion.start)
    M = linear.mass(linear.inertia(motion.start))[: linear.b, : linear.b]
    fastest = scipy.linalg.eigvalsh(linear.base_stiffness, M)[-1]
    period = 2 * np.pi / np.sqrt(fastest) if fastest > 0 else math.inf
    # what is simulated is seen once per physics step
    dt = min(_LONGEST, max(query.system.physics_dt / 2, _OF_PERIOD * period))
    nodes = max(NODES, math.ceil(motion.duration / (_BETWEEN_STEPS * period)))
    parts = max(FINE, math.ceil(motion.duration / (dt * nodes)))
    t = np.linspace(0.0, motion.duration, nodes * parts + 1)
    after = t[1] * np.arange(1, int(_AFTER / t[1]) + 1)
    response = LinearResponse(linear, motion, t, query.weight, after, parts)
    course = response.course(linear.load(motion, t)[..., None], query.base)

    out: dict[str, float] = {}
    for measure in QUANTITIES:
        largest = float(np.linalg.norm(response.rows(measure, course)[..., 0], axis=-1).max())
        out[measure] = largest**2 if measure == "E_weighted" else largest
    return Disturbance(**out)
