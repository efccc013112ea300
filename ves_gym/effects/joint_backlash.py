"""Joint drive: play in the gear."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.mechanics.arm import Arm, Gear
from ves_gym.system.candidate import Candidate, Scope
from ves_gym.system.effect import ArmEffect, parameter, register
from ves_gym.system.system import System

# Of the teeth that a diagnosis looks for: what gives more is elasticity, and what crosses the
# gap in a shorter time than the noise of a torque allows to tell crosses it at the wrong time.
_STIFF = 4e-6  # rad/(N m)
_THICK = 20.0  # N m s/rad
_SOFTER = 5.0  # times the compliance


def _softer(effect: JointBacklash) -> JointBacklash:
    """Return play between softer teeth."""
    return replace(effect, compliance=_SOFTER * effect.compliance)


def _thinner(effect: JointBacklash) -> JointBacklash:
    """Return play in thin oil, through which a link flies."""
    return replace(effect, damping=0.0)


@register("joint/backlash")
@dataclass(frozen=True, kw_only=True)
class JointBacklash(ArmEffect):
    """Rotor and link may turn by `gap` against each other before the teeth touch.

    Teeth are a spring of `compliance`; the oil between them, `damping`, acts in the gap too
    (dead zone: Nordin and Gutman, Automatica 38, 2002). Servo and log are on the rotor's
    side. A joint of gap 0 stays as it is.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    sets_in = True
    forms = (_softer, _thinner)
    gap: Vector = parameter(
        "rad",
        bounds=(0.0, 0.1),
        shape=(None,),
        start=(2e-3, *np.geomspace(1e-4, 3e-2, 10).tolist()),
        search=(5e-5, 0.1),  # less is the teeth's own compliance
    )
    compliance: float = parameter("rad/(N m)", bounds=(1e-6, 1e-3), null=None, default=2e-5)
    damping: float = parameter("N m s/rad", bounds=(0.0, 500.0), null=None, default=5.0)

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """A gap at each joint, between stiff teeth in thick oil."""
        for candidate in super().candidates(scope):

            def make(x: Array, gap: Callable[[Array], Any] = candidate.make) -> JointBacklash:
                found: JointBacklash = gap(x)
                return replace(found, compliance=_STIFF, damping=_THICK)

            yield replace(candidate, make=make)

    def check(self, system: System) -> None:
        """One number per joint; a rotor where there is a gap."""
        self._require_per_joint(system, "gap")
        self._require_rotors(system, self.gap)

    def arm(self, arm: Arm) -> Arm:
        """Gears with the gap added; teeth in series with what is elastic already."""
        links = list(arm.links)
        for i, play in enumerate(self.gap):
            if play:
                gear = links[i].gear
                if gear is None:
                    gear = Gear(compliance=self.compliance, damping=self.damping, gap=play)
                else:
                    soft, loss = gear.compliance + self.compliance, gear.damping + self.damping
                    wide = gear.gap + play
                    gear = replace(gear, compliance=soft, damping=loss, gap=wide)
                links[i] = replace(links[i], gear=gear)
        return replace(arm, links=tuple(links)) if any(self.gap) else arm
