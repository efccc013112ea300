"""The motions that answer a query, their E_mean and their limits, by free control points.

With the base mass frozen at the middle of the straight line, E_mean = 1/2 u^T W u + g^T u + c
in the samples u of the joint momentum H_bm(q) q' (`MeanEnergy`); from rest g and c are zero.
The decision is the inner control points of a B-spline: way-points and their timing at once.
Position, speed and acceleration limits are linear in them, on the control polygon, so they
hold at every instant; limits of torque and distances from obstacles hold at sampled times.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.linear_motion import LinearMotion
from ves_gym.mechanics.link import matrix
from ves_gym.mechanics.motion import DEGREE, Motion, basis, graded, knots, leading_points
from ves_gym.planners.linear_response import LinearResponse
from ves_gym.planners.momentum import (
    BaseMomentum,
    InverseDynamics,
    momentum,
    spring_load,
    torque,
)
from ves_gym.planners.objective import MeanEnergy, QuadraticForm
from ves_gym.planners.obstacles import Collisions, collisions
from ves_gym.planners.prediction import (
    NODES,
    JointLoads,
    LinearBase,
    joint_loads,
    running_integral,
)
from ves_gym.planners.query import Query
from ves_gym.system.system import System

_FIXED = 3  # control points held at each end
_SHARE = 1 - 1e-4  # of speed and acceleration limits: more than the optimiser's tolerance
_MOVED_SHARE = 0.97  # where joints yield to a moving base, which is known to first order
_TORQUE_SHARE = 0.97  # of the limit, at samples: leaves room between them and for the servo
_SAMPLES = 4  # of torque per control point
_CLOSER = 1.01  # of that share: a peak between samples that is sampled from then on
_NEAR = 0.1  # m: shapes further from each other are not looked at
_ROOM = 0.005  # m kept beyond the clearance, for what happens between samples
_STEP = 0.06  # rad in joint space between samples of the distance, about
_INSTANTS = 240  # of a motion, between which its momentum is linear for the base's acceleration


class MotionProblem:
    """E_mean of a query's motions, and their limits, by the free control points x.

    `energy` is that of another problem of the same query, which need not be made twice.
    """

    def __init__(
        self,
        query: Query,
        free: int,
        energy: QuadraticForm | None = None,
        nodes: int = NODES,
    ) -> None:
        self.nodes = nodes if energy is None else len(energy.t) - 1  # samples of the momentum
        self.query, self.arm = query, query.system.arm
        self._free = LinearMotion(self.arm, query.system.base)
        self.start, self.goal = query.ends
        self.n, self.m = self.arm.n, free + 2 * _FIXED
        self._inner = slice(_FIXED, self.m - _FIXED)  # the free control points
        self._open = list(query.free_joints or ())
        self.first = np.array([self.start] * _FIXED)  # control points
        if query.is_moving:
            self.first = leading_points(self.m, query.duration, self.start, *query.start_motion)
        if energy is None:
            energy = self.form_at((self.start + self.goal) / 2)
        self.energy: QuadraticForm = energy
        self._bases = self.sampled(self.energy.t / query.duration, 3)
        self._torque_times = graded(_SAMPLES * self.m + 1)
        self._torque_bases = self.sampled(self._torque_times, 3)
        self._tau_max = _TORQUE_SHARE * self.arm.column("tau_max")
        self._loads: JointLoads | None = None  # what the base makes the joints do
        self._reaction: BaseReaction | None = None  # and how that changes with the motion
        # the straight quintic lies in the spline space, so its fit is exact
        self.straight = self.of(query.straight)
        self._checker: Collisions | None = None
        if query.surroundings is not None:
            self._checker = collisions(query.system.ideal(), query.surroundings)

    def form_at(
        self, at: Array | Motion, system: System | None = None, described: Arm | None = None
    ) -> MeanEnergy:
        """E_mean as a function of the momentum, the inertia frozen or that along a motion.

        Args:
            at: (n,) [rad], or a motion of the query's duration.
            system: another one than the query's.
            described: arm by which its servo is fed forward; None: its own.
        """
        query, system = self.query, system or self.query.system
        momentum = None
        if query.is_moving:
            momentum = inertia(system.arm, self.start)[:6, 6:] @ query.start_motion[0]
        return MeanEnergy(
            system,
            at,
            query.duration,
            query.servo,
            self.nodes,
            base=query.base,
            momentum=momentum,
            described=described,
            start=self.start,
        )

    def follow(self, motion: Motion) -> None:
        """Linearise about a motion: inertia along it, limits less what the servo adds there."""
        self.energy = self.form_at(motion)
        self.load(motion)

    def load(self, motion: Motion) -> None:
        """Take from the limits what joints need, and how fast they yield, under a motion.

        As where the answer is checked (`query.check_motion`), by the linear base.
        """
        query = self.query
        if query.is_loaded:
            self._loads = joint_loads(query.system, motion, query.servo, query.base)
            self.__dict__.pop("_linear", None)
            if query.servo.holds(self.arm):
                self._reaction = BaseReaction(self, motion)

    def _pushed(self, x: Array, t: Array) -> tuple[Array, Array | float]:
        """Torque (k, n) of the joints against the moving base at t [s], by x [N m]."""
        if self._loads is None:
            return np.zeros((len(t), self.n)), 0.0
        torque = self._loads.at(t)
        if self._reaction is None:
            return torque, 0.0
        change = self._reaction.change(x, t)
        return torque + change[..., 0], change[..., 1:].reshape(*torque.shape, -1, self.n)

    def sampled(self, u: Array, orders: int) -> list[Array]:
        """Basis functions and their derivatives at times u T: each (N, m)."""
        return [basis(self.m, u, k) / self.query.duration**k for k in range(orders)]

    def of(self, motion: Motion) -> Array:
        """The decision nearest to a motion, of any duration."""
        if motion.n != self.n:
            raise ParameterError(f"motion must have {self.n} joints, got {motion.n}")
        return self.near(motion.at(np.linspace(0, motion.duration, 12 * self.m)).q)

    def near(self, q: Array) -> Array:
        """The decision nearest to positions (N, n) at evenly spaced times [rad]."""
        first = self.first if self.query.is_moving else None
        fitted = Motion.fit(q, self.query.duration, controls=self.m, first=first)
        return np.clip(np.array(fitted.control)[self._inner].ravel(), *self.bounds)

    def control(self, x: Array) -> Array:
        """(m, n) control points from the free ones; free joints end at their last."""
        points, goal = x.reshape(-1, self.n), self.goal.copy()
        goal[self._open] = points[-1, self._open]
        return np.vstack([self.first, points, [goal] * _FIXED])

    def _at_points(self, rows: Array) -> Array:
        """Return rows (N, m) of all control points as those of free ones, by joint (N, free,
        n)."""
        inner = rows[:, self._inner, None]
        out = np.broadcast_to(inner, (*inner.shape[:2], self.n))
        if self._open:
            out = out.copy()
            out[:, -1, self._open] += rows[:, -_FIXED:].sum(axis=1)[:, None]
        return out

    def motion(self, x: Array) -> Motion:
        """The motion of a decision."""
        moving, points = self.query.is_moving or None, matrix(self.control(x))
        return Motion(duration=self.query.duration, control=points, moving=moving)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Joint limits: a B-spline stays inside the hull of its control points."""
        free = self.m - 2 * _FIXED
        low, high = self.arm.column("q_min"), self.arm.column("q_max")
        return np.tile(low, free), np.tile(high, free)

    # ------------------------------------------------------------------------ energy

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples u (N k) of `LinearBase.load`, and their derivative (N k, free n)."""
        return self._load(x, self._bases, self.energy.t)

    def _load(self, x: Array, bases: Sequence[Array], t: Array) -> tuple[Array, Array]:
        """The same at other times t (N,); `bases`: of positions, rates, accelerations there."""
        control = self.control(x)
        position, velocity = bases[:2]
        sample = momentum(self.arm, position @ control, velocity @ control)
        u, slope = self.chained(sample, bases)
        if len(self._free.passive) == 0:
            return u, slope
        load = spring_load(self._free, *(b @ control for b in bases))
        by = self._by_points(np.moveaxis(load.by, 1, 0), bases)
        return beside(t, u, slope, load.tau, by)

    def columns(self, x: Array, bases: Sequence[Array], t: Array) -> Array:
        """Samples at times t (N,) and, beside them, their derivative: (N, k, 1 + free n)."""
        u, slope = self._load(x, bases, t)
        return np.concatenate([u[:, None], slope], axis=1).reshape(len(t), -1, 1 + x.size)

    def chained(
        self, sample: BaseMomentum, bases: Sequence[Array] | None = None
    ) -> tuple[Array, Array]:
        """Samples (N k,) and their derivative by the control points (N k, free n)."""
        bases = self._bases if bases is None else bases
        slope = self._by_points((sample.by_q, sample.by_v), bases[:2])
        return sample.u.ravel(), slope.reshape(sample.u.size, -1)

    def _by_points(self, slopes: Iterable[Array], bases: Sequence[Array]) -> Array:
        """Derivative (N, k, free, n) from those by positions, rates, ... (N, k, n)."""
        parts = zip(slopes, bases, strict=True)
        terms = [np.einsum("kcj,kmj->kcmj", by, self._at_points(b)) for by, b in parts]
        return np.asarray(sum(terms[1:], start=terms[0]))

    # ------------------------------------------------------------------------ limits

    def limits(self, x: Array) -> tuple[Array, Array]:
        """Return what must be <= 0, in shares of limits (of 0.1 m for distances), and by x."""
        offset, slope = self._linear
        parts = [(offset + slope @ x, slope)]
        if self.query.system.drive == "motor":
            value, derivative = self._torque(x)
            parts += [(value - 1, derivative), (-value - 1, -derivative)]
        if self._checker is not None:
            parts.append(self._distance(x, self._checker))
        return stacked(parts)

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        """offset + slope @ x <= 0: the control polygons of velocity and acceleration."""
        parts = [(np.zeros(0), np.zeros((0, self.straight.size)))]
        t = knots(self.m) * self.query.duration
        ends = self.control(np.zeros_like(self.straight))
        polygon = np.eye(self.m)
        for order, limit in ((1, self.query.v_max), (2, self.query.a_max)):
            count, degree = self.m - order, DEGREE + 1 - order
            span = t[DEGREE + 1 : count + DEGREE + 1] - t[order : count + order]
            polygon = degree * np.diff(polygon, axis=0) / span[:, None]
            if limit is None:
                continue
            exact = self.query.base is None  # and so joints yield to nothing
            most = (_SHARE if exact else _MOVED_SHARE) * np.array(limit)
            up, down = self._yielding(t, order) / most
            rows = self._at_points(polygon)[:, None] * np.diag(1 / most)[:, None]
            rows = rows.reshape(count * self.n, -1)
            at_rest = (polygon @ ends) / most
            active = np.abs(rows).max(axis=1) > 0
            parts.append(((at_rest + up).ravel()[active] - 1, rows[active]))
            parts.append((-(at_rest + down).ravel()[active] - 1, -rows[active]))
        return stacked(parts)

    def _yielding(self, t: Array, order: int) -> Array:
        """Largest and least rate of pushed joints while a point of the polygon acts (2, k, n).

        Only rates (order 1 of the derivative) are limited as the joints move; t: knots.
        """
        count, degree = self.m - order, DEGREE + 1 - order
        if self._loads is None or order != 1:
            return np.zeros((2, count, self.n))
        rate = self._loads.rate
        out = np.empty((2, count, self.n))
        for i in range(count):
            low, high = np.searchsorted(self._loads.t, (t[i + order], t[i + degree + order]))
            part = rate[max(low - 1, 0) : high + 1]
            out[:, i] = part.max(axis=0), part.min(axis=0)
        return out

    def torque(self, x: Array, bases: list[Array], arm: Arm | None = None) -> InverseDynamics:
        """Joint torque on a base that stands still (k, n) [N m], by (k, n, free, n).

        `bases`: of positions, rates and accelerations at k times; `arm`: default the query's.
        """
        control = self.control(x)
        dynamics = torque(arm or self.arm, *(b @ control for b in bases))
        slopes = np.moveaxis(dynamics.by, 1, 0)
        return InverseDynamics(dynamics.tau, self._by_points(slopes, bases))

    def _torque(self, x: Array) -> tuple[Array, Array]:
        """Joint torque over its limit at sampled times, on a base that stands still."""
        dynamics = self.torque(x, self._torque_bases)
        pushed, by = self._pushed(x, self._torque_times * self.query.duration)
        tau, scaled = dynamics.tau + pushed, (dynamics.by + by) / self._tau_max[:, None, None]
        return (tau / self._tau_max).ravel(), scaled.reshape(tau.size, -1)

    def add_torque_samples(self, x: Array) -> bool:
        """Sample the torque also at its peaks between samples; True if any passes its share."""
        if self.query.system.drive != "motor":
            return False
        fine = graded(12 * len(self._torque_times))
        control = self.control(x)
        tau = torque(self.arm, *(b @ control for b in self.sampled(fine, 3))).tau
        tau = np.abs((tau + self._pushed(x, fine * self.query.duration)[0]) / self._tau_max)
        inner = (tau[1:-1] >= tau[:-2]) & (tau[1:-1] >= tau[2:]) & (tau[1:-1] > _CLOSER)
        peaks = fine[1:-1][inner.any(axis=1)]
        if not len(peaks):
            return False
        self._torque_times = np.union1d(self._torque_times, peaks)
        self._torque_bases = self.sampled(self._torque_times, 3)
        return True

    def _distance(self, x: Array, checker: Collisions) -> tuple[Array, Array]:
        """Lack of distance at sampled times, in units of 0.1 m."""
        control = self.control(x)
        polygon = float(np.linalg.norm(np.diff(control, axis=0), axis=1).sum())
        count = int(np.clip(polygon / _STEP, 20, 400))
        position = basis(self.m, graded(count))
        least = checker.clearance + _ROOM
        near = [checker.proximity(row @ control, least + _NEAR) for row in position[1:-1]]
        counts = [len(k.distance) for k in near]
        at = np.repeat(self._at_points(position[1:-1]), counts, axis=0)  # of each distance
        slope = np.vstack([k.slope for k in near])
        rows = -10 * at * slope[:, None, :]
        lack = 10 * (least - np.concatenate([k.distance for k in near]))
        return lack, rows.reshape(len(lack), x.size)


class BaseReaction:
    """Torque that the base's acceleration asks of held joints, by first order near a motion.

    Args:
        problem: of motions from rest on a base at rest.
        motion: one of them.
    """

    def __init__(self, problem: MotionProblem, motion: Motion) -> None:
        query, clock = problem.query, graded(_INSTANTS + 1)
        linear = LinearBase(query.system, query.servo, motion.start)
        self._response = LinearResponse(linear, motion, clock * query.duration)
        self._columns, self._bases = problem.columns, problem.sampled(clock, 3)
        self._about = linear.load(motion, self._response.t)
        self._across = linear.inertia(motion.at(self._response.t).q)[:, 6:, :6]

    def change(self, x: Array, t: Array) -> Array:
        """Torque beyond that under the motion, and by x: (k, n, 1 + free n) at t (k,) [s]."""
        nodes = self._response.t
        columns = self._columns(x, self._bases, nodes)
        columns[..., 0] -= self._about
        torque = self._across @ self._response.along("base", self._response.course(columns))
        before = np.clip(np.searchsorted(nodes, t) - 1, 0, len(nodes) - 2)
        share = ((t - nodes[before]) / np.diff(nodes)[before])[:, None, None]
        return np.asarray((1 - share) * torque[before] + share * torque[before + 1])


def beside(t: Array, u: Array, slope: Array, torque: Array, by: Array) -> tuple[Array, Array]:
    """Samples u (N k) with torques (N, l) integrated over time, and their derivative.

    Args:
        t: (N,) s.
        u, slope: samples and their derivative (N k, free n).
        torque, by: (N, l) [N m] and their derivative (N, l, free, n).
    """
    integral, its = running_integral(torque, t), running_integral(by, t)
    samples = np.hstack([u.reshape(len(t), -1), integral])
    slopes = [slope.reshape(len(t), -1, slope.shape[1]), its.reshape(*integral.shape, -1)]
    return samples.ravel(), np.concatenate(slopes, axis=1).reshape(samples.size, -1)


def stacked(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Values one after another, and their derivatives."""
    return np.concatenate([v for v, _ in parts]), np.vstack([slope for _, slope in parts])
