"""What a straight motion is expected to leave in the base: the measure rewards are taken in."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.maps import pushed_modes, system_function
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.envs.task import Task
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import blocks_of, natural_modes, root
from ves_gym.mechanics.motion import quintic
from ves_gym.system.system import System

_FREQUENCIES = np.geomspace(0.3, 300.0, 240)  # rad/s
_SAMPLES = 2000
_FLOOR = 1e-4  # J: a motion that hardly moves is not divided by nothing
_LEAST = 0.25  # of the median scale: goals close by are no reason to count more
_STARTS = 256  # that the median is taken of
_RIGID = 1.0  # rad/s: a base without stiffness counts as one of this frequency
_STIFF = 300.0  # rad/s: as does one that is stiffer
_FADED = 300.0  # exp(-300) and its reciprocal are numbers
_DAMPINGS = np.array([0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128])  # of the tables


class ModeCouplings(NamedTuple):
    """Modes of k bases, b of each."""

    g: Array  # (k, b, joints) couplings to the joints
    omega: Array  # (k, b) rad/s
    damping: Array  # (k, b) ratios


class BaseModes:
    """Modes of a system's base with the joints locked, for many configurations at once.

    Args:
        system: arm and vehicle.
    """

    def __init__(self, system: System) -> None:
        self.system, (self._mass, D, self._stiffness) = system, system.base.locked().full()
        self._inertia = system_function("inertia_matrix", system)
        self._numbers = parameters(system)[1]
        # columns r of a root of D: the sum of (shape . r)^2 is shape . D shape
        self._root = root(D).T

    def __call__(self, q: Array) -> ModeCouplings:
        """Return the modes at k configurations.

        Args:
            q: (k, joints) [rad].
        """
        n = self.system.arm.n
        H = self._inertia(q, self._numbers).reshape(-1, 6 + n, 6 + n)
        blocks = blocks_of(H, self._mass)
        roots = np.broadcast_to(self._root, (len(q), *self._root.shape))
        vectors = np.concatenate([blocks.Hbm, roots], axis=2)
        omega, pushes = pushed_modes(self._stiffness, blocks.Mt, vectors)
        omega = np.clip(omega, _RIGID, _STIFF)
        ratio = (pushes[..., n:] ** 2).sum(axis=-1) / (2 * omega)
        return ModeCouplings(
            pushes[..., :n], omega, np.clip(ratio, _DAMPINGS[0], _DAMPINGS[-1])
        )

    def __reduce__(self) -> tuple[type[BaseModes], tuple[System]]:
        return BaseModes, (self.system,)  # machine code is no part of a copy


class straight_energy:  # a function with a table
    """E_mean of the straight quintic, its modes frozen at the middle of the way [J].

    A mode of frequency w takes the energy f(w) (g . dq)^2 from a straight motion dq, g its
    coupling to the joints; f is tabulated once per duration. Within a factor of about two of
    the simulated value (tests/envs/test_scales.py), which is what a scale needs.

    Args:
        system: arm and vehicle.
        duration: of the motion [s].
        tail: free vibration afterwards that counts [s].
    """

    def __init__(self, system: System, duration: float, tail: float) -> None:
        self._modes = BaseModes(system)
        self._tables = [_response(duration, tail, ratio) for ratio in _DAMPINGS.tolist()]

    def __call__(self, start: Array, goal: Array) -> Array:
        """(k, joints) ends -> (k,) [J]."""
        g, omega, damping = self._modes((start + goal) / 2)
        push = (g @ (goal - start)[..., None])[..., 0]
        shares = [np.interp(np.log(omega), np.log(_FREQUENCIES), f) for f in self._tables]
        table = np.stack(shares)
        # linear in the logarithm of the damping
        at = np.log(damping / _DAMPINGS[0]) / np.log(_DAMPINGS[1] / _DAMPINGS[0])
        low = np.minimum(at.astype(int), len(shares) - 2)
        below, above = (np.take_along_axis(table, k[None], 0)[0] for k in (low, low + 1))
        share = below + (at - low) * (above - below)
        return np.asarray(_FLOOR + (share * push**2).sum(axis=1), dtype=np.float64)


def straight_motion(task: Task, seconds: float) -> straight_energy:
    """Return the scale of a task's straight motions, which leave the base free until its end.

    Args:
        task: whose system in space, end and tail it is.
        seconds: that a motion takes [s].
    """
    after = task.duration - seconds + task.tail
    return straight_energy(task.system.ideal(), seconds, after)


def least_scale(expected: Callable[[Array], Array], draws: int) -> float:
    """Return the smallest energy that counts as one: a quarter of the median over starts [J].

    Args:
        expected: energies (k,) [J] of episodes from uniform numbers (k, draws).
        draws: numbers per episode.
    """
    ordered = np.sort(expected(np.random.default_rng(0).random((_STARTS, draws))))
    # np.median would load masked arrays
    return _LEAST * float(ordered[(_STARTS - 1) // 2] + ordered[_STARTS // 2]) / 2


def motion_energy(modes: BaseModes, q: Array, dt: float, tail: float) -> Array:
    """E_mean of joint motions from rest, base modes frozen at their middle [J].

    Args:
        modes: of the system.
        q: (k, m, joints) angles along the motions, dt apart.
        tail: s of free vibration afterwards that count.
    """
    g, omega, damping = modes((q.min(axis=1) + q.max(axis=1)) / 2)
    push = np.einsum("kij,kmj->kmi", g, np.diff(q, n=2, axis=1)) / dt**2
    pole = omega * (-damping + 1j * np.sqrt(1 - damping**2))
    # x' - conj(pole) x = sum over the past of exp(pole (t - t')) push, in parts whose
    # exponentials are numbers still
    part = max(1, int(_FADED / (dt * np.max(-pole.real))))
    time = dt * np.arange(1, min(part, push.shape[1]) + 1)[:, None]
    fading = np.exp(pole[:, None] * time)
    gain = (np.exp(pole * dt) - 1) / pole
    state = np.empty(push.shape, complex)
    last = np.zeros(pole.shape, complex)
    for first in range(0, push.shape[1], part):
        chunk = push[:, first : first + part]
        fade = fading[:, : chunk.shape[1]]
        done = fade * (last[:, None] - gain[:, None] * np.cumsum(chunk / fade, axis=1))
        state[:, first : first + part] = done
        last = done[:, -1]
    x = state.imag / pole.imag[:, None]
    energy = ((state.real + pole.real[:, None] * x) ** 2 + (omega[:, None] * x) ** 2) / 2
    decay = 2 * damping * omega
    remainder = energy[:, -1] * -np.expm1(-decay * tail) / decay
    mean = (energy.sum(axis=1) * dt + remainder) / (dt * push.shape[1] + tail)
    return np.asarray(_FLOOR + mean.sum(axis=1), dtype=np.float64)


def released_energy(system: System, q: Array, y: Array, duration: float) -> Array:
    """Return the integral of the strain energy of released bases, joints locked [J s].

    Linear and in closed form: a mode of frequency w and damping ratio z, from rest at x_0, is
    x_0 Re(c exp(p t)) with p = w (-z + i r), c = 1 - i z / r, r = sqrt(1 - z^2); its strain
    energy is w^2 x^2 / 2. What damping couples of two modes is left out.

    Args:
        system: arm and vehicle.
        q: (k, joints) angles [rad].
        y: (k, 6) pose of the base at the release [m, rad]; internal modes follow it at rest.
        duration: of the integral [s].
    """
    base = system.base
    M, D, K = base.locked().full()
    Mt = blocks_of(inertia(system.arm, q), M).Mt
    omega, shapes = natural_modes(K, Mt)
    shift = np.concatenate([y, base.attached(y)], axis=1)
    x = ((Mt @ shift[..., None]).swapaxes(-1, -2) @ shapes)[..., 0, :]
    z = np.clip((shapes * (D @ shapes)).sum(axis=-2) / (2 * omega), 1e-6, 0.99)
    r = np.sqrt(1 - z * z)
    pole, c = omega * (-z + 1j * r), 1 - 1j * z / r
    swing = (c * c * np.expm1(2 * pole * duration) / (2 * pole)).real
    fall = np.abs(c) ** 2 * np.expm1(2 * pole.real * duration) / (2 * pole.real)
    return np.asarray(((omega * x) ** 2 * (swing + fall) / 4).sum(axis=1), dtype=np.float64)


@lru_cache(maxsize=256)  # alike in all environments of a task, and most of making one
def _response(duration: float, tail: float, z: float) -> Array:
    """Mean energy of oscillators x'' + 2 z w x' + w^2 x = -s''(t), s the quintic law."""
    t = np.linspace(0.0, duration + tail, _SAMPLES)
    dt = t[1] - t[0]
    rate = np.gradient(quintic(t / duration), dt)
    a = np.gradient(rate, dt)
    w = _FREQUENCIES
    pole = w * (-z + 1j * np.sqrt(1 - z * z))
    carry = np.exp(pole * dt)
    gain = (carry - 1) / pole
    state = np.zeros(len(w), complex)  # x' - conj(pole) x
    total = np.zeros(len(w))
    for push in (a[1:] + a[:-1]) / 2:
        state = carry * state - gain * push
        x = state.imag / pole.imag
        rate_x = state.real + pole.real * x
        total += (rate_x**2 + (w * x) ** 2) / 2
    out = np.asarray(total / len(t), dtype=np.float64)
    out.setflags(write=False)
    return out
