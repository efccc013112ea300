"""Noise of a measured pose, taken out of what it spoils by what other sensors say of it.

A pose differentiated twice has a noise of its own in w^2: 0.2 mm are 1 m/s^2 at 12 Hz, and
under an arm of 90 kg nearly 50 N, where the force sensor reads to half a newton. The same
noise shows at two ports in different ways. With e the residual of one port, n its part that
the pose makes, and r that of another port, the best linear estimate of n from r (Wiener)
is taken off e:

- at port `joint` by the residual of port `wrench`, e = tau - H_bj^T a and r = w + H_bb a: the
  force sensor and the arm as described say how the base accelerates;
- at port `wrench` by the residual of port `base`, r = F - G y with G = K + i w D - w^2 M: the
  base as described says which accelerations can be.

The estimate is linear in r, so an error of the base shows at port `wrench`, too. Where a pose
is more exact than the force sensor its weights are zero.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym._util.signals import noise_power
from ves_gym.diagnosis.data.measured_run import Run, cached
from ves_gym.diagnosis.machines.arm_load import bodies_of
from ves_gym.diagnosis.machines.vehicle_force import dynamic_stiffness
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import matvec, rate_matrix
from ves_gym.mechanics.vehicle import BaseModel

_BEYOND = 1.5  # of the band: up to there an estimate is taken off


class PoseNoise:
    """Effect of the noise of a measured pose at the ports, estimated from other residuals.

    Weights are those of the arm and base that are tried: with others' more noise would be left,
    and a fit would keep to the description because of that alone.

    Args:
        run: with q, y and w.
        floor: (6,) standard deviation below which a residual in w means nothing [N, N m].
    """

    def __init__(self, run: Run, floor: Array) -> None:
        self._q = run["q"].reshape(-1, run.length, run["q"].shape[-1])[0]
        self._turn = rate_matrix(run.base.x.reshape(-1, run.length, 6)[0])
        self._size, self._skip = run.length, run.window.skip
        f = np.asarray(np.fft.rfftfreq(run.length, run.dt), float)
        self._w = w = 2 * np.pi * f
        top = 2 * np.pi * run.band
        fade = np.clip((_BEYOND * top - w) / ((_BEYOND - 1) * top), 0.0, 1.0)
        self._low = np.sin(np.pi / 2 * fade)[:, None, None] ** 2
        self._pose = noise_power(run.noise["y"], f, run.dt)  # (K, 6)
        self._wrench = noise_power(run.noise["w"], f, run.dt) + floor**2
        self._memory: dict[Any, Any] = {}

    def in_torque(self, arm: Arm, wrench: Array) -> Array:
        """Return what the pose's noise does to the torque that a motion takes (..., T, n).

        Args:
            arm: as it is thought to be.
            wrench: (..., T, 6) residual at port `wrench` of this arm.
        """
        _, to_torque, weights = self._of_arm(arm)
        return matvec(to_torque, -self._filtered(weights, wrench))

    def in_wrench(self, arm: Arm, key: Hashable, base: BaseModel, force: Array) -> Array:
        """Return what the pose's noise does to the residual at port `wrench` (..., T, 6).

        Args:
            arm: as it is thought to be.
            key: of the base, by which its weights are remembered.
            base: as it is thought to be.
            force: (..., T, 6) residual at port `base` of this base.
        """
        weights = cached(self._memory, "bases", key, lambda: self._of_base(base))
        return matvec(self._of_arm(arm)[0], self._filtered(weights, force))

    def _of_arm(self, arm: Arm) -> tuple[Array, Array, Array]:
        """Wrench per acceleration (T, 6, 6), torque per wrench (T, n, 6), weights (K, 6, 6)."""

        def make() -> tuple[Array, Array, Array]:
            H = inertia(arm, self._q)
            mass, push = H[:, :6, :6] @ self._turn, np.swapaxes(H[:, :6, 6:], -1, -2)
            middle = mass.mean(axis=0)  # e = n_w - w^2 mass n_y
            visible = np.einsum("k,ij,kj,lj->kil", self._w**4, middle, self._pose, middle)
            weights = self._low * visible @ np.linalg.inv(visible + _diagonal(self._wrench))
            return mass, push @ np.linalg.inv(H[:, :6, :6]), weights

        # rotors and gears are in no block that is taken here
        return cached(self._memory, "arms", bodies_of(arm), make)

    def _of_base(self, base: BaseModel) -> Array:
        """Weights (K, 6, 6) that make accelerations of r = turn^T n_w - G n_y."""
        lever = self._turn.mean(axis=0)
        G = dynamic_stiffness(base, lever, self._w)
        across = self._pose[:, :, None] * np.conj(np.swapaxes(G, -1, -2))
        covariance = G @ across + lever.T @ _diagonal(self._wrench) @ lever
        size = np.sqrt(np.abs(np.einsum("kii->ki", covariance)))  # newtons beside newton metres
        inner = covariance / size[:, :, None] / size[:, None, :]
        inverse = np.linalg.inv(inner) / size[:, :, None] / size[:, None, :]
        return np.asarray(self._low * self._w[:, None, None] ** 2 * across @ inverse)

    def _filtered(self, weights: Array, x: Array) -> Array:
        """A residual (..., T, 6) through weights (K, 6, 6); its ends are guessed, and fade."""
        ramp = np.clip(np.arange(self._size) / max(self._skip, 1) - 0.5, 0.0, 1.0)
        ends = np.sin(np.pi / 2 * ramp) ** 2
        spectrum = np.fft.rfft(x * (ends * ends[::-1])[:, None], axis=-2)
        weighted = np.einsum("kij,...kj->...ki", weights, spectrum)
        return np.asarray(np.fft.irfft(weighted, self._size, axis=-2))


def pose_noise(run: Run, floor: Callable[[], Array]) -> PoseNoise:
    """Return the estimates for a run; for its noisy copies those of the run itself.

    Args:
        run: with q, y and w.
        floor: computes that of port `wrench` (6,) [N, N m].
    """
    signals = ("q", "y", "w")
    return run.derived("pose noise", signals, lambda: PoseNoise(run, floor()), near=True)


def _diagonal(x: Array) -> Array:
    return np.asarray(x[:, :, None] * np.eye(x.shape[-1]))
