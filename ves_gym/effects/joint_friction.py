"""Friction of the joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.system.candidate import Candidate, Number, Scope, at_joint, number_of, placed
from ves_gym.system.effect import TorqueEffect, parameter, register_effect

CREEP = 1e-2  # rad/s over which friction builds up from rest


@register_effect("joint/coulomb")
class JointCoulomb(TorqueEffect):
    """Friction of constant size against the motion; smooth at rest, so a joint creeps."""

    builds_up = True
    creep = CREEP
    torque: Vector = parameter("N m", bounds=(0.0, 50.0), shape=(None,), start=2.0)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """Return -torque tanh(v / CREEP)."""
        return -self.torque * np.tanh(v / CREEP)


@register_effect("joint/asymmetry")
class JointAsymmetry(TorqueEffect):
    """Friction larger for v > 0 and smaller for v < 0: its even part.

    Half the difference of the two directions' Coulomb and viscous friction. Where the joint
    moves one way only, a constant torque looks the same (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994; even part: derived here).
    """

    builds_up = True
    creep = CREEP
    coulomb: Vector = parameter("N m", bounds=(-20.0, 20.0), shape=(None,), start=1.0)
    viscous: Vector = parameter("N m s/rad", bounds=(-50.0, 50.0), shape=(None,), start=0.5)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """-coulomb |tanh(v / CREEP)| - viscous |v|."""
        return -self.coulomb * np.abs(np.tanh(v / CREEP)) - self.viscous * np.abs(v)


_PRESSED = 0.01  # of the motor's limit: what teeth may carry without a load


def _pressed(friction: JointLoadFriction) -> Pressed:
    """Return a friction whose teeth are pressed together; a fit may have any share of it."""
    return Pressed(coefficient=friction.coefficient)


@register_effect("joint/load_friction")
class JointLoadFriction(TorqueEffect):
    """Friction of the fraction `coefficient` of the motor's torque, against the motion.

    As of gears, whose teeth press harder the more they carry (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994). Motor torque stands for tooth force: exact at steady speed. Teeth
    that are pressed together rub under no load, too (no-load friction of gears; ibid.): a
    diagnosis takes that as a form that the friction may have in part.
    """

    needs_motor = True
    builds_up = True
    forms = (_pressed,)
    creep = CREEP
    coefficient: Vector = parameter("1", bounds=(0.0, 0.5), shape=(None,), start=0.1)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """-coefficient |tau| tanh(v / CREEP)."""
        return -self.coefficient * np.abs(tau) * np.tanh(v / CREEP)


@dataclass(frozen=True, kw_only=True)
class Pressed(JointLoadFriction):
    """Friction of the fraction `coefficient` of torque and what presses the teeth together."""

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """-coefficient (|tau| + what presses) tanh(v / CREEP)."""
        added = self.coefficient * _PRESSED * self.tau_max * np.tanh(v / CREEP)
        return super().law(q, v, tau) - added


_OF_FADE = 1e-2  # of fade_speed over which friction builds up from rest


@register_effect("joint/stribeck")
class JointStribeck(TorqueEffect):
    """Friction that drops from stiction to Coulomb level with speed.

    Smooth at rest, so a loaded joint creeps instead of sticking (Armstrong-Helouvry et al.,
    Automatica 30(7), 1994).
    """

    builds_up = True
    within = "joint/coulomb"
    coulomb: Vector = parameter("N m", bounds=(0.0, 50.0), shape=(None,), start=2.0)
    stiction: Vector = parameter("N m", bounds=(0.0, 80.0), shape=(None,))
    fade_speed: float = parameter(
        "rad/s", bounds=(1e-2, 2.0), null=None, default=0.2, start=(0.05, 0.2)
    )

    @property
    def creep(self) -> float:
        """Rate over which it builds up from rest [rad/s]."""
        return _OF_FADE * self.fade_speed

    @classmethod
    def candidates(cls, scope: Scope) -> Iterator[Candidate]:
        """Stiction by what it is above Coulomb's level, in parts of that: no corner between."""
        breakaway = Number("breakaway", "1", (0.0, 3.0), (1.0,), factor=False)
        numbers = [number_of(cls, "coulomb"), breakaway, number_of(cls, "fade_speed")]
        for joint in range(scope.joints):

            def fields(x: Array, joint: int = joint) -> dict[str, Any]:
                levels = x[0], x[0] * (1 + x[1])
                coulomb, stiction = (at_joint(joint, scope.joints, k) for k in levels)
                return {"coulomb": coulomb, "stiction": stiction, "fade_speed": float(x[2])}

            yield placed(cls, f"joint {joint + 1}", numbers, fields)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """Level fading from stiction to Coulomb with (v / fade_speed)^2, against the motion."""
        fade = np.exp(-((v / self.fade_speed) ** 2))
        level = self.coulomb + (self.stiction - self.coulomb) * fade
        return -level * np.tanh(v / self.creep)


def _cubed(friction: JointViscous) -> Cubed:
    """Return a friction that doubles its damping at 1 rad/s; a fit may have any share of it."""
    return Cubed(damping=friction.damping)


@register_effect("joint/viscous")
class JointViscous(TorqueEffect):
    """Friction in proportion to the joint's rate.

    Grease thins or thickens with the rate; the cube is the next power that takes the same
    against motion either way (derived here). A diagnosis takes it as a form that the friction
    may have in part.
    """

    forms = (_cubed,)
    damping: Vector = parameter("N m s/rad", bounds=(0.0, 100.0), shape=(None,), start=3.0)

    def law(self: Any, q: Array, v: Array, tau: Array) -> Any:
        """-damping v."""
        return -self.damping * v


@dataclass(frozen=True, kw_only=True)
class Cubed(JointViscous):
    """Viscous friction with as much again in proportion to the cube of the rate [rad/s]."""

    def law(self, q: Array, v: Array, tau: Array) -> Any:
        """-damping v (1 + v^2)."""
        return super().law(q, v, tau) * (1 + v * v)
