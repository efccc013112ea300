"""The platform, from its command to its pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ves_gym.hardware.platform import PoseServo
from ves_gym.system.candidate import Candidate, Scope, number_of, placed
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register_effect
from ves_gym.system.system import System


@register_effect("platform/bandwidth")
class PlatformBandwidth(LaboratoryEffect):
    """The platform's bandwidth differs from the stated one by the fraction `error`.

    Of legs both gains of their servos do (thesis 5.6), to which their bandwidth is about
    proportional.
    """

    port = "platform"
    shows = ("platform", "wrench")
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(0.2, -0.4, 1.5))

    def edit(self, p: LoopParameters) -> None:
        p.bandwidth = p.bandwidth + self.error


@register_effect("platform/damping")
class PlatformDamping(LaboratoryEffect):
    """The platform's damping ratio differs from the stated one by the fraction `error`.

    Of legs the gain K2 does, which acts on the last change of a leg's length (thesis 5.6).
    """

    port = "platform"
    shows = ("platform", "wrench")
    error: float = parameter("1", bounds=(-0.9, 10.0), start=(0.2, -0.4, 1.5))

    def check(self, system: System) -> None:
        """Legs need a gain that brakes them."""
        servo = system.emulator_settings.platform
        brakes = isinstance(servo, PoseServo) or servo.K2 > 0
        self.require(brakes, "a pose servo, or legs of K2 > 0")

    def edit(self, p: LoopParameters) -> None:
        p.damping = p.damping + self.error


@register_effect("platform/delay")
class PlatformDelay(LaboratoryEffect):
    """The platform gets the computer's command `delay` later than the loop assumes.

    Linear between two commands; the payload compensation does not know (thesis 2.4.1 has one
    period of it, `EmulatorSettings.delay`).
    """

    port = "platform"
    delay: float = parameter("s", bounds=(0.0, 0.2), start=5e-3)

    def edit(self, p: LoopParameters) -> None:
        p.platform_delay = p.platform_delay + self.delay


# What may be missing, in parts of what the legs are told to go: more shows in no run
SHORT = np.geomspace(0.005, 0.6, 16)


@register_effect("platform/stroke")
class PlatformStroke(LaboratoryEffect):
    """The legs' stroke lacks the fraction `travel`, their speed the fraction `speed`.

    A command beyond is held back silently: on its way from home, or from the last one, in
    proportion. The platform goes there at the speed that takes (derived here). Of several
    such effects the tightest counts.
    """

    port = "platform"
    sets_in = True
    travel: float = parameter("1", bounds=(0.0, 0.9999))
    speed: float = parameter("1", bounds=(0.0, 0.9999))

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Travel, from the largest commanded length of the legs."""
        starts = tuple(1 - scope.stretch * (1 - part) for part in SHORT.tolist())
        travel = replace(number_of(cls, "travel"), starts=starts)
        yield placed(cls, "", [travel], lambda x: {"travel": float(x[0])})

    def edit(self, p: LoopParameters) -> None:
        """Tighten the machine's limits."""
        p.platform_travel = np.maximum(p.platform_travel, self.travel)
        p.platform_speed = np.maximum(p.platform_speed, self.speed)
