"""Contact at the tool in n simulations: the touched bodies, and the force on the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.mechanics.attitude import conjugate, product, rotate
from ves_gym.simulation.machines import ControlPeriod, Machines, Part
from ves_gym.simulation.state import State

if TYPE_CHECKING:
    from ves_gym.engine.backends.compiled import EngineContact


class PayloadState(NamedTuple):
    """Pose and motion of the payloads' origins. Leading axis = simulation."""

    position: Array  # (n, 3) in space [m]
    attitude: Array  # (n, 4) unit quaternion, own axes to inertial axes
    velocity: Array  # (n, 3) of the centre of mass [m/s]
    spin: Array  # (n, 3) in its own axes [rad/s]


class ToolContact(Part):
    """Contact of the tools of n simulations, as `Simulator.contact`.

    The engine integrates payloads that can be touched, in the frames that its charts give.

    Args:
        machines: whose engine has the contact.
    """

    name = "contact"
    periodic = False

    def __init__(self, machines: Machines) -> None:
        self.machines = machines

    @property
    def engine(self) -> EngineContact:
        """The engine's contact."""
        contact = self.machines.backend.contact
        assert contact is not None
        return contact

    def measured(self) -> tuple[Array, Array]:
        """Return the wrench on the tools (n, 6), and the energy in the contacts (n,) [J].

        At this instant; inertial axes, at the tool.
        """
        wrench, energy = self.engine.measured()
        turn = self.machines.charts.turn
        turned = [rotate(turn, wrench[:, :3]), rotate(turn, wrench[:, 3:])]
        return np.concatenate(turned, axis=1), energy

    def reset(self, machines: Machines, ids: Index, start: State) -> None:
        """See `Part`. What is fixed in space is put where the engine's frames have it."""
        charts = machines.charts
        self.engine.set_frame(ids, charts.place[ids], charts.turn[ids])

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        if period.recentred is not None:
            self.reset(machines, period.recentred, machines.state)

    def put(self, ids: Index, bodies: PayloadState, com: Array) -> None:
        """Give the engine the state in space of bodies `ids`, centres of mass `com` (k, 3)."""
        charts = self.machines.charts
        place, back = charts.place[ids], conjugate(charts.turn[ids])
        moved = (
            rotate(back, bodies.position - place),
            product(back, bodies.attitude),
            rotate(back, bodies.velocity),
            bodies.spin,
        )
        self.engine.put(ids, np.concatenate(moved, axis=1), com)

    def bodies(self, ids: Index, com: Array) -> PayloadState:
        """State in space of bodies `ids`, from the engine; `com` (n, 3) of all bodies."""
        rows = self.engine.bodies(com)[ids]
        at, attitude, velocity, spin = np.split(rows, [3, 7, 10], axis=1)
        charts = self.machines.charts
        place, turn = charts.place[ids], charts.turn[ids]
        return PayloadState(
            place + rotate(turn, at), product(turn, attitude), rotate(turn, velocity), spin
        )
