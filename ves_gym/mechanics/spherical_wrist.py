"""Joint angles for a tool's pose in closed form, of arms whose last three axes meet in a point.

Place and orientation then come apart (Pieper, thesis, Stanford 1968): the first three joints
bring the point to its place (shoulder and elbow two ways each), the last three turn the tool
(two ways). Plain NumPy, as `dynamics` is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.spatial import matvec

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

    cosine: Any  # arrays, or numbers of an angle that no configuration changes
    sine: Any

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
    if len(links) != 6 or arm.followers or any(k.slides or k.beta for k in links):
        return None
    sines = [round(math.sin(k.alpha), 9) for k in links]
    straight = (links[0].a, *(k.a for k in links[3:]), links[4].d)
    parallel = abs(links[1].alpha) < _TINY and abs(links[5].alpha) < _TINY
    square_on = all(abs(abs(sines[i]) - 1) < _TINY for i in (0, 2, 3, 4))
    if not parallel or not square_on or any(abs(k) > _TINY for k in straight):
        return None
    if min(abs(links[1].a), math.hypot(links[2].a, links[3].d)) < _TINY:
        return None
    return _Shape(sines[0], sines[2], sines[3], sines[4])


def shortest_way(arm: Arm, q: Array, place: Array, turn: Array) -> Array:
    """Return the joint angles (..., 6) missing to a pose: of all configurations' the shortest.

    Shortest in time, joints as fast as they may be (root of the sum of squares); configurations
    at the joint limits or beyond count as further away. A place (..., 3) out of reach is
    replaced by one within; turn (..., 3, 3) is from the tool's axes to the platform's.
    """
    shape = _shape(arm)
    if shape is None:
        raise ParameterError(
            f"joint angles in closed form need an arm with a spherical wrist, got {arm.name}"
        )
    angles = q + arm.column("offset")
    present = _Turn(np.cos(angles), np.sin(angles))
    best, least = q, np.zeros(())
    for k, end in enumerate(_every(arm, shape, place, turn)):
        gap = end.times(present.back())
        way, cost = _within(arm, q, np.arctan2(gap.sine, gap.cosine))
        if k == 0:
            best, least = way, cost
        nearer = cost < least
        best = np.where(nearer[..., None], way, best)
        least = np.where(nearer, cost, least)
    return best


def _within(arm: Arm, q: Array, way: Array) -> tuple[Array, Array]:
    """Ways (..., 6) from q, each this way round or the other, and their cost [s^2]."""
    low, high = arm.column("q_min") + _MARGIN, arm.column("q_max") - _MARGIN
    over = arm.column("v_max") ** -2

    def cost(angle: Array) -> Array:
        end = q + angle
        beyond = np.clip(end - high, 0.0, 7.0) + np.clip(low - end, 0.0, 7.0)
        return angle * angle * over + beyond * beyond * _BEYOND

    other = np.where(way < 0.0, way + 2 * math.pi, way - 2 * math.pi)
    near, there = cost(way), cost(other)
    round_ = there < near
    return np.where(round_, other, way), np.where(round_, there, near).sum(axis=-1)


def _every(arm: Arm, shape: _Shape, place: Array, turn: Array) -> Iterator[_Turn]:
    """Yield the eight configurations, angles (..., 6) of the DH table, with the tool at `place`
    (..., 3) [m] and `turn` (..., 3, 3) in the platform-top frame."""
    links = arm.links
    _, ground, foot, _ = arm.feet[0]
    # axes of the last link, and the point where the last three meet, in the first joint's
    hand = ground.T @ turn @ arm.tool_rotation.T
    end, side, ahead = (hand[..., k] for k in range(3))
    centre = matvec(ground.T, place - foot) - links[5].d * ahead
    x, y, z = (centre[..., k] for k in range(3))
    aside = shape.shoulder * (links[1].d + links[2].d)
    upper, fore = links[1].a, math.hypot(links[2].a, links[3].d)
    # the forearm's angle from the axis of its link
    bend = _Turn(links[2].a / fore, -shape.elbow * links[3].d / fore)
    height = (z - links[0].d) * shape.shoulder
    far = np.clip(x * x + y * y - aside * aside, _TINY, 1e9)
    reach = np.sqrt(far)
    square = far + height * height
    cosine = (square - (upper * upper + fore * fore)) * (1 / (2 * upper * fore))
    cosine = np.clip(cosine, -1.0, 1.0)
    sine = np.sqrt(1.0 - cosine * cosine)
    for front, up in itertools.product((1.0, -1.0), (1.0, -1.0)):
        out_there = reach * front
        first = _Turn(x * out_there - y * aside, y * out_there + x * aside)
        beta = _Turn(cosine, sine * up)
        third = beta.times(bend.back())
        along = _Turn(beta.cosine * fore + upper, beta.sine * fore)
        second = _Turn(out_there, height).times(along.back())
        (c, s), (cq, sq) = _unit(second.times(third)), _unit(first)
        # axes of the first link: outwards, and up or down
        none = 0.0 * cq
        outwards = np.stack([cq, sq, none], axis=-1)
        across = shape.shoulder * np.stack([sq, -cq, none], axis=-1)
        upwards = np.array([0.0, 0.0, shape.shoulder])
        x3 = c[..., None] * outwards + s[..., None] * upwards
        y3 = shape.elbow * across
        z3 = shape.elbow * (s[..., None] * outwards - c[..., None] * upwards)
        tilt = np.clip(-shape.wrist * shape.hand * _dot(ahead, z3), -1.0, 1.0)
        level = np.sqrt(1.0 - tilt * tilt)
        for flip in (1.0, -1.0):
            a, b = flip * shape.hand, flip * shape.wrist
            fourth = _Turn(_dot(ahead, x3) * a, _dot(ahead, y3) * a)
            sixth = _Turn(_dot(z3, end) * b, _dot(z3, side) * -b)
            turns = (first, second, third, fourth, _Turn(tilt, level * flip), sixth)
            yield _Turn(*(np.stack(parts, axis=-1) for parts in zip(*turns, strict=True)))


def _dot(a: Array, b: Array) -> Array:
    out: Array = (a * b).sum(axis=-1)
    return out


def _unit(turn: _Turn) -> _Turn:
    """Cosine and sine as they are, of both times a number; of no direction zeros."""
    square = turn.cosine * turn.cosine + turn.sine * turn.sine
    over = 1.0 / np.sqrt(np.clip(square, 1e-30, 1e30))
    return _Turn(turn.cosine * over, turn.sine * over)
