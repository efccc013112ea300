"""Vehicle: a mode that is not described."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.mechanics.spatial import AXES
from ves_gym.mechanics.vehicle import BaseModel, InternalModes, Oscillator, Satellite
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.effect import BaseEffect, parameter, register
from ves_gym.system.system import System


@register("base/extra_mode")
@dataclass(frozen=True, kw_only=True)
class BaseExtraMode(BaseEffect):
    """The vehicle carries a `mass` on a spring along `direction`, of which nobody knows.

    `frequency` and `damping_ratio` are those of the mass on a vehicle at rest. In the
    laboratory the admittance integrates it (tuned mass: Den Hartog, Mechanical
    Vibrations). The direction is fixed in space: of a satellite that turns by an angle [rad]
    about that share of the mode's force points another way.
    """

    modes = ("ideal", "emulated")
    port = "admittance"
    mass: float = parameter("kg", bounds=(0.0, 500.0), start=2.0)
    frequency: float = parameter(
        "Hz",
        bounds=(0.1, 30.0),
        null=None,
        default=3.0,
        start=tuple(np.geomspace(0.5, 6.0, 20).tolist()),
        search=(0.1, 6.5),  # above it a vehicle's own inner modes begin
    )
    damping_ratio: float = parameter("1", bounds=(0.0, 1.0), null=None, default=0.02)
    direction: Vector = parameter(
        "1", bounds=(-1.0, 1.0), null=None, shape=(3,), default=(1.0, 0.0, 0.0)
    )

    def check(self, system: System) -> None:
        """In the laboratory a satellite is its body alone."""
        if isinstance(system.vehicle, Satellite) and system.mode == "emulated":
            raise ParameterError(
                f"effect {self.kind} acts on a satellite in mode ideal, got mode emulated"
            )
        if not any(self.direction):
            raise ParameterError(
                f"{self.kind}.direction must not be zero, got {self.direction}"
            )

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Along each axis, mass and frequency."""
        numbers = [number_of(cls, "mass"), number_of(cls, "frequency")]
        for axis, way in zip(AXES, np.eye(3).tolist(), strict=False):

            def fields(x: Array, way: Any = tuple(way)) -> dict[str, Any]:
                return {"mass": float(x[0]), "frequency": float(x[1]), "direction": way}

            yield placed(cls, axis, numbers, fields)

    @property
    def oscillator(self) -> Oscillator:
        """The mass on its spring."""
        rate = 2 * np.pi * self.frequency
        way: Array = np.array(self.direction) / np.linalg.norm(self.direction)
        return Oscillator(
            mass=self.mass,
            stiffness=self.mass * rate**2,
            damping=2 * self.damping_ratio * self.mass * rate,
            direction=tuple(way.tolist()),
        )

    def base(self, base: BaseModel) -> BaseModel:
        """One oscillator more."""
        if not self.mass:
            return base
        mode = InternalModes.of((self.oscillator,))
        internal = mode if base.internal is None else base.internal.joined(mode)
        return replace(base, internal=internal)
