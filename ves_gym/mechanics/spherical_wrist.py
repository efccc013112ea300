"""Joint angles for a tool's pose in closed form, of arms whose last three axes meet in a point.

Place and orientation then come apart (Pieper, thesis, Stanford 1968): the first three joints
bring the point to its place (shoulder and elbow two ways each), the last three turn the tool
(two ways). Written as `dynamics` is, for numbers, arrays and symbols.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import Rotation, Scalar, Vec, add, dot, scale, start

_TINY = 1e-9
_MARGIN = 0.05  # rad inside the joint limits
_BEYOND = 3e4  # s^2: how the square of an angle beyond counts beside squared seconds


class _Shape(NamedTuple):
    """Signs of the right angles between the axes."""

    shoulder: float
    elbow: float
    wrist: float
    hand: float


class _Turn(NamedTuple):
    """Cosine and sine of an angle, times a positive number."""

    cosine: Scalar
    sine: Scalar

    def times(self, other: _Turn) -> _Turn:
        """Return the sum of both angles."""
        return _Turn(
            self.cosine * other.cosine - self.sine * other.sine,
            self.sine * other.cosine + self.cosine * other.sine,
        )

    def back(self) -> _Turn:
        """Return the angle, the other way round."""
        return _Turn(self.cosine, -self.sine)


def has_spherical_wrist(arm: Arm) -> bool:
    """Return if an arm is a shoulder, an upper arm, a forearm and a wrist of three axes."""
    return _shape(arm) is not None


def _shape(arm: Arm) -> _Shape | None:
    """Return how the axes of an arm stand to each other; None: it is of another kind."""
    links = arm.links
    if len(links) != 6 or any(k.slides or k.beta for k in links):
        return None
    sines = [round(math.sin(k.alpha), 9) for k in links]
    straight = (links[0].a, *(k.a for k in links[3:]), links[4].d)
    parallel = abs(links[1].alpha) < _TINY and abs(links[5].alpha) < _TINY
    right = all(abs(abs(sines[i]) - 1) < _TINY for i in (0, 2, 3, 4))
    if not parallel or not right or any(abs(k) > _TINY for k in straight):
        return None
    if min(abs(links[1].a), math.hypot(links[2].a, links[3].d)) < _TINY:
        return None
    return _Shape(sines[0], sines[2], sines[3], sines[4])


def shortest_way(
    arm: Arm,
    q: Sequence[Scalar],
    place: Vec,
    turn: Sequence[Vec],
    xp: Any,
    clip: Callable[[Any, float, float], Any],
) -> list[Scalar]:
    """Return the joint angles missing to a pose: of all configurations' the shortest.

    Shortest in time, joints as fast as they may be (root of the sum of squares); configurations
    at the joint limits or beyond count as further away. A place out of reach is replaced by one
    within.

    Args:
        arm: with a spherical wrist.
        q: 6 joint angles now [rad], numbers, arrays or symbols.
        place: that the tool is to have in the platform-top frame [m].
        turn: axes that it is to have there, unit vectors.
        xp: namespace of sin, cos, sqrt, arctan2 and where.
        clip: brings the first argument into the range of the others.

    Returns:
        6 angles [rad].
    """
    shape = _shape(arm)
    if shape is None:
        raise ParameterError(
            f"joint angles in closed form need an arm with a spherical wrist, got {arm.name}"
        )
    now = [
        _Turn(xp.cos(k + link.offset), xp.sin(k + link.offset))
        for k, link in zip(q, arm.links, strict=True)
    ]
    best: list[Scalar] = []
    least: Scalar = math.inf
    for ends in _every(arm, shape, place, turn, xp, clip):
        ways, costs = [], []
        for i, (end, at) in enumerate(zip(ends, now, strict=True)):
            gap = end.times(at.back())
            way, cost = _within(arm, i, q[i], xp.arctan2(gap.sine, gap.cosine), xp, clip)
            ways.append(way)
            costs.append(cost)
        cost = sum(costs)
        if best:
            nearer = cost < least
            best = [xp.where(nearer, a, b) for a, b in zip(ways, best, strict=True)]
            least = xp.where(nearer, cost, least)
        else:
            best, least = ways, cost
    return best


def _within(
    arm: Arm, joint: int, q: Scalar, way: Scalar, xp: Any, clip: Callable[..., Any]
) -> tuple[Scalar, Scalar]:
    """One joint's way, this way round or the other, and what it costs [s^2].

    Args:
        arm: whose joint.
        joint: which.
        q: its angle now [rad].
        way: to go, up to half a turn [rad].
        xp: namespace of where.
        clip: brings the first argument into the range of the others.
    """
    link = arm.links[joint]
    low, high, over = link.q_min + _MARGIN, link.q_max - _MARGIN, link.v_max**-2

    def cost(some: Scalar) -> Scalar:
        end = q + some
        beyond = clip(end - high, 0.0, 7.0) + clip(low - end, 0.0, 7.0)
        return some * some * over + beyond * beyond * _BEYOND

    other = xp.where(way < 0.0, way + 2 * math.pi, way - 2 * math.pi)
    here, there = cost(way), cost(other)
    round_ = there < here
    return xp.where(round_, other, way), xp.where(round_, there, here)


def _every(
    arm: Arm,
    shape: _Shape,
    place: Vec,
    turn: Sequence[Vec],
    xp: Any,
    clip: Callable[..., Any],
) -> list[list[_Turn]]:
    """Return the eight configurations, angles of the DH table.

    Args:
        arm: of this shape.
        shape: its.
        place: of the tool in the platform-top frame [m].
        turn: axes of the tool there.
        xp: namespace of sqrt.
        clip: brings the first argument into the range of the others.
    """
    links = arm.links
    ground, foot = start(arm)
    columns = arm.tool_rotation.tolist()  # of the tool's axes, those of the last link
    last = [
        tuple(dot(axis, Rotation(*turn).apply(tuple(row))) for axis in ground)
        for row in columns
    ]
    centre = add(place, scale(-1.0, foot))
    x, y, z = add(tuple(dot(axis, centre) for axis in ground), scale(-links[5].d, last[2]))
    aside = shape.shoulder * (links[1].d + links[2].d)
    upper, fore = links[1].a, math.hypot(links[2].a, links[3].d)
    # the forearm's angle from the axis of its link
    bend = _Turn(links[2].a / fore, -shape.elbow * links[3].d / fore)
    height = (z - links[0].d) * shape.shoulder
    far = clip(x * x + y * y - aside * aside, _TINY, 1e9)
    reach = xp.sqrt(far)
    square = far + height * height
    cosine = (square - (upper * upper + fore * fore)) * (1 / (2 * upper * fore))
    cosine = clip(cosine, -1.0, 1.0)
    sine = xp.sqrt(1.0 - cosine * cosine)
    out = []
    for front, up in itertools.product((1.0, -1.0), (1.0, -1.0)):
        out_there = reach * front
        first = _Turn(x * out_there - y * aside, y * out_there + x * aside)
        beta = _Turn(cosine, sine * up)
        third = beta.times(bend.back())
        along = _Turn(beta.cosine * fore + upper, beta.sine * fore)
        second = _Turn(out_there, height).times(along.back())
        both = second.times(third)
        c, s = _unit(both, xp, clip)
        cq, sq = _unit(first, xp, clip)
        # axes of the first link: outwards, and up or down
        outwards, across = (cq, sq, 0.0), (sq * shape.shoulder, -cq * shape.shoulder, 0.0)
        upwards = (0.0, 0.0, shape.shoulder)
        x3 = add(scale(c, outwards), scale(s, upwards))
        z3 = scale(shape.elbow, add(scale(s, outwards), scale(-c, upwards)))
        y3 = scale(shape.elbow, across)
        tilt = clip(-shape.wrist * shape.hand * dot(last[2], z3), -1.0, 1.0)
        side = xp.sqrt(1.0 - tilt * tilt)
        for flip in (1.0, -1.0):
            a, b = flip * shape.hand, flip * shape.wrist
            fourth = _Turn(dot(last[2], x3) * a, dot(last[2], y3) * a)
            sixth = _Turn(dot(z3, last[0]) * b, dot(z3, last[1]) * -b)
            out.append([first, second, third, fourth, _Turn(tilt, side * flip), sixth])
    return out


def _unit(turn: _Turn, xp: Any, clip: Callable[..., Any]) -> _Turn:
    """Cosine and sine as they are; of no direction zeros.

    Args:
        turn: both, times a number.
        xp: namespace of sqrt.
        clip: brings the first argument into the range of the others.
    """
    square = turn.cosine * turn.cosine + turn.sine * turn.sine
    over = 1.0 / xp.sqrt(clip(square, 1e-30, 1e30))
    return _Turn(turn.cosine * over, turn.sine * over)
