"""The bad path of thesis 4.2: one joint after the other, in the order of most coupling."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.coupling import coupling_length, coupling_matrix
from ves_gym.planners.query import NoPlan, Query
from ves_gym.system.system import System

_CONTROLS = 64  # of the joint-by-joint motion: follows it to about 1e-4 rad
_STEPS = 60  # of a joint's part of the path
_MOST = 12  # joints: beyond, 2^n sets of joints are too many
_AT_ONCE = 200_000  # configurations


class BadPath:
    """The path that the coupling map warns of: one joint after the other, in the worst order.

    Of all orders of the joints, the one of greatest coupling length on raw Q; each joint
    moves from rest to rest in its share of the time.
    """

    name = "bad-path"
    summary = "one joint after the other, in the order of greatest coupling length"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Move the joints one by one, in the worst order; deterministic.

        Args:
            query: the ends and the duration.
            seed: not used.

        Returns:
            The motion, and its coupling length [J^(1/2)].

        Raises:
            NoPlan: too many joints to compare all their orders.
        """
        start, goal = query.ends
        moving = np.flatnonzero(start != goal)
        if len(moving) > _MOST:
            raise NoPlan(
                f"no bad path: {_MOST} joints have {2**_MOST} sets whose coupling lengths are"
                f" compared, more would take too long; {len(moving)} move here"
            )
        route = np.tile(start, (3 * _STEPS + 1, 1))
        if len(moving):
            turn = np.zeros(len(start))  # when each joint moves
            turn[worst_order(query.system, start, goal)] = np.arange(len(moving))
            # enough samples for the fit where only one joint moves
            u = np.linspace(0, len(moving), max(3, len(moving)) * _STEPS + 1)[:, None]
            route = start + quintic(u - turn) * (goal - start)
            route[-1] = goal  # not to rounding only
        motion = Motion.fit(route, query.duration, controls=_CONTROLS)
        return motion, {"coupling_length": coupling_length(query.system, route, None)}


def worst_order(system: System, start: Array, goal: Array) -> list[int]:
    """Order of the moving joints of greatest coupling length on raw Q.

    A joint's part depends on which joints moved before it, not on their order: the longest way
    through the sets of joints (Held and Karp).

    Args:
        system: arm and vehicle.
        start, goal: (n,) [rad].

    Returns:
        Numbers of the joints that move, from 0.
    """
    moving = np.flatnonzero(start != goal).tolist()
    part = _parts(system, start, goal, moving)
    count = 2 ** len(moving)
    longest, last = np.full(count, -1.0), np.zeros(count, int)
    longest[0] = 0.0
    for moved in range(count):  # bits: joints that have moved
        for k in range(len(moving)):
            after = moved | 1 << k
            if after != moved and longest[moved] + part[k, moved] > longest[after]:
                longest[after], last[after] = longest[moved] + part[k, moved], k
    order, moved = [], count - 1
    while moved:
        order.append(moving[last[moved]])
        moved &= ~(1 << int(last[moved]))
    return order[::-1]


def _parts(system: System, start: Array, goal: Array, moving: list[int]) -> Array:
    """Coupling length (k, 2^k) of each moving joint's part, by which have moved before.

    Of a joint alone it is the integral of sqrt(Q_jj) along its way.
    """
    count = 2 ** len(moving)
    u = quintic(np.linspace(0, 1, _STEPS + 1))
    out = np.zeros((len(moving), count))
    bits = np.arange(count)[:, None] >> np.arange(len(moving)) & 1
    at_once = max(1, _AT_ONCE // _STEPS)
    for k, j in enumerate(moving):
        sets = np.flatnonzero(bits[:, k] == 0)
        way = goal[j] - start[j]
        steps = np.diff(u) * abs(way)
        for first in range(0, len(sets), at_once):
            chunk = sets[first : first + at_once]
            q = np.repeat(start[None], len(chunk), axis=0)
            q[:, moving] += bits[chunk] * (goal - start)[moving]
            q = np.repeat(q[:, None], _STEPS, axis=1)
            q[..., j] = start[j] + (u[1:] + u[:-1]) / 2 * way
            Q = coupling_matrix(system, q)[..., j, j]
            out[k, chunk] = np.sqrt(np.maximum(Q, 0.0)) @ steps
    return out
