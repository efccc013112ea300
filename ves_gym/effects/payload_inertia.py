"""Payload compensation: wrong inertia of the arm."""

from __future__ import annotations

from dataclasses import dataclass

from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("payload/inertia")
@dataclass(frozen=True, kw_only=True)
class PayloadInertia(LaboratoryEffect):
    """The compensation takes the arm's inertia for larger by the fraction `error`."""

    port = "admittance"
    error: float = parameter("1", bounds=(-0.9, 2.0), start=0.05)

    def check(self, system: System) -> None:
        """Only a compensated loop has a model of the arm's inertia."""
        self._require(system.emulator_settings.payload_compensation, "payload_compensation")

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        p.payload_scale = p.payload_scale + self.error
