"""Gravity estimate: the tool's weight is missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Vector
from ves_gym.mechanics.gravity import minimal_model
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register
from ves_gym.system.system import System


@register("gravity/tool")
@dataclass(frozen=True, kw_only=True)
class GravityTool(LaboratoryEffect):
    """The gravity estimate lacks a body on the last link; negative: it has one too many.

    Mass and minimal moment parameters follow from the body's mass and first moment (derived
    here). The arm itself is as described: the tool is there, and the estimate was made without.
    """

    port = "gravity"
    mass: float = parameter("kg", bounds=(-20.0, 20.0), start=1.0)
    moment: Vector = parameter(  # mass x centre, in the last link's frame
        "kg m", bounds=(-10.0, 10.0), shape=(3,), start=0.1
    )

    def check(self, system: System) -> None:
        """Only micro-gravity emulation subtracts an estimate."""
        operation = system.emulator_settings.operation
        self._require(operation == "microgravity", f"operation microgravity, got {operation}")

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Mass and moment together; a moment of about zero costs nothing."""
        numbers = [
            number_of(cls, "mass"),
            *(number_of(cls, "moment", f"moment_{axis}") for axis in "xyz"),
        ]
        yield placed(
            cls,
            "",
            numbers,
            lambda x: {"mass": float(x[0]), "moment": tuple(x[1:].tolist())},
            sparse=True,
        )

    def edit(self, p: LoopParameters) -> None:
        """Add the deviation to the machine's parameters."""
        n = p.arm.n
        combination = minimal_model(p.arm).combination
        by_moment, by_mass = combination[:, 3 * n : 3 * n + 3], combination[:, -1]
        mass, moment = np.asarray(self.mass), np.asarray(self.moment)
        missing = np.tensordot(by_moment, moment, 1) + np.multiply.outer(by_mass, mass)
        p.gravity_mass = p.gravity_mass - mass
        p.gravity_P = p.gravity_P - missing
