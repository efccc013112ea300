"""What jets and wheels of a satellite do in each control period: commands or a pointing law."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.pointing import (
    about_centre,
    on_rotors,
    shares,
    wheel_axes,
    wheel_torques,
    within_limits,
)
from ves_gym.mechanics.spatial import matvec  # row by row: a product of all rows rounds by n
from ves_gym.mechanics.vehicle import Satellite, act
from ves_gym.simulation.machines import ControlPeriod, Machines, Part
from ves_gym.simulation.state import State


class BaseActuators(Part):
    """Wheels and jets of n simulations: their commands, within what they can do.

    They are set at the start of a control period and held through it: `torque` (n, w) on the
    wheels' rotors, Coulomb friction included [N m], `wrench` (n, 6) of the jets in platform
    axes [N, N m]; `propellant` (n,) is what the jets have used since the reset [kg]; `rotors`
    (w,) are the wheels' inertias [kg m^2].

    Args:
        machines: in space, on a satellite.
    """

    name = "base_actuators"
    arrays = (
        "torque", "wrench", "propellant", "target", "owed", "left", "dumping", "inertia",
        "commanded",
    )  # fmt: skip

    def __init__(self, machines: Machines) -> None:
        system, n = machines.system, machines.n
        vehicle = system.vehicle
        assert isinstance(vehicle, Satellite)
        self.machines, self.system, self.n = machines, system, n
        self.vehicle = vehicle
        self.wheels, self.jets = vehicle.wheels or (), vehicle.jets or ()
        self.pointing, self._any_wrench = vehicle.pointing, vehicle.thrusters
        w, k = len(self.wheels), len(self.jets)
        self.torque, self.wrench = np.zeros((n, w)), np.zeros((n, 6))
        self.propellant, self.target = np.zeros(n), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        self.owed, self.left = np.zeros((n, k)), np.zeros((n, k))  # see `jets.pulses`
        self.dumping, self.inertia = np.zeros(n, bool), np.tile(np.eye(3), (n, 1, 1))
        self.commanded = np.zeros(n, bool)  # the present control period has its commands
        self._axes = wheel_axes(self.wheels)  # (3, w)
        self.rotors = np.array([wheel.inertia for wheel in self.wheels])
        self._full = np.array([wheel.momentum_max for wheel in self.wheels])

    def set_state(self, state: Mapping[str, Array]) -> None:
        """See `Part`; set the engine's state too."""
        super().set_state(state)
        self._send(np.arange(self.n))

    def record(self) -> dict[str, Array]:
        """Columns of a run log: what motors and jets do now, and the propellant used."""
        out = {"motor": self.torque.copy()} if self.wheels else {}
        if self.jets or (self._any_wrench and self.pointing is not None):
            out |= {"jet": self.wrench.copy(), "propellant": self.propellant[:, None].copy()}
        return out

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """See `Part`. Motors and jets stop; the law holds the attitude of now."""
        for name in ("torque", "wrench", "propellant", "owed", "left", "dumping"):
            getattr(self, name)[ids] = 0
        self.target[ids] = start.attitude
        if self.pointing is not None:
            self.inertia[ids] = self._about_centre(start.q)
        self.commanded[:], self.written = False, True
        self._send(ids)

    def _about_centre(self, q: Array) -> Array:
        """(k, 3, 3) inertia of satellite and arm about their common centre of mass."""
        return about_centre(inertia(self.system.arm, q)[:, :6, :6] + self.system.base.rigid())

    def _send(self, ids: Index) -> None:
        jets = self.wrench[ids] if self.jets or self._any_wrench else None
        torque = self.torque[ids] if self.wheels else None
        self.machines.backend.set_actuators(ids, jets, torque)

    def before_evaluation(self, machines: Machines) -> None:
        """See `Part`. Nobody has commanded the next period; the pointing law may."""
        if self.commanded.all():
            return
        if self.pointing is not None:
            self._point()
        else:
            nothing, speed = np.zeros_like(self.torque), self.machines.wheel_speed
            if self.wheels:
                dt = self.system.control_dt
                self.torque[:] = on_rotors(self.wheels, nothing, speed, dt)
            self.wrench[:] = 0.0
            self._send(np.arange(self.n))

    # ------------------------------------------------------------------ periods

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        """See `Part`. A period that begins is commanded, if it is not yet."""
        if period.base_wrench is not None or period.wheel_torque is not None:
            self.command(period.base_wrench, period.wheel_torque)
        elif not self.commanded.all():
            self._point()

    def after(self, machines: Machines, period: ControlPeriod) -> None:
        if period.ends:
            self.commanded[:] = False

    def _point(self) -> None:
        """Command what the pointing law has for a control period that begins now."""
        state, speed = self.machines.state, self.machines.wheel_speed
        moment, torque = np.zeros((self.n, 6)), np.zeros((self.n, len(self.wheels)))
        if self.pointing is not None:
            law, h = self.pointing, speed * self.rotors
            q, spin, stored = state.attitude, state.spin, matvec(self._axes, h)
            demand = law.moment(self.inertia, self.target, q, spin, stored)
            moment[:, 3:] = demand
            if self.wheels:
                spin_up, dt = wheel_torques(self.wheels, demand), self.system.control_dt
                torque = within_limits(self.wheels, spin_up, speed, dt)
                moment[:, 3:] += matvec(self._axes, torque)  # what wheels cannot do
                self.dumping |= (np.abs(h) > law.dump_above * self._full).any(axis=1)
                self.dumping &= (np.abs(h) > law.dump_below * self._full).any(axis=1)
                dumping = self.dumping[:, None] / law.dump_time
                dumped = -stored * dumping if self.jets or self._any_wrench else 0.0
                moment[:, 3:] += dumped
                # the wheels answer the mean of the pulses, not each
                torque = wheel_torques(self.wheels, demand - dumped)
                unmoved = h - matvec(shares(self.wheels) @ self._axes, h)
                torque = torque - unmoved * dumping
        self._command(moment, torque)

    def command(self, wrench: Array | None, torque: Array | None) -> None:
        """Set the commands of the control period that begins now.

        Args:
            wrench: (n, 6) of the jets in platform axes [N, N m]; None: none.
            torque: (n, w) of the wheels' motors [N m]; None: none.
        """
        if self.pointing is not None:
            raise ParameterError(
                "the satellite's pointing commands wheels and jets: leave out base_wrench and"
                " wheel_torque, or use a vehicle without pointing"
            )
        wrench = np.zeros((self.n, 6)) if wrench is None else wrench
        self._command(wrench, np.zeros_like(self.torque) if torque is None else torque)

    def _command(self, wrench: Array, torque: Array) -> None:
        state = self.owed, self.left, self.propellant[:, None]
        speed, dt = self.machines.wheel_speed, self.system.control_dt
        self.take(*act(self.vehicle, dt, wrench, torque, speed, *state))
        self.commanded[:] = True
        self._send(np.arange(self.n))
        self.written = True

    def take(
        self, torque: Array, wrench: Array, owed: Array, left: Array, propellant: Array
    ) -> None:
        """Take over what `act` gives."""
        self.torque[:], self.wrench[:], self.owed[:], self.left[:] = torque, wrench, owed, left
        self.propellant[:] = propellant[:, 0]
