"""State of n simulations, and the snapshot that holds all that goes on from there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ves_gym._util.params import Array, Mask
from ves_gym.mechanics.attitude import from_angles
from ves_gym.mechanics.spatial import twist
from ves_gym.system.system import System


class State(NamedTuple):
    """State of every simulation. Leading axis = simulation."""

    time: Array  # (n,) s
    y: Array  # (n, 6) base pose [m, rad]
    yd: Array  # (n, 6) its rate
    q: Array  # (n, joints) rad
    v: Array  # (n, joints) rad/s

    @property
    def attitude(self) -> Array:
        """(n, 4) unit quaternions of the base, scalar first, its axes to inertial ones."""
        return from_angles(self.y[:, 3:])

    @property
    def spin(self) -> Array:
        """(n, 3) angular velocity of the base in its own axes [rad/s]."""
        return twist(self.y, self.yd)[:, 3:]


@dataclass(frozen=True)
class Snapshot:
    """Everything needed to continue exactly from here (`Simulator.snapshot`)."""

    system_hash: str
    backend_name: str
    backend: object
    generators: tuple[Any, ...]
    gains: tuple[Array, Array]  # kp, kd
    diverged: Mask
    emulation_loop: Any = None
    assigned: Mapping[int, System] = field(default_factory=dict)
    joint_delays: Any = None
    charts: Any = None
    payload: Any = None
    base_actuators: Any = None
