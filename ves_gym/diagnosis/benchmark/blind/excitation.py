"""What the arm is told to do: a menu of motions within the joints' limits.

Every motion is a sum of smooth pieces with exact derivatives, at rest at its start.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean

KINDS = ("multisine", "moves", "sweeps", "fast")
DURATION = 10.0  # s
_MARGIN = 0.9  # of the joints' limits
_LEAST = 0.25  # s, shortest move


class MotionSamples(NamedTuple):
    """Commanded joint motion, (N, 3) each."""

    q: Array
    v: Array
    a: Array


class JointLimits(NamedTuple):
    """Of the joints, (3,) each."""

    low: Array
    high: Array
    speed: Array
    acceleration: Array


def limits_of(arm: dict[str, Any]) -> JointLimits:
    """Return joint limits of an arm description."""
    return JointLimits(
        *(
            np.array([link[k] for link in arm["links"]])
            for k in ("q_min", "q_max", "v_max", "a_max")
        )
    )


class ExcitationMotion(NamedTuple):
    """Joint j: polynomial moves between way-points, plus sines under a smooth start."""

    times: list[Array]  # per joint (k,) instants of the way-points
    points: list[Array]  # per joint (k,) rad
    cubic: list[bool]  # per joint: rest-to-rest cubic or quintic
    waves: list[Array]  # per joint (m, 3) amplitude [rad], rad/s, phase

    def at(self, t: Array) -> MotionSamples:
        """Return position, rate and acceleration at instants t (N,), held outside."""
        q, v, a = np.zeros((3, len(t), len(self.times)))
        for j in range(len(self.times)):
            q[:, j], v[:, j], a[:, j] = _moves(t, self.times[j], self.points[j], self.cubic[j])
            for part, add in zip((q, v, a), _waves(t, self.waves[j]), strict=True):
                part[:, j] += add
        return MotionSamples(q, v, a)

    def scaled(self, factor: Array) -> ExcitationMotion:
        """Return joint j's motion about its first way-point times factor[j]."""
        return self._replace(
            points=[p[0] + f * (p - p[0]) for p, f in zip(self.points, factor, strict=True)],
            waves=[w * [f, 1.0, 1.0] for w, f in zip(self.waves, factor, strict=True)],
        )


def _moves(t: Array, times: Array, points: Array, cubic: bool) -> tuple[Array, Array, Array]:
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    length, step = (times[1:] - times[:-1])[k], (points[1:] - points[:-1])[k]
    u = np.clip((t - times[k]) / length, 0.0, 1.0)
    inside = (t > times[0]) & (t < times[-1])
    if cubic:
        s, ds, dds = u * u * (3 - 2 * u), 6 * u * (1 - u), 6 - 12 * u
    else:
        s = u**3 * (10 - 15 * u + 6 * u * u)
        ds, dds = 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
    return points[k] + step * s, inside * step * ds / length, inside * step * dds / length**2


def _waves(t: Array, waves: Array) -> tuple[Array, Array, Array]:
    """Return sines under a window that rises over the first second and falls in the last."""
    rise = np.clip(t, 0.0, 1.0), np.clip(DURATION - t, 0.0, 1.0)
    window, slope, bend = np.ones((3, len(t))) * [[1.0], [0.0], [0.0]]
    for u, sign in zip(rise, (1.0, -1.0), strict=True):
        s, ds, dds = (
            u**3 * (10 - 15 * u + 6 * u * u),
            30 * u**2 * (1 - u) ** 2,
            60 * u * (1 - u) * (1 - 2 * u),
        )
        slope, bend = (
            slope * s + sign * window * ds,
            bend * s + 2 * sign * slope * ds + (window * dds),
        )
        window = window * s
    q, v, a = np.zeros((3, len(t)))
    for amplitude, rate, phase in waves:
        p = amplitude * np.sin(rate * t + phase)
        dp, ddp = amplitude * rate * np.cos(rate * t + phase), -(rate**2) * p
        q += window * p
        v += slope * p + window * dp
        a += bend * p + 2 * slope * dp + window * ddp
    return q, v, a


