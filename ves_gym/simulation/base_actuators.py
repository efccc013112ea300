"""What jets and wheels of a satellite do in each control period, asked or by its pointing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ves_gym._util.params import Array, Index, ParameterError
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.pointing import (
    allocated,
    on_rotors,
    propellant,
    pulses,
    shares,
    wheel_axes,
    wheel_torques,
    within_limits,
    wrench_matrix,
)
from ves_gym.mechanics.spatial import matvec  # row by row: a product of all rows rounds by n
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.system.system import System

if TYPE_CHECKING:
    from ves_gym.engine.backends.base import Backend
    from ves_gym.simulation.state import State


class BaseActuators:
    """Wheels and jets of n simulations: what they are told, within what they can do.

    They are set at the start of a control period and held through it: `torque` (n, w) on the
    wheels' rotors, Coulomb friction included [N m], `wrench` (n, 6) of the jets in platform
    axes [N, N m]; `propellant` (n,) is what the jets have used since the reset [kg]; `rotors`
    (w,) are the wheels' inertias [kg m^2].

    Args:
        system: in space, on a satellite.
        n: number of simulations.
    """

    def __init__(self, system: System, n: int) -> None:
        vehicle = system.vehicle
        assert isinstance(vehicle, Satellite)
        self.system, self.n = system, n
        self.wheels, self.jets = vehicle.wheels or (), vehicle.jets or ()
        self.pointing, self._any_wrench = vehicle.pointing, vehicle.thrusters
        w, k = len(self.wheels), len(self.jets)
        self.torque, self.wrench = np.zeros((n, w)), np.zeros((n, 6))
        self.propellant, self.target = np.zeros(n), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
        self._owed, self._left = np.zeros((n, k)), np.zeros((n, k))
        self._dumping, self._inertia = np.zeros(n, bool), np.tile(np.eye(3), (n, 1, 1))
        self._done = 0  # physics steps of the present control period
        self._ready = False  # the present control period has its commands
        self._axes = wheel_axes(self.wheels)  # (3, w)
        self.rotors = np.array([wheel.inertia for wheel in self.wheels])
        self._full = np.array([wheel.momentum_max for wheel in self.wheels])

    _names = [
        "torque",
        "wrench",
        "propellant",
        "target",
        "_owed",
        "_left",
        "_dumping",
        "_inertia",
    ]

    def get_state(self) -> tuple[Any, ...]:
        """Everything needed to continue exactly from here."""
        arrays = tuple(getattr(self, name).copy() for name in self._names)
        return (*arrays, self._done, self._ready)

    def set_state(self, state: tuple[Any, ...], backend: Backend) -> None:
        """Return to a state handed out by `get_state`, the engine too."""
        *arrays, self._done, self._ready = state
        for name, part in zip(self._names, arrays, strict=True):
            getattr(self, name)[:] = part
        self._send(np.arange(self.n), backend)

    def record(self) -> dict[str, Array]:
        """Columns of a run log: what motors and jets do now, and the propellant used."""
        out = {"motor": self.torque.copy()} if self.wheels else {}
        if self.jets or (self._any_wrench and self.pointing is not None):
            out |= {"jet": self.wrench.copy(), "propellant": self.propellant[:, None].copy()}
        return out

    def reset(self, ids: Index, state: State, backend: Backend) -> None:
        """Stop wheels' motors and jets of simulations `ids`, and hold the attitude of now."""
        for name in ("torque", "wrench", "propellant", "_owed", "_left", "_dumping"):
            getattr(self, name)[ids] = 0
        self.target[ids] = state.attitude[ids]
        if self.pointing is not None:
            for i in ids.tolist():
                self._inertia[i] = self._about_centre(state.q[i])
        self._done, self._ready = 0, False
        self._send(ids, backend)

    def _about_centre(self, q: Array) -> Array:
        """(3, 3) inertia of satellite and arm about their common centre of mass."""
        locked = inertia(self.system.arm, q)[:6, :6] + self.system.base.rigid()
        mass, first = locked[0, 0], locked[3:, :3]
        out: Array = locked[3:, 3:] + first @ first / mass
        return out

    def _send(self, ids: Index, backend: Backend) -> None:
        jets = self.wrench[ids] if self.jets or self._any_wrench else None
        backend.set_actuators(ids, jets, self.torque[ids] if self.wheels else None)

    def look(self, state: State, speed: Array, backend: Backend) -> None:
        """Have in the engine what acts from this instant on, as far as it is settled.

        Args:
            state, speed, backend: see `prepare`.
        """
        if self.pointing is not None:
            self.prepare(state, speed, backend)
        else:  # nobody has commanded the next period
            self._drive(np.zeros_like(self.torque), speed)
            self.wrench[:] = 0.0
            self._send(np.arange(self.n), backend)

    # ------------------------------------------------------------------ periods

    @property
    def due(self) -> bool:
        """True if a control period begins now, whose commands are not settled yet."""
        return not self._ready

    @property
    def steps_left(self) -> int:
        """Physics steps until the present control period ends."""
        return self.system.substeps - self._done

    def advanced(self, steps: int) -> None:
        """Take note of physics steps that have been made."""
        self._done = (self._done + steps) % self.system.substeps
        if not self._done:
            self._ready = False

    def prepare(self, state: State, speed: Array, backend: Backend) -> None:
        """Set what a control period that begins now is to have, by the pointing law.

        Args:
            state: at this instant.
            speed: (n, w) of the wheels [rad/s].
            backend: the engine.
        """
        moment, torque = np.zeros((self.n, 6)), np.zeros((self.n, len(self.wheels)))
        if self.pointing is not None:
            law, h = self.pointing, speed * self.rotors
            q, spin, stored = state.attitude, state.spin, matvec(self._axes, h)
            asked = law.moment(self._inertia, self.target, q, spin, stored)
            moment[:, 3:] = asked
            if self.wheels:
                torque = self._limited(wheel_torques(self.wheels, asked), speed)
                moment[:, 3:] += matvec(self._axes, torque)  # what wheels cannot do
                self._dumping |= (np.abs(h) > law.dump_above * self._full).any(axis=1)
                self._dumping &= (np.abs(h) > law.dump_below * self._full).any(axis=1)
                dumping = self._dumping[:, None] / law.dump_time
                dumped = -stored * dumping if self.jets or self._any_wrench else 0.0
                moment[:, 3:] += dumped
                # the wheels answer the mean of the pulses, not each
                torque = wheel_torques(self.wheels, asked - dumped)
                unmoved = h - matvec(shares(self.wheels) @ self._axes, h)
                torque = torque - unmoved * dumping
        self._blow(moment)
        self._drive(torque, speed)
        self._ready = True
        self._send(np.arange(self.n), backend)

    def command(
        self, wrench: Array | None, torque: Array | None, speed: Array, backend: Backend
    ) -> None:
        """Set what a control period that begins now is to have, as asked.

        Args:
            wrench: (n, 6) of the jets in platform axes [N, N m]; None: none.
            torque: (n, w) of the wheels' motors [N m]; None: none.
            speed: (n, w) of the wheels [rad/s].
            backend: the engine.
        """
        if self.pointing is not None:
            raise ParameterError(
                "the satellite's pointing commands wheels and jets: leave out base_wrench and"
                " wheel_torque, or use a vehicle without pointing"
            )
        self._blow(np.zeros((self.n, 6)) if wrench is None else wrench)
        asked = np.zeros_like(self.torque) if torque is None else torque
        self._drive(asked, speed)
        self._ready = True
        self._send(np.arange(self.n), backend)

    def _limited(self, torque: Array, speed: Array) -> Array:
        return within_limits(self.wheels, torque, speed, self.system.control_dt)

    def _drive(self, torque: Array, speed: Array) -> None:
        """Set the torque on the rotors, friction included."""
        dt = self.system.control_dt
        self.torque[:] = on_rotors(self.wheels, torque, speed, dt) if self.wheels else 0.0

    def _blow(self, wrench: Array) -> None:
        """Set the jets' wrench to what their pulses make of one asked for."""
        if not self.jets:
            self.wrench[:] = wrench if self._any_wrench else 0.0
            return
        dt = self.system.control_dt
        force = allocated(self.jets, wrench)
        given, self._owed, self._left = pulses(self.jets, self._owed, self._left, force, dt)
        self.wrench[:] = matvec(wrench_matrix(self.jets), given) / dt
        self.propellant += propellant(self.jets, given)
