"""Joint drive: an elastic gear."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ves_gym._util.params import Vector
from ves_gym.mechanics.arm import Arm, Gear
from ves_gym.system.effect import ArmEffect, parameter, register
from ves_gym.system.system import System

HARD = 0.01  # rad: wound up so far, a spring that hardens takes twice what it did


def _hardened(effect: JointElasticity) -> Hardened:
    """Return a gear whose spring hardens; a fit may have any share of it."""
    return Hardened(compliance=effect.compliance, damping=effect.damping)


@register("joint/elasticity")
@dataclass(frozen=True, kw_only=True)
class JointElasticity(ArmEffect):
    """A spring of `compliance`, with a damper beside it, between rotor and link.

    Servo and log are on the rotor's side. A joint of compliance 0 stays rigid, its damping
    without meaning (Spong, J. Dyn. Sys. 109, 1987). Springs of gears harden; the cube is the
    next power that takes the same either way (Tuttle and Seering, IEEE Trans. Robotics and
    Automation 12(3), 1996). A diagnosis takes it as a form that the gear may have in part.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    forms = (_hardened,)
    compliance: Vector = parameter(
        "rad/(N m)", bounds=(0.0, 1e-3), shape=(None,), start=(1e-4, 3e-4, 3e-5)
    )
    damping: Vector = parameter(
        "N m s/rad", bounds=(0.0, 500.0), null=None, shape=(None,), start=30.0, quiets=True
    )

    def check(self, system: System) -> None:
        """One number per joint; a rotor where there is compliance."""
        self._require_per_joint(system, "compliance", "damping")
        self._require_rotors(system, self.compliance)

    def arm(self, arm: Arm) -> Arm:
        """Gears with the compliance and damping added."""
        links = list(arm.links)
        for i, (soft, loss) in enumerate(zip(self.compliance, self.damping, strict=True)):
            if soft:
                gear = links[i].gear
                if gear is None:
                    gear = Gear(compliance=soft, damping=loss)
                else:
                    soft, loss = gear.compliance + soft, gear.damping + loss
                    gear = replace(gear, compliance=soft, damping=loss)
                links[i] = replace(links[i], gear=gear)
        return replace(arm, links=tuple(links)) if any(self.compliance) else arm


@dataclass(frozen=True, kw_only=True)
class Hardened(JointElasticity):
    """Elasticity of a spring that takes x (1 + (x / HARD)^2) / compliance [N m].

    For a diagnosis, which runs gears alone; a simulation has the plain spring.
    """
