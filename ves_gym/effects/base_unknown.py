"""Vehicle: a spring and a damper more, found by a diagnosis, without a name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.mechanics.vehicle import BaseModel, Satellite
from ves_gym.system.effect import BaseEffect, parameter, register
from ves_gym.system.system import System

_FAR = (0.0, 1e9)


@register("base/unknown")
@dataclass(frozen=True, kw_only=True)
class BaseUnknown(BaseEffect):
    """A force -(stiffness Y + damping Y') along each coordinate of the vehicle.

    A diagnosis writes it where something is missing at the base that is not in its library: of
    a joint of the structure that slips this is the equivalent linear law at the amplitudes
    seen (Krylov and Bogoliubov's harmonic balance). Neither is negative, so it never gives
    energy.
    """

    modes = ("ideal", "emulated")
    port = "admittance"
    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    stiffness: Vector = parameter("N/m, N m/rad", bounds=_FAR, shape=(6,), default=(0.0,) * 6)
    damping: Vector = parameter("N s/m, N m s/rad", bounds=_FAR, shape=(6,), default=(0.0,) * 6)

    def check(self, system: System) -> None:
        """Nothing holds a satellite."""
        fits = not isinstance(system.vehicle, Satellite)
        self._require(fits, "a vehicle of M, D, K, got a satellite")

    def base(self, base: BaseModel) -> BaseModel:
        """K and D more on the diagonal."""
        if self.is_null:
            return base
        return replace(
            base, D=base.D + _diagonal(self.damping), K=base.K + _diagonal(self.stiffness)
        )


def _diagonal(x: Vector) -> Array:
    """Numbers (6, ...) on the diagonal of a matrix (6, 6, ...)."""
    numbers: Array = np.array(x)
    ones = np.eye(6).reshape((6, 6) + (1,) * (numbers.ndim - 1))
    return np.asarray(ones * numbers[:, None])