def draw(kind: str, limits: JointLimits, rng: np.random.Generator) -> ExcitationMotion:
    """Return a random motion of one kind, within position, speed and acceleration limits.

    Args:
        kind: of `KINDS`.
        limits: of the joints.
        rng: of the motion.

    Raises:
        ParameterError: no such kind.
    """
    if kind not in KINDS:
        raise ParameterError(
            f"excitation must be one of {', '.join(KINDS)}, got {kind!r}"
            f"{did_you_mean(kind, KINDS)}"
        )
    start = rng.uniform(0.35 * limits.low, 0.35 * limits.high)
    times, points, cubic, waves = [], [], [], []
    for j in range(3):
        times.append(np.array([0.0, DURATION]))
        points.append(np.full(2, start[j]))
        cubic.append(False)
        waves.append(np.zeros((0, 3)))
        if kind == "multisine":
            waves[j] = _multisine(rng)
        else:
            times[j], points[j] = _legs(kind, start[j], j, limits, rng)
            cubic[j] = kind == "fast" and bool(rng.random() < 0.3)
    return fitted(ExcitationMotion(times, points, cubic, waves), limits)


def _multisine(rng: np.random.Generator) -> Array:
    count = 6
    rate = 2 * np.pi * 0.1 * rng.choice(np.arange(1, 16), count, replace=False)
    amplitude = rng.uniform(0.15, 0.6, count) / (1 + rate / 3)
    return np.stack([amplitude, rate, rng.uniform(0, 2 * np.pi, count)], axis=-1)


def _legs(
    kind: str, start: float, j: int, limits: JointLimits, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Return way-points with dwells between them."""
    low, high = 0.6 * limits.low[j], 0.6 * limits.high[j]
    share, dwell = {"moves": (0.6, 0.4), "sweeps": (0.25, 0.8), "fast": (0.95, 0.25)}[kind]
    t, q = [0.0, rng.uniform(0.1, 0.4)], [start, start]
    side = 1.0 if rng.random() < 0.5 else -1.0
    while t[-1] < DURATION - 1.2:
        if kind == "sweeps":
            goal = q[-1] + side * rng.uniform(0.15, 0.5)
            side = -side
        else:
            goal = rng.uniform(low, high)
        goal = float(np.clip(goal, low, high))
        distance = abs(goal - q[-1])
        # a quintic peaks at 15/8 of its mean speed and 5.8 of distance over time squared
        slow = 1.875 * distance / (share * limits.speed[j])
        hard = np.sqrt(5.8 * distance / (share * limits.acceleration[j]))
        length = max(float(slow), float(hard), _LEAST)
        if t[-1] + length > DURATION - 0.3:
            break
        t += [t[-1] + length, t[-1] + length + rng.uniform(0.3, 1.0) * dwell]
        q += [goal, goal]
    t.append(max(DURATION, t[-1] + 0.1))
    q.append(q[-1])
    return np.array(t), np.array(q)


def fitted(motion: ExcitationMotion, limits: JointLimits) -> ExcitationMotion:
    """Return the motion, made smaller where it would break a limit.

    Raises:
        ParameterError: no size stays within the limits.
    """
    for _ in range(20):
        s = motion.at(np.linspace(0, DURATION, 4001))
        middle, half = (limits.high + limits.low) / 2, (limits.high - limits.low) / 2
        worst = np.max(
            [
                (np.abs(s.q - middle) / half).max(axis=0),
                (np.abs(s.v) / limits.speed).max(axis=0),
                (np.abs(s.a) / limits.acceleration).max(axis=0),
            ],
            axis=0,
        )
        if (worst <= _MARGIN).all():
            return motion
        motion = motion.scaled(np.where(worst > _MARGIN, 0.8 * _MARGIN / worst + 0.15, 1.0))
    raise ParameterError("excitation: no size of the motion stays within the limits")
