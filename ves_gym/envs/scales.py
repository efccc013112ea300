"""What a straight motion is expected to leave in the base: the measure rewards are taken in."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.kernel.maps import InertiaMap
from ves_gym.engine.kernel.modes import ModeMap
from ves_gym.mechanics.modes import blocks_of
from ves_gym.mechanics.motion import quintic
from ves_gym.system.system import System

_FREQUENCIES = np.geomspace(0.3, 300.0, 240)  # rad/s
_SAMPLES = 2000
_FLOOR = 1e-4  # J: a motion that hardly moves is not divided by nothing
_RIGID = 1.0  # rad/s: a base without stiffness counts as one of this frequency
_STIFF = 300.0  # rad/s: as does one that is stiffer
_DAMPING = 0.05  # ratio of the modes, that of the thesis's beams


class BaseModes:
    """Modes of a system's base with the joints locked, for many configurations at once.

    Args:
        system: arm and vehicle.
    """

    def __init__(self, system: System) -> None:
        self.system, self._room = system, 0

    def __call__(self, q: Array) -> tuple[Array, Array]:
        """Couplings (k, b, joints) of the b modes to the joints, their frequencies (k, b).

        Args:
            q: (k, joints) [rad].
        """
        if len(q) > self._room:
            self._room = len(q)
            self._inertia = InertiaMap(self.system, self._room)
            self._mass, _, K = self.system.base.full()
            self._modes = ModeMap(K, self.system.arm.n, self._room)
        blocks = blocks_of(self._inertia(q), self._mass)
        omega, g = self._modes(blocks.Mt, blocks.Hbm)
        return g, np.clip(omega, _RIGID, _STIFF)

    def __reduce__(self) -> tuple[type[BaseModes], tuple[System]]:
        return BaseModes, (self.system,)  # machine code is no part of a copy


class straight_energy:  # a function with a table
    """E_mean of the straight quintic, its modes frozen at the middle of the way [J].

    A mode of frequency w takes the energy f(w) (g . dq)^2 from a straight motion dq, g its
    coupling to the joints; f is tabulated once per duration. Within a factor of about two of
    the simulated value (tests/envs/test_scales.py), which is what a scale needs.
    """

    def __init__(self, system: System, duration: float, tail: float) -> None:
        self._modes = BaseModes(system)
        self._table = _response(duration, tail)

    def __call__(self, start: Array, goal: Array) -> Array:
        """(k, joints) ends -> (k,) [J]."""
        g, omega = self._modes((start + goal) / 2)
        push = (g @ (goal - start)[..., None])[..., 0]
        share = np.interp(np.log(omega), np.log(_FREQUENCIES), self._table)
        return np.asarray(_FLOOR + (share * push**2).sum(axis=1), dtype=np.float64)


def motion_energy(modes: BaseModes, q: Array, dt: float, tail: float) -> Array:
    """E_mean of joint motions from rest, base modes frozen at their middle [J].

    Args:
        modes: of the system.
        q: (k, m, joints) angles along the motions, dt apart.
        tail: s of free vibration afterwards that count.
    """
    g, omega = modes((q.min(axis=1) + q.max(axis=1)) / 2)
    push = np.einsum("kij,kmj->kmi", g, np.diff(q, n=2, axis=1)) / dt**2
    pole = omega * (-_DAMPING + 1j * np.sqrt(1 - _DAMPING**2))
    time = dt * np.arange(1, push.shape[1] + 1)[:, None]
    # x' - conj(pole) x = sum over the past of exp(pole (t - t')) push
    fading = np.exp(pole[:, None] * time)
    gain = (np.exp(pole * dt) - 1) / pole
    state = -gain[:, None] * fading * np.cumsum(push / fading, axis=1)
    x = state.imag / pole.imag[:, None]
    energy = ((state.real + pole.real[:, None] * x) ** 2 + (omega[:, None] * x) ** 2) / 2
    decay = 2 * _DAMPING * omega
    remainder = energy[:, -1] * -np.expm1(-decay * tail) / decay
    mean = (energy.sum(axis=1) * dt + remainder) / (dt * push.shape[1] + tail)
    return np.asarray(_FLOOR + mean.sum(axis=1), dtype=np.float64)


def _response(duration: float, tail: float) -> Array:
    """Mean energy of oscillators x'' + 2 z w x' + w^2 x = -s''(t), s the quintic law."""
    t = np.linspace(0.0, duration + tail, _SAMPLES)
    dt = t[1] - t[0]
    rate = np.gradient(quintic(t / duration), dt)
    a = np.gradient(rate, dt)
    w, z = _FREQUENCIES, _DAMPING
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
    return np.asarray(total / len(t), dtype=np.float64)
