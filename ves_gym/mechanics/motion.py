"""Joint motions: quintic B-splines in time, at rest at both ends or at the last one only.

One form serves a straight rest-to-rest quintic (no inner knots), a spline through
way-points and the path an optimiser shapes; its control points are the decision.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    require_positive,
    unit,
)
from ves_gym.mechanics.link import matrix

DEGREE = 5
_GRADING = 0.6  # of the knots: 1 - this is their relative spacing at the ends
_HELD = 3  # equal control points at each end: zero velocity and acceleration there


class Samples(NamedTuple):
    """A motion at given times."""

    t: Array  # (N,) s
    q: Array  # (N, n) rad
    v: Array  # (N, n) rad/s
    a: Array  # (N, n) rad/s^2


def quintic(u: npt.ArrayLike) -> Array:
    """Rest-to-rest law s(u) = 10u^3 - 15u^4 + 6u^5 on [0, 1], held outside."""
    x = np.clip(np.asarray(u, float), 0.0, 1.0)
    out: Array = x**3 * (10 + x * (6 * x - 15))
    return out


QUINTIC_PEAK_SPEED = 15 / 8  # of quintic(u), at u = 1/2


@dataclass(frozen=True, kw_only=True)
class Motion:
    """q(t) on [0, duration]; before and after it the joints are held.

    `control` holds the B-spline control points (m, n); the last three are equal, and so are
    the first three unless the joints are `moving` at the start. Knots: see `knots`.
    """

    duration: float = unit("s")
    control: Matrix = unit("rad")
    moving: bool | None = None  # True: not at rest at the start

    def __post_init__(self) -> None:
        require_positive(self, "duration")
        if self.moving is not None and not isinstance(self.moving, bool):
            raise ParameterError(f"Motion.moving must be true or false, got {self.moving!r}")
        points = _points(self.control, "Motion.control", least=DEGREE + 1)
        ends = (points[-_HELD:],) if self.moving else (points[:_HELD], points[-_HELD:])
        if any(not np.array_equal(end, np.broadcast_to(end[0], end.shape)) for end in ends):
            which = "its last point" if self.moving else "its first and its last point"
            raise ParameterError(f"Motion.control must repeat {which} three times")

    @staticmethod
    def straight(start: npt.ArrayLike, goal: npt.ArrayLike, duration: float) -> Motion:
        """Return the quintic rest-to-rest motion along a straight line in joint space."""
        a, b = _points([start, goal], "start and goal", least=2)
        return Motion(duration=duration, control=matrix(np.array([a] * _HELD + [b] * _HELD)))

    @staticmethod
    def to_rest(
        start: npt.ArrayLike,
        rate: npt.ArrayLike,
        acceleration: npt.ArrayLike,
        goal: npt.ArrayLike,
        duration: float,
    ) -> Motion:
        """Return the quintic from joints that move at time 0 to rest at the goal."""
        a, v, dv, b = _points([start, rate, acceleration, goal], "start and goal", least=4)
        first = leading_points(2 * _HELD, duration, a, v, dv)
        return Motion(
            duration=duration, control=matrix(np.vstack([first, [b] * _HELD])), moving=True
        )

    @staticmethod
    def through(points: npt.ArrayLike, duration: float, *, controls: int = 48) -> Motion:
        """Return a smooth motion along way-points (k >= 2, n) [rad], quintic in path length.

        The path through the way-points is a spline in joint-space length; the motion is its
        least-squares B-spline of so many control points. It passes the inner points to about
        1e-3 rad where the path is smooth or has few of them; sharp corners are rounded (0.02
        rad on a staircase of 18 steps of 0.2 rad) unless `controls` grows with their number.
        """
        way = _points(points, "way-points", least=2)
        steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
        start, goal = way[0], way[-1]
        way = way[np.r_[True, steps > 1e-12]]
        if len(way) < 3:
            return Motion.straight(start, goal, duration)
        length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))]
        path = scipy.interpolate.make_interp_spline(
            length / length[-1], way, k=min(3, len(way) - 1)
        )
        u = np.linspace(0, 1, 20 * controls + 1)
        q = path(quintic(u))
        q[0], q[-1] = start, goal  # not to rounding only
        return Motion.fit(q, duration, controls=controls)

    @staticmethod
    def fit(
        samples: npt.ArrayLike,
        duration: float,
        *,
        controls: int = 32,
        first: Array | None = None,
    ) -> Motion:
        """Return the least-squares motion through positions (N, n) [rad] at evenly spaced
        times.

        The ends are met exactly, with zero velocity and acceleration; `first` (3, n) are the
        first control points of joints that move at the start (`leading_points`).
        """
        q = _points(samples, "samples", least=2)
        if controls < DEGREE + 1:
            raise ParameterError(f"controls must be >= {DEGREE + 1}, got {controls}")
        u = np.linspace(0, 1, len(q))
        design = basis(controls, u)
        last = design[:, -_HELD:].sum(1)[:, None] * q[-1]
        if first is None:
            ends = design[:, :_HELD].sum(1)[:, None] * q[0] + last
        else:
            ends = design[:, :_HELD] @ first + last
        inner = np.linalg.lstsq(design[:, _HELD:-_HELD], q - ends, rcond=None)[0]
        begin = np.array([q[0]] * _HELD) if first is None else first
        control = np.vstack([begin, inner, [q[-1]] * _HELD])
        return Motion(
            duration=duration, control=matrix(control), moving=None if first is None else True
        )

    @cached_property
    def _splines(self) -> tuple[Any, Any, Any]:
        points = np.asarray(self.control, float)
        spline = scipy.interpolate.BSpline(knots(len(points)) * self.duration, points, DEGREE)
        return spline, spline.derivative(1), spline.derivative(2)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.control[0])

    @property
    def start(self) -> Array:
        """(n,) first configuration [rad]."""
        return np.array(self.control[0])

    @property
    def goal(self) -> Array:
        """(n,) last configuration [rad]."""
        return np.array(self.control[-1])

    def at(self, t: npt.ArrayLike) -> Samples:
        """Position, velocity and acceleration at times t (N,); held outside the motion."""
        times = np.asarray(t, float)
        inside = np.clip(times, 0.0, self.duration)
        position, velocity, acceleration = (spline(inside) for spline in self._splines)
        outside = (times < 0) | (times > self.duration)
        velocity[outside] = 0.0
        acceleration[outside] = 0.0
        return Samples(times, position, velocity, acceleration)

    def retimed(self, duration: float) -> Motion:
        """The same path at another duration."""
        return Motion(duration=duration, control=self.control, moving=self.moving)

    def __repr__(self) -> str:
        return (
            f"<Motion: {self.n} joints, {len(self.control)} control points,"
            f" {self.duration:g} s>"
        )


def _points(value: Any, name: str, least: int) -> Array:
    """(k >= least, n >= 1) finite numbers."""
    try:
        raw = np.asarray(value)
    except ValueError:  # ragged
        raw = np.empty(0, object)
    if raw.dtype.kind not in "fiu":
        raise ParameterError(f"{name} must be rows of n numbers, got {value!r}")
    points: Array = raw.astype(np.float64)
    if points.ndim != 2 or len(points) < least or points.shape[1] < 1:
        raise ParameterError(f"{name} must have shape (>= {least}, n), got {points.shape}")
    if not np.isfinite(points).all():
        where = np.argwhere(~np.isfinite(points))[0].tolist()
        raise ParameterError(f"{name} must be finite, got {points[tuple(where)]} at {where}")
    return points


def knots(m: int) -> Array:
    """Clamped knot vector on [0, 1] for m control points, closer together near the ends, so
    that a motion can build up its acceleration quickly from rest."""
    inner = graded(m - DEGREE + 1)
    out: Array = np.r_[np.zeros(DEGREE), inner, np.ones(DEGREE)]
    return out


def leading_points(m: int, duration: float, q: Array, v: Array, a: Array) -> Array:
    """Return the first three (3, n) of m control points of a motion that begins with angles q,
    rates v and accelerations a (n,)."""
    rows = [basis(m, [0.0], k)[0, :_HELD] / duration**k for k in range(_HELD)]
    out: Array = np.linalg.solve(np.array(rows), np.array([q, v, a]))
    return out


def graded(count: int) -> Array:
    """Points on [0, 1], ends included, spaced like the knots: closer near the ends."""
    even = np.linspace(0, 1, count)
    out: Array = even - _GRADING * np.sin(2 * np.pi * even) / (2 * np.pi)
    return out


def basis(m: int, u: npt.ArrayLike, derivative: int = 0) -> Array:
    """Return values or derivatives (N, m) of the B-spline basis of m functions at u (N,) in [0,
    1]."""
    spline = scipy.interpolate.BSpline(knots(m), np.eye(m), DEGREE)
    out: Array = spline(np.asarray(u, float), nu=derivative)
    return out
