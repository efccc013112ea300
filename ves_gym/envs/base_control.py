"""Wheels and jets of a satellite as part of an action, behind the numbers of the joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector, finite, unit
from ves_gym.mechanics.carried import ReactionWheel
from ves_gym.mechanics.pointing import strongest
from ves_gym.mechanics.spatial import cross
from ves_gym.mechanics.vehicle import Satellite, has_jets
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.simulation.simulator import Simulator

_AXES = 6  # numbers of a wrench


@dataclass(frozen=True, kw_only=True)
class BaseControl:
    """Part of an action for wheels and jets: a torque per wheel, then a wrench of the jets.

    A wheel's number is its motor's torque in `torque_max`, held over the period. The jets'
    six are force along the platform's axes and moment about the centre of mass of the
    satellite's body, in `wrench`; jets make of them what their thrust and whole pulses allow
    (docs/spacecraft.md). The vehicle must have no pointing law: where it has one, leave
    `base_control` out, and the law commands both.
    """

    wheels: bool = True
    jets: bool = True
    wrench: Vector | None = unit("N, N m", default=None)  # (6,) None: the most the jets give

    def __post_init__(self) -> None:
        if not (self.wheels or self.jets):
            raise ParameterError("BaseControl must have wheels, jets or both, got neither")
        if self.wrench is None:
            return
        if not (finite(self.wrench, (_AXES,), "BaseControl.wrench") > 0).all():
            raise ParameterError(f"BaseControl.wrench must be > 0, got {self.wrench}")

    def check(self, system: System) -> None:
        """Raise ParameterError where a system has nothing to command, or commands itself."""
        vehicle = system.vehicle
        if not isinstance(vehicle, Satellite) or system.mode != "ideal":
            got = vehicle.kind if system.mode == "ideal" else f"mode {system.mode}"
            raise ParameterError(f"base_control needs a satellite in mode ideal, got {got}")
        if vehicle.pointing is not None:
            raise ParameterError(
                "base_control needs a vehicle without pointing, which commands wheels and jets"
                " itself: leave base_control out, or use replace(vehicle, pointing=None)"
            )
        if self.wheels and not vehicle.wheels:
            raise ParameterError("base_control.wheels needs a vehicle with wheels, got none")
        if self.jets and not has_jets(vehicle):
            raise ParameterError("base_control.jets needs a vehicle with jets, got none")
        if self.jets and self.wrench is None and not vehicle.jets:
            raise ParameterError(
                "base_control.wrench must be six numbers for a vehicle with thrusters = true,"
                " which have no limit, got None"
            )

    def width(self, system: System) -> int:
        """Return the number of numbers in an action."""
        return self._motors(system) + _AXES * self.jets

    def scale(self, system: System) -> Array:
        """Return what 1 stands for (width,): torques [N m], then force [N] and moment [N m]."""
        vehicle = system.vehicle
        assert isinstance(vehicle, Satellite)
        parts = [wheel.torque_max for wheel in vehicle.wheels or ()] if self.wheels else []
        if not self.jets:
            return np.array(parts)
        if self.wrench is not None:
            return np.array([*parts, *self.wrench])
        return np.concatenate([parts, strongest(vehicle.jets or (), vehicle.body.com)])

    def drive(self, sim: Simulator, action: Array) -> None:
        """Command wheels and jets for the control period that begins now.

        Args:
            sim: the simulations.
            action: (n, width) in [-1, 1].
        """
        assert sim.base_actuators is not None
        sim.base_actuators.command(*self.asked(sim.system, action))

    def asked(self, system: System, action: Array) -> tuple[Array, Array]:
        """Return what an action asks of jets and wheels.

        Args:
            system: on a satellite.
            action: (n, width) in [-1, 1].

        Returns:
            Wrench (n, 6) in platform axes at the platform [N, N m], torques (n, w) [N m].
        """
        vehicle, motors = system.vehicle, self._motors(system)
        assert isinstance(vehicle, Satellite)
        command = action * self.scale(system)
        wrench = command[:, motors:].copy() if self.jets else np.zeros((len(action), _AXES))
        com = np.array(vehicle.body.com, dtype=float)
        wrench[:, 3:] += cross(com, wrench[:, :3])  # about the platform
        torque = (
            command[:, :motors] if motors else np.zeros((len(action), len(wheels_of(system))))
        )
        return wrench, torque

    def _motors(self, system: System) -> int:
        return len(wheels_of(system)) if self.wheels else 0


def wheels_of(system: System) -> tuple[ReactionWheel, ...]:
    """Return the reaction wheels of a vehicle."""
    return getattr(system.vehicle, "wheels", None) or ()
