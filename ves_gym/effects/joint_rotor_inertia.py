"""Joint drive: rotor inertia other than described."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from ves_gym._util.params import ParameterError, Vector
from ves_gym.mechanics.arm import Arm
from ves_gym.system.candidate import Candidate, Scope
from ves_gym.system.effect import ArmEffect, parameter, register
from ves_gym.system.system import System


@register("joint/rotor_inertia")
@dataclass(frozen=True, kw_only=True)
class JointRotorInertia(ArmEffect):
    """The rotors, seen through their gears, have `added` more inertia than described.

    Felt by the joint and not by the base, other than a link's (Armstrong, Khatib, Burdick
    1986); of a single link on a resting base the two look alike.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    shows = ("joint",)
    added: Vector = parameter("kg m^2", bounds=(-0.8, 20.0), shape=(None,), start=0.3)

    def check(self, system: System) -> None:
        """One number per joint, on motors, and none that leaves less than no rotor."""
        self._require_per_joint(system, "added")
        self._require_motor(system)
        for i, (link, added) in enumerate(zip(system.arm.links, self.added, strict=True)):
            if link.rotor_inertia + added < 0:
                raise ParameterError(
                    f"{self.kind}.added of joint {i + 1} must be >= -{link.rotor_inertia:g}"
                    f" kg m^2, the rotor's own, got {added:g}"
                )

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """See `Effect`; no less than no rotor."""
        for joint, candidate in enumerate(super().candidates(scope)):
            if scope.system is None:
                yield candidate
            else:
                rotor = scope.system.arm.links[joint].rotor_inertia
                yield replace(candidate, low=(max(candidate.low[0], -rotor),))

    def arm(self, arm: Arm) -> Arm:
        """Rotor inertia + added."""
        if self.is_null:
            return arm
        links = (
            replace(link, rotor_inertia=link.rotor_inertia + added)
            for link, added in zip(arm.links, self.added, strict=True)
        )
        return replace(arm, links=tuple(links))
