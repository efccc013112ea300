"""The straight line: by a quintic, by a smoother law, and with input shaping.

A shaped motion is the straight line's law split among impulses so placed that a mode they
leave swinging is left at rest (zero vibration, ZV; with zero slope in frequency, ZVD: Singer
and Seering 1990). Its motion lasts as long as the query allows, the law the less for it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.paths import septic
from ves_gym.planners.prediction import LinearBase, modal_energies, spectral_energy
from ves_gym.planners.query import Query, first_violation
from ves_gym.system.system import System

_SAMPLES = 2001
_CONTROLS = 96  # of the fitted motion: follows a shaped law to about 1e-4 of the way


class Straight:
    """Straight joint line, quintic rest to rest: what others are compared with."""

    name = "straight"
    summary = "straight joint line, quintic time law"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Return the straight quintic; deterministic."""
        return query.straight, {}


class SmoothJerk:
    """Straight joint line with a law whose jerk, too, begins and ends at zero."""

    name = "smooth-jerk"
    summary = "straight joint line, seventh-order law: no jerk at the ends"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Pass the straight line by the septic law; deterministic."""
        return _along(query, septic(np.linspace(0, 1, _SAMPLES))), {}


class Shaped:
    """Straight joint line, its quintic shaped for the modes it would excite most."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.name = f"shaped-{kind}"
        self.summary = f"straight joint line, quintic law, {kind.upper()} input shaping"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Shape for modes, that of most energy after the straight line first; deterministic.

        For those only that there is time for, inside the query's limits, and that leave less
        energy in all: a shorter law excites the others more.
        """
        chosen: list[ExcitedMode] = []
        motion, times, sizes = query.straight, np.zeros(1), np.ones(1)
        least = spectral_energy(query.system, motion)
        for mode in excited_modes(query.system, query.straight):
            impulses = shaper(self.kind, mode)
            t = np.add.outer(times, impulses.times).ravel()
            a = np.multiply.outer(sizes, impulses.sizes).ravel()
            if t[-1] >= query.duration:
                continue
            shaped = shaped_motion(query, Shaper(t, a))
            energy = spectral_energy(query.system, shaped)
            if energy < least and first_violation(query, shaped) is None:
                chosen.append(mode)
                motion, times, sizes, least = shaped, t, a, energy
        return motion, {
            "shaped_hz": [mode.frequency / (2 * np.pi) for mode in chosen],
            "delay": float(times.max()),
        }


class ExcitedMode(NamedTuple):
    """A damped mode of the base with the joints locked."""

    frequency: float  # undamped, rad/s
    damping: float  # ratio
    energy: float  # J that a motion leaves in it, undamped


class Shaper(NamedTuple):
    """Impulses to convolve a reference with."""

    times: Array  # (k,) s, from zero
    sizes: Array  # (k,) of sum one


def shaper(kind: str, mode: ExcitedMode) -> Shaper:
    """Singer and Seering's impulses for one mode, `kind` zv or zvd."""
    damping = min(mode.damping, 0.9)
    root = np.sqrt(1 - damping**2)
    half = np.pi / (mode.frequency * root)
    K = float(np.exp(-damping * np.pi / root))
    sizes = np.array([1.0, K] if kind == "zv" else [1.0, 2 * K, K**2])
    return Shaper(half * np.arange(len(sizes)), sizes / sizes.sum())


def shaped_motion(query: Query, shape: Shaper) -> Motion:
    """The straight line by a quintic of what time the impulses leave, shaped."""
    t = np.linspace(0, query.duration, _SAMPLES)
    length = query.duration - shape.times.max()
    parts = quintic((t[:, None] - shape.times) / length)
    return _along(query, parts @ shape.sizes)


def excited_modes(system: System, motion: Motion) -> list[ExcitedMode]:
    """Modes of the base at the middle of a motion, those that it excites most first."""
    linear = LinearBase(system, start=motion.start)
    frozen, energy = modal_energies(system, motion, _SAMPLES)
    M = linear.mass(linear.inertia(motion.at(motion.duration / 2).q))
    damping = _damping(M, linear.D, linear.K, frozen.omega)
    numbers = zip(frozen.omega.tolist(), damping.tolist(), energy.tolist(), strict=True)
    return sorted((ExcitedMode(*k) for k in numbers if k[0] > 0), key=lambda mode: -mode.energy)


def _damping(M: Array, D: Array, K: Array, omega: Array) -> Array:
    """Damping ratios of the poles nearest to each undamped frequency."""
    size = len(M)
    A = np.zeros((2 * size, 2 * size))
    A[:size, size:] = np.eye(size)
    A[size:] = -scipy.linalg.solve(M, np.hstack([K, D]), assume_a="pos")
    poles = np.linalg.eigvals(A)
    nearest = [int(np.abs(np.abs(poles) - w).argmin()) for w in omega]
    return np.array([-poles[k].real / max(abs(poles[k]), 1e-300) for k in nearest])


def _along(query: Query, s: Array) -> Motion:
    """The straight line passed as s says, at even times."""
    start, goal = query.ends
    q = start + s[:, None] * (goal - start)
    q[0], q[-1] = start, goal
    return Motion.fit(q, query.duration, controls=_CONTROLS)
