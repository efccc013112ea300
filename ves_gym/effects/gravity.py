"""The estimate of the arm's weight that the emulation goes by."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ves_gym._util.params import ParameterError, Vector
from ves_gym.mechanics.gravity import minimal_model
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register_effect
from ves_gym.system.system import System


class _GravityEffect(LaboratoryEffect):
    """Deviation of the estimate, which only micro-gravity emulation subtracts."""

    port = "gravity"

    def check(self, system: System) -> None:
        super().check(system)
        operation = system.emulator_settings.operation
        self.require(operation == "microgravity", f"operation microgravity, got {operation}")


@register_effect("gravity/delay")
class GravityDelay(_GravityEffect):
    """The gravity estimate is of joints and pose `delay` ago."""

    delay: float = parameter("s", bounds=(0.0, 0.5), start=0.02)

    def edit(self, p: LoopParameters) -> None:
        p.gravity_delay = p.gravity_delay + self.delay


@register_effect("gravity/mass")
class GravityMass(_GravityEffect):
    """The gravity estimate takes the arm for heavier by `error`; its moments are right."""

    error: float = parameter("kg", bounds=(-20.0, 20.0), start=1.0)

    def edit(self, p: LoopParameters) -> None:
        p.gravity_mass = p.gravity_mass + self.error


@register_effect("gravity/moment")
class GravityMoment(_GravityEffect):
    """Errors of the minimal moment parameters, in their order (`minimal_model(arm).names`)."""

    free_length = ("error",)
    error: Vector = parameter("kg m", bounds=(-20.0, 20.0), null=0.0, shape=(None,), start=0.1)

    def check(self, system: System) -> None:
        """One number per parameter of this arm."""
        super().check(system)
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
        p.gravity_P = p.gravity_P + np.array(self.error)


@register_effect("gravity/scale")
class GravityScale(_GravityEffect):
    """The gravity estimate is too large by the fraction `error`, force and moment alike."""

    error: float = parameter("1", bounds=(-0.2, 0.2), start=0.01)

    def edit(self, p: LoopParameters) -> None:
        p.gravity_mass = p.gravity_mass * (1 + self.error)
        p.gravity_P = p.gravity_P * (1 + self.error)


@register_effect("gravity/tilt")
class GravityTilt(_GravityEffect):
    """The pose given to the gravity estimate is turned by `angles` about x, y and z."""

    angles: Vector = parameter("rad", bounds=(-0.1, 0.1), shape=(3,), start=0.01)

    def edit(self, p: LoopParameters) -> None:
        p.gravity_tilt = p.gravity_tilt + np.array(self.angles)


@register_effect("gravity/tool")
class GravityTool(_GravityEffect):
    """The gravity estimate lacks a body on the last link; negative: it has one too many.

    Mass and minimal moment parameters follow from the body's mass and first moment (derived
    here). The arm itself is as described: the tool is there, and the estimate was made without.
    """

    mass: float = parameter("kg", bounds=(-20.0, 20.0), start=1.0)
    moment: Vector = parameter(  # mass x centre, in the last link's frame
        "kg m", bounds=(-10.0, 10.0), shape=(3,), start=0.1
    )

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
        n = p.arm.n
        combination = minimal_model(p.arm).combination
        by_moment, by_mass = combination[:, 3 * n : 3 * n + 3], combination[:, -1]
        mass, moment = np.asarray(self.mass), np.asarray(self.moment)
        missing = np.tensordot(by_moment, moment, 1) + np.multiply.outer(by_mass, mass)
        p.gravity_mass = p.gravity_mass - mass
        p.gravity_P = p.gravity_P - missing
