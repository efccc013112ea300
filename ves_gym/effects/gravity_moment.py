"""Gravity estimate: wrong moment parameters P (thesis eq. 3.9)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.mechanics.gravity import minimal_model
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/moment")
@dataclass(frozen=True, kw_only=True)
class GravityMoment(LaboratoryEffect):
    """Errors of the minimal moment parameters, in their order (`minimal_model(arm).names`)."""

    port = "gravity"
    error: Vector = parameter("kg m", bounds=(-20.0, 20.0), null=0.0, shape=(None,), start=0.1)

    def check(self, system: System) -> None:
        """One number per parameter of this arm; only micro-gravity subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")
        arm, size = system.arm, minimal_model(system.arm).size
        if len(self.error) != size:
            raise ParameterError(
                f"{self.kind}.error must be {size} numbers for {arm.name},"
                f" got {len(self.error)}"
            )

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """All parameters of the described arm together; most are right."""
        if scope.system is None:
            return
        names = minimal_model(scope.system.arm).names
        numbers = [number_of(cls, "error", name) for name in names]
        yield placed(cls, "", numbers, lambda x: {"error": tuple(x.tolist())}, sparse=True)

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.gravity_P = p.gravity_P + np.array(self.error)
