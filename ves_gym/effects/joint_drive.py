"""Motors and gears of the joints, their commands, and what is measured of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.link import Gear
from ves_gym.system.candidate import Candidate, Number, Scope, at_joint, number_of, placed
from ves_gym.system.deviations import Delays
from ves_gym.system.effect import (
    ArmEffect,
    DelayEffect,
    TorqueEffect,
    parameter,
    register_effect,
)
from ves_gym.system.system import System


@register_effect("joint/drive_gain")
class JointDriveGain(TorqueEffect):
    """Motors give (1 + `error`) times the commanded torque.

    An error of torque constant, gear ratio or current calibration (derived here). The log
    shows the commanded torque.
    """

    needs_motor = True
    error: Vector = parameter("1", bounds=(-0.5, 0.5), shape=(None,), start=0.05)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """error tau."""
        return self.error * tau


@register_effect("joint/torque_limit")
class JointTorqueLimit(TorqueEffect):
    """Motors give at most (1 - `fraction`) of their stated limit (a current limit).

    The log shows the commanded torque (derived here).
    """

    needs_motor = True
    sets_in = True
    fraction: Vector = parameter(
        "1",
        bounds=(0.0, 0.95),
        shape=(None,),
        start=tuple((1 - np.geomspace(0.9, 0.05, 16)).tolist()),
    )

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """Return the part of tau above (1 - fraction) tau_max, taken away."""
        most = (1 - self.fraction) * self.tau_max
        return np.clip(tau, -most, most) - tau


@register_effect("joint/torque_offset")
class JointTorqueOffset(TorqueEffect):
    """A constant torque at the joint: an amplifier's offset, a cable's pull.

    Direction-dependent friction (`joint/asymmetry`) looks the same while the joint moves one
    way (derived here).
    """

    torque: Vector = parameter("N m", bounds=(-50.0, 50.0), shape=(None,), start=1.0)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """Return the torque, whatever the state."""
        return self.torque


_MOST = 500.0  # periods per turn


def _overtone(turned: float, ripple: JointRipple) -> JointRipple:
    """A ripple's second harmonic, `turned` [rad] against the first."""
    cycles = tuple(min(2 * k, _MOST) for k in ripple.cycles)
    phase = (2 * np.array(ripple.phase) + turned + np.pi) % (2 * np.pi) - np.pi
    return dataclasses.replace(ripple, cycles=cycles, phase=tuple(phase.tolist()))


