"""Contact at the tool in n simulations: the touched bodies, and the force on the tool."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.mechanics.attitude import IDENTITY, conjugate, product, rotate

if TYPE_CHECKING:
    from ves_gym.engine.backends.base import Backend, Toucher
    from ves_gym.simulation.capture import Cargo
    from ves_gym.simulation.charts import Charts


class Touch:
    """Contact of the tools of n simulations, as `Simulator.touch`.

    The engine integrates payloads that can be touched; `Cargo` has their state in space.

    Args:
        backend: the engine, which has the contact.
        n: number of simulations.
        charts: frames of free bodies that the engine works in; None: space itself.
    """

    def __init__(self, backend: Backend, n: int, charts: Charts | None) -> None:
        self._backend, self._charts, self._n = backend, charts, n

    @property
    def _engine(self) -> Toucher:
        """The engine's contact of now: another one once systems have been assigned."""
        assert self._backend.contact is not None
        return self._backend.contact

    def measured(self) -> tuple[Array, Array]:
        """Return the wrench on the tools (n, 6), and the energy in the contacts (n,) [J].

        At this instant, under the command of now; inertial axes, at the tool.
        """
        wrench, energy = self._engine.measured()
        _, turn = self._frames(np.arange(self._n))
        return np.concatenate(
            [rotate(turn, wrench[:, :3]), rotate(turn, wrench[:, 3:])], 1
        ), energy

    def framed(self, ids: Index) -> None:
        """Put what is fixed in space where the engine's frames have it."""
        self._engine.set_frame(ids, *self._frames(ids))

    def describe(self, cargo: Cargo) -> None:
        """Give the engine all payloads' mass properties, and whether they can be touched."""
        ids = np.arange(self._n)
        self._engine.set_body(ids, cargo.mass, cargo.com, cargo.inertia)
        self._engine.set_touching(ids, ~cargo.carried)

    def put(self, cargo: Cargo, ids: Index) -> None:
        """Give the engine the payloads' state in space."""
        place, turn = self._frames(ids)
        back = conjugate(turn)
        self._engine.set_target(
            ids,
            rotate(back, cargo.position[ids] - place),
            product(back, cargo.attitude[ids]),
            rotate(back, cargo.velocity[ids]),
            cargo.spin[ids],
            cargo.com[ids],
        )

    def take(self, cargo: Cargo, ids: Index) -> None:
        """Take the payloads' state in space from the engine."""
        at, attitude, velocity, spin = (part[ids] for part in self._engine.target(cargo.com))
        place, turn = self._frames(ids)
        cargo.position[ids] = place + rotate(turn, at)
        cargo.attitude[ids] = product(turn, attitude)
        cargo.velocity[ids], cargo.spin[ids] = rotate(turn, velocity), spin

    def _frames(self, ids: Index) -> tuple[Array, Array]:
        """Place (k, 3) and attitude (k, 4) of the engine's frames in space."""
        if self._charts is None:
            return np.zeros((len(ids), 3)), np.tile(IDENTITY, (len(ids), 1))
        return self._charts.place[ids], self._charts.turn[ids]
