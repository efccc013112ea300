"""Ways through joint space made into motions: time laws, and what limits leave of a way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.case import Query
from ves_gym.planners.query import first_violation

_RAMP = 0.2  # of a cruising motion's time to speed up in, and to slow down in


_POINTS = 65  # of a path that is drawn towards the straight line


_FOLLOWED = (48, 96)  # control points of a motion that has to stay on the path found


def time_path(query: Query, path: Array) -> tuple[Motion, float]:
    """Time way-points (k, n) [rad] by a motion that respects the query's limits where one can.

    The first of these that does: smooth through them; along their straight edges by a
    quintic; by a law that cruises, for limits of speed. Without surroundings the path is
    drawn towards the straight line instead: the second value is the share of its way that
    is left [1].
    """
    smooth = Motion.through(path, query.duration)
    if first_violation(query, smooth) is None:
        return smooth, 1.0
    if query.surroundings is None:
        return feasible_part(query, resample(path, _POINTS))
    for law in (quintic, cruise):
        for controls in _FOLLOWED:
            motion = follow(path, query.duration, query.speed, controls, law)
            if first_violation(query, motion) is None:
                return motion, 1.0
    return motion, 1.0


def follow(
    path: Array, duration: float, speed: Array, controls: int, law: Callable[[Array], Array]
) -> Motion:
    """Pass along the straight edges of a polyline, its corners rounded a little.

    Joint speeds stay in proportion to their limits: the law runs over the time the path takes
    with one joint at its limit throughout.

    Args:
        path: (k, n) way-points [rad].
        duration: of the motion [s].
        speed: (n,) speed limits [rad/s].
        controls: control points of the motion.
        law: rest-to-rest law on [0, 1], (N,) to (N,).
    """
    fine = resample(path, 2001)
    least = np.r_[0, np.cumsum(np.max(np.abs(np.diff(fine, axis=0)) / speed, axis=1))]
    at = law(np.linspace(0, 1, 20 * controls + 1)) * least[-1]
    q = np.stack([np.interp(at, least, column) for column in fine.T], axis=1)
    q[0], q[-1] = path[0], path[-1]
    return Motion.fit(q, duration, controls=controls)


def cruise(u: Array) -> Array:
    """Rest-to-rest law on [0, 1] with constant speed 1 / (1 - _RAMP) between its ramps."""
    x = np.clip(np.minimum(u, 1 - u) / _RAMP, 0.0, 1.0)
    ramp = _RAMP * x**4 * (2.5 - 3 * x + x**2)  # integral of the quintic
    way = (ramp + np.maximum(np.minimum(u, 1 - u) - _RAMP, 0.0)) / (1 - _RAMP)
    return np.asarray(np.where(u < 0.5, way, 1 - way))


def septic(u: Array) -> Array:
    """Rest-to-rest law 35 u^4 - 84 u^5 + 70 u^6 - 20 u^7 on [0, 1], held outside."""
    x = np.clip(u, 0.0, 1.0)
    return np.asarray(x**4 * (35 + x * (-84 + x * (70 - 20 * x))))


def resample(path: Array, points: int) -> Array:
    """Points evenly spaced along a polyline (k, n) in joint space, its ends unchanged."""
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    at = np.linspace(0, length[-1], points)
    return np.stack([np.interp(at, length, path[:, j]) for j in range(path.shape[1])], axis=1)


def feasible_part(query: Query, path: Array) -> tuple[Motion, float]:
    """Time a path (k, n), drawn towards the straight line until it respects the limits.

    Also returns the share of the way from the straight line that is left [1].
    """
    straight = np.linspace(path[0], path[-1], len(path))

    def timed(share: float) -> Motion:
        return Motion.through(straight + share * (path - straight), query.duration)

    def keeps(share: float) -> bool:
        return first_violation(query, timed(share)) is None

    if keeps(1.0) or not keeps(0.0):
        return timed(1.0), 1.0
    low, high = 0.0, 1.0
    for _ in range(8):
        middle = (low + high) / 2
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return timed(low), low