@register_effect("joint/ripple")
class JointRipple(TorqueEffect):
    """Torque that repeats `cycles` times per turn of the joint (cogging, gear teeth).

    One harmonic; the PUMA's gears turn their motors 62.6, 107.8 and 53.7 times per turn
    (Corke's Robotics Toolbox model). Several effects make several harmonics; a diagnosis takes
    a second one as a form that the first may have in part.
    """

    forms = (partial(_overtone, 0.0), partial(_overtone, np.pi / 2))
    amplitude: Vector = parameter("N m", bounds=(0.0, 20.0), shape=(None,))
    cycles: Vector = parameter(
        "1",
        bounds=(0.5, _MOST),
        null=None,
        shape=(None,),
        start=tuple(np.arange(2.0, 130.0, 2.5).tolist()),
    )
    phase: Vector = parameter("rad", bounds=(-7.0, 7.0), null=None, shape=(None,))

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Sine and cosine in place of amplitude and phase: a fit has no corner at zero."""
        waves = [Number(k, "N m", (-14.0, 14.0), (1.0,)) for k in ("sine", "cosine")]
        numbers = [*waves, number_of(cls, "cycles")]
        for joint in range(scope.joints):

            def fields(x: Array, joint: int = joint) -> dict[str, Any]:
                n = scope.joints
                return {
                    "amplitude": at_joint(joint, n, np.hypot(x[0], x[1])),
                    "phase": at_joint(joint, n, np.arctan2(x[1], x[0])),
                    "cycles": at_joint(joint, n, x[2], elsewhere=1.0),
                }

            def periods(x: Array, joint: int = joint) -> float:
                return float(x[2]) * scope.travel[joint] / (2 * np.pi)

            candidate = placed(cls, f"joint {joint + 1}", numbers, fields)
            travelled = periods if scope.travel else None
            yield dataclasses.replace(candidate, periods=travelled)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """amplitude sin(cycles q + phase)."""
        return self.amplitude * np.sin(self.cycles * q + self.phase)


@register_effect("joint/rotor_inertia")
class JointRotorInertia(ArmEffect):
    """The rotors, seen through their gears, have `added` more inertia than described.

    Felt by the joint and not by the base, other than a link's (Armstrong, Khatib, Burdick
    1986); of a single link on a resting base the two look alike.
    """

    needs_motor = True
    shows = ("joint",)
    added: Vector = parameter("kg m^2", bounds=(-0.8, 20.0), shape=(None,), start=0.3)

    def check(self, system: System) -> None:
        """None that leaves less than no rotor."""
        super().check(system)
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


def _with_gears(arm: Arm, gears: Sequence[Gear | None]) -> Arm:
    """The arm with a gear more, in series, at each joint that has one."""
    links = list(arm.links)
    for i, added in enumerate(gears):
        if added is not None:
            gear = links[i].gear
            if gear is not None:
                parts = ("compliance", "damping", "gap")
                sums = {name: getattr(gear, name) + getattr(added, name) for name in parts}
                added = replace(gear, **sums)
            links[i] = replace(links[i], gear=added)
    return replace(arm, links=tuple(links)) if any(gears) else arm


HARD = 0.01  # rad: wound up so far, a spring that hardens takes twice what it did


def _hardened(effect: JointElasticity) -> Hardened:
    """Return a gear whose spring hardens; a fit may have any share of it."""
    return Hardened(compliance=effect.compliance, damping=effect.damping)


@register_effect("joint/elasticity")
class JointElasticity(ArmEffect):
    """A spring of `compliance`, with a damper beside it, between rotor and link.

    Servo and log are on the rotor's side. A joint of compliance 0 stays rigid, its damping
    without meaning (Spong, J. Dyn. Sys. 109, 1987). Springs of gears harden; the cube is the
    next power that takes the same either way (Tuttle and Seering, IEEE Trans. Robotics and
    Automation 12(3), 1996). A diagnosis takes it as a form that the gear may have in part.
    """

    forms = (_hardened,)
    compliance: Vector = parameter(
        "rad/(N m)", bounds=(0.0, 1e-3), shape=(None,), start=(1e-4, 3e-4, 3e-5)
    )
    damping: Vector = parameter(
        "N m s/rad", bounds=(0.0, 500.0), null=None, shape=(None,), start=30.0, quiets=True
    )

    def check(self, system: System) -> None:
        """A rotor where there is compliance."""
        super().check(system)
        self._require_rotors(system, self.compliance)

    def arm(self, arm: Arm) -> Arm:
        """Gears with the compliance and damping added."""
        gears = zip(self.compliance, self.damping, strict=True)
        return _with_gears(
            arm, [Gear(compliance=c, damping=d) if c else None for c, d in gears]
        )


@dataclass(frozen=True, kw_only=True)
class Hardened(JointElasticity):
    """Elasticity of a spring that takes x (1 + (x / HARD)^2) / compliance [N m].

    For a diagnosis, which runs gears alone; a simulation has the plain spring.
    """


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


@register_effect("joint/backlash")
class JointBacklash(ArmEffect):
    """Rotor and link may turn by `gap` against each other before the teeth touch.

    Teeth are a spring of `compliance`; the oil between them, `damping`, acts in the gap too
    (dead zone: Nordin and Gutman, Automatica 38, 2002). Servo and log are on the rotor's
    side. A joint of gap 0 stays as it is.
    """

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
                backlash: JointBacklash = gap(x)
                return replace(backlash, compliance=_STIFF, damping=_THICK)

            yield replace(candidate, make=make)

    def check(self, system: System) -> None:
        """A rotor where there is a gap."""
        super().check(system)
        self._require_rotors(system, self.gap)

    def arm(self, arm: Arm) -> Arm:
        """Gears with the gap added; teeth in series with what is elastic already."""
        teeth = {"compliance": self.compliance, "damping": self.damping}
        return _with_gears(arm, [Gear(**teeth, gap=gap) if gap else None for gap in self.gap])


@register_effect("joint/measurement_delay")
class JointMeasurementDelay(DelayEffect):
    """Servo, gravity estimate and log see joint angles and rates of `delay` ago.

    Rates and angles are linear between two physics steps (derived here).
    """

    needs_motor = True  # a joint that follows its command exactly needs no measurement
    shows = ("joint", "wrench")
    delay: float = parameter("s", bounds=(0.0, 0.1), start=5e-3)

    def wire(self, delays: Delays) -> None:
        delays.measurement = delays.measurement + self.delay


@register_effect("joint/velocity_lag")
class JointVelocityLag(DelayEffect):
    """Servo and log see joint rates through a first-order low-pass; angles are as they are.

    How drives derive a rate from an encoder: differences, smoothed. Several effects add their
    time constants (derived here).
    """

    needs_motor = True
    shows = ("servo", "velocity")
    time_constant: Vector = parameter(
        "s", bounds=(0.0, 1.0), shape=(None,), start=(0.02, 0.005, 0.2)
    )

    def wire(self, delays: Delays) -> None:
        delays.lag = delays.lag + np.array(self.time_constant)


@register_effect("command/delay")
class CommandDelay(DelayEffect):
    """The drives get the joint commands `delay` later than they are sent.

    Between two physics steps commands are linear; before the first one they are that one.
    The log shows the command sent, and the torque by what has arrived (derived here).
    """

    shows = ("servo",)
    delay: float = parameter("s", bounds=(0.0, 0.1), start=5e-3)

    def wire(self, delays: Delays) -> None:
        delays.command = delays.command + self.delay
