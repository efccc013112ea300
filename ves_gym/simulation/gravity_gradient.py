"""The gravity gradient of n simulations on an orbit, period by period."""

from __future__ import annotations

import numpy as np

from ves_gym.engine.backends.compiled import CompiledBackend
from ves_gym.mechanics.attitude import conjugate, rotate
from ves_gym.mechanics.orbit import Orbit
from ves_gym.simulation.machines import ControlPeriod, Machines, Part


class GravityGradient(Part):
    """Direction of the Earth, set in the engine, whose equations have no time.

    Held through a control period as at its middle: half a period off, the direction would be
    1e-5 rad off at 12.5 ms in a low orbit; so it is 1e-11.

    Args:
        machines: on a satellite in space, in a compiled engine.
        orbit: that they are on.
    """

    name = "gravity_gradient"

    def __init__(self, machines: Machines, orbit: Orbit) -> None:
        self.machines, self.orbit = machines, orbit

    def before(self, machines: Machines, period: ControlPeriod) -> None:
        self._set_direction(period.steps / 2 * machines.system.physics_dt)

    def before_evaluation(self, machines: Machines) -> None:
        self._set_direction(0.0)

    def _set_direction(self, ahead: float) -> None:
        """Set the gravity gradient of some time [s] from now."""
        machines = self.machines
        assert isinstance(machines.backend, CompiledBackend)
        back, every = conjugate(machines.charts.turn), np.arange(machines.n)
        up = self.orbit.up(machines.backend.read()[0] + ahead)
        machines.backend.set_tide(every, rotate(back, up), rotate(back, machines.charts.place))
