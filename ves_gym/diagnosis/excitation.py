"""Motions that show what a diagnosis asks for: every joint reversing, resting, slow and fast.

Friction shows at reversals and at rest, viscous friction and delays at speed, inertia and
ripple over the range. Random motions that mix all of these are drawn, brought inside the
limits of the joints, and chosen greedily by the information that their torques carry on the
inertial and friction numbers of the arm (D-optimality; Swevers et al., IEEE Transactions on
Robotics and Automation 13(5), 1997).
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array, ParameterError, integer
from ves_gym.engine.kernel.maps import inertia_regressor
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.limits import limit_ratios
from ves_gym.mechanics.motion import Motion, quintic

_MARGIN = 0.9  # of every limit
_TEMPI = (0.2, 0.45, 0.8)  # of the speed limit, in turn along a motion
_REST = (0.15, 0.5)  # s between two moves
_SPANS = (0.6, 2.5)  # s, of a move
_BRISK, _BRISK_SPANS = (0.9,), (0.15, 0.6)  # tempo and spans of moves that bring out torque
_PUSH, _BRISK_PUSH = 0.6, 0.9  # of the joint's largest acceleration
_CONTROLS, _BRISK_CONTROLS = 8, 16  # of a motion, per second
_REACH = 0.6  # of the joint's range that way-points are drawn from
_STICTION = 0.05  # rad/s over which the column of Coulomb friction changes sign
_HARMONICS, _LOWEST = 6, (0.08, 0.35)  # of a Fourier series, and its lowest frequency [Hz]
_FADE = 1.0  # s in which it begins and ends


def excitation_motions(
    n: int, arm: Arm = PUMA_560, *, duration: float = 10.0, seed: int = 0
) -> list[Motion]:
    """Return n motions whose logs can tell the effects of the library apart.

    Args:
        n: how many; four are enough for one or two effects, a third of them held back.
        arm: whose limits of position, speed, acceleration and torque hold.
        duration: of each [s].
        seed: of the draw.

    Returns:
        Motions from rest to rest, each of its own start and goal.

    Raises:
        ParameterError: n or the duration is out of range.
    """
    n = integer(n, "n", 1)
    if not 2.0 <= duration <= 600.0:
        raise ParameterError(f"duration must be from 2 to 600 s, got {duration!r}")
    rng = np.random.default_rng(integer(seed, "seed"))
    drawn = [drawn_motion(arm, duration, rng) for _ in range(6 * n)]
    rows = [_information_rows(arm, motion) for motion in drawn]
    size = np.sqrt(np.mean([np.mean(y**2, axis=0) for y in rows], axis=0))
    rows = [y[:, size > 0] / size[size > 0] for y in rows]
    total = 1e-6 * np.eye(rows[0].shape[1])
    chosen: list[Motion] = []
    remaining = list(range(len(drawn)))
    for _ in range(n):
        gains = [
            np.linalg.slogdet(total + rows[k].T @ rows[k] / len(rows[k]))[1] for k in remaining
        ]
        k = remaining.pop(int(np.argmax(gains)))
        total = total + rows[k].T @ rows[k] / len(rows[k])
        chosen.append(drawn[k])
    return chosen


def drawn_motion(
    arm: Arm, duration: float, rng: np.random.Generator, brisk: bool = False
) -> Motion:
    """Draw one sequence of moves and rests in duration s inside 0.9 of all limits.

    Where it is `brisk` moves are short and as sharp as the joints allow: they bring out the
    motors' limits.
    """
    t = _clock(duration)
    q = np.stack([_moves(arm, j, t, rng, brisk) for j in range(arm.n)], axis=1)
    return within_limits(arm, q, duration, _BRISK_CONTROLS if brisk else _CONTROLS)


def drawn_series(arm: Arm, duration: float, rng: np.random.Generator) -> Motion:
    """Draw a Fourier series per joint inside 0.9 of all limits, from rest to rest."""
    t, half = _clock(duration), (arm.column("q_max") - arm.column("q_min")) / 2
    middle = (arm.column("q_min") + arm.column("q_max")) / 2
    lowest = rng.uniform(*_LOWEST)
    w = 2 * np.pi * lowest * (1 + np.arange(_HARMONICS))
    speed = rng.uniform(0.2, 1.0) * arm.column("v_max") / np.sqrt(_HARMONICS)
    a, b = rng.standard_normal((2, _HARMONICS, arm.n)) * speed / w[:, None]
    phase = w * t[:, None]
    window = quintic(t / _FADE) * quintic((duration - t) / _FADE)
    q = window[:, None] * (np.sin(phase) @ a + np.cos(phase) @ b)
    return within_limits(arm, middle + rng.uniform(-0.5, 0.5, arm.n) * half + q, duration)


def _clock(duration: float) -> Array:
    return np.linspace(0.0, duration, round(40 * duration) + 1)


def within_limits(
    arm: Arm, q: Array, duration: float, controls_per_second: int = _CONTROLS
) -> Motion:
    """Return the motion through angles (N, n), made smaller until it keeps 0.9 of all limits.

    Raises:
        ParameterError: no size keeps them.
    """
    controls = max(12, round(controls_per_second * duration))
    for _ in range(60):
        motion = Motion.fit(q, duration, controls=controls)
        ratios = limit_ratios(arm, motion, samples=round(80 * duration) + 1)
        worst = np.max(list(ratios.values()), axis=0)
        if (worst <= _MARGIN).all():
            return motion
        middle = (arm.column("q_min") + arm.column("q_max")) / 2
        excess = np.where(worst > _MARGIN, np.maximum(0.97 * _MARGIN / worst, 0.8), 1.0)
        # rates are what is in the way, seldom the place: shrink about where the joint is
        centre = np.where(ratios["position"] > _MARGIN, middle, q.mean(axis=0))
        q = centre + (q - centre) * excess
    raise ParameterError(f"{arm.name} allows no excitation of {duration:g} s within its limits")


def _moves(arm: Arm, j: int, t: Array, rng: np.random.Generator, brisk: bool = False) -> Array:
    """Draw angles (N,) [rad] of a joint: moves of changing tempo with rests between them."""
    tempi, push = (_BRISK, _BRISK_PUSH) if brisk else (_TEMPI, _PUSH)
    shortest, most_span = _BRISK_SPANS if brisk else _SPANS
    link = arm.links[j]
    middle, half = (link.q_min + link.q_max) / 2, (link.q_max - link.q_min) / 2
    place = middle + _REACH * half * rng.uniform(-1, 1)
    out = np.full(len(t), place)
    clock, k = rng.uniform(*_REST), int(rng.integers(len(tempi)))
    while (room := t[-1] - _REST[0] - clock) > shortest:
        goal = middle + _REACH * half * rng.uniform(-1, 1)
        longest = rng.uniform(shortest, min(room, most_span))
        speed = tempi[k % len(tempi)] * link.v_max
        # a quintic peaks at 15/8 of its mean speed and 5.8 of distance over time squared
        most = min(longest * speed / 1.875, longest**2 * push * link.a_max / 5.8)
        step = np.clip(goal - place, -most, most)
        # at the same speed, what is short is sharper; a brisk one is as sharp as it may be
        span = longest if brisk else longest * abs(step) / most
        out += step * quintic((t - clock) / span)
        place, k = place + step, k + 1
        clock += span + rng.uniform(*_REST)
    return out


def _information_rows(arm: Arm, motion: Motion) -> Array:
    """Torque per number, in parts of the torque limits: (samples x joints, numbers)."""
    s = motion.at(np.linspace(0.0, motion.duration, 101))
    inertial = inertia_regressor(arm, s.q, s.v, s.a)[:, 6:]
    eye = np.eye(arm.n)
    friction = [eye * x[:, None, :] for x in (np.tanh(s.v / _STICTION), s.v, np.ones_like(s.v))]
    rows = np.concatenate([inertial, *friction], axis=2) / arm.column("tau_max")[:, None]
    return np.asarray(rows.reshape(-1, rows.shape[2]), dtype=np.float64)
