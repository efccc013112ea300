"""Frames in which free bodies are integrated, so that they tumble through any angle.

The equations of a body in free space are the same in every inertial frame at rest. So each
simulation has a frame, its *chart*, in which the engine's Z-Y-X angles stay away from
phi_y = +-90 deg: beyond `LEAVE` the chart is set where the body is, and the engine goes on from
pose zero with its rates turned. Until then the chart is the world, and nothing is converted.
docs/decisions/0021 says why.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.engine.backends.base import Backend
from ves_gym.mechanics import attitude
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.spatial import matvec, rate_matrix, twist, twist_rate

LEAVE = np.pi / 4  # rad, |phi_y| in the chart


def is_free(base: BaseModel) -> bool:
    """True if nothing ties a base to a place: it is a body, without M, D, K, drag and modes."""
    tied = any(np.any(part) for part in (base.M, base.D, base.K))
    drag = base.drag is not None and bool(np.any(base.drag))
    return base.body is not None and base.internal is None and not (tied or drag)


class Charts:
    """Charts of n simulations: where they are and how they are turned."""

    def __init__(self, n: int) -> None:
        self.place = np.zeros((n, 3))  # m, of the chart's origin
        self.turn = np.tile(attitude.IDENTITY, (n, 1))  # chart axes to inertial axes
        self._moved = np.zeros(n, bool)

    def reset(self, ids: Index) -> None:
        """Make the world the chart of simulations `ids`."""
        self.place[ids], self.turn[ids], self._moved[ids] = 0.0, attitude.IDENTITY, False

    def get_state(self) -> tuple[Array, ...]:
        """Everything needed to continue exactly from here."""
        return self.place.copy(), self.turn.copy(), self._moved.copy()

    def set_state(self, state: tuple[Any, ...]) -> None:
        """Return to a state handed out by `get_state`."""
        self.place[:], self.turn[:], self._moved[:] = state

    def recentre(self, backend: Backend, stopped: Index) -> Index:
        """Set charts where their bodies are, of all that have turned too far; return which.

        Args:
            backend: the engine, with its poses in the present charts.
            stopped: simulations that are left alone.
        """
        _, z, zd = backend.read()
        y, yd = z[:, :6], zd[:, :6]
        far = np.abs(y[:, 4]) > LEAVE
        far[stopped] = False
        ids = np.flatnonzero(far)
        if not len(ids):
            return ids
        moved = twist(y[ids], yd[ids])  # at pose zero the rates are the twist
        q, at = self.turn[ids], y[ids, :3]
        self.place[ids] += attitude.rotate(q, at)
        self.turn[ids] = attitude.normalised(
            attitude.product(q, attitude.from_angles(y[ids, 3:]))
        )
        self._moved[ids] = True
        backend.set_base(ids, np.zeros((len(ids), 6)), moved)
        return ids

    def outside(self, y: Array, yd: Array) -> tuple[Array, Array]:
        """Return inertial poses and rates.

        Args:
            y, yd: (n, 6) in the charts.

        Returns:
            (n, 6) each; rows whose chart is the world are as they were.
        """
        if not self._moved.any():
            return y, yd
        ids = np.flatnonzero(self._moved)
        y_out, yd_out = y.copy(), yd.copy()
        q, w = self.turn[ids], twist(y[ids], yd[ids])[:, 3:]
        y_out[ids, :3] = self.place[ids] + attitude.rotate(q, y[ids, :3])
        yd_out[ids, :3] = attitude.rotate(q, yd[ids, :3])
        phi = attitude.to_angles(attitude.product(q, attitude.from_angles(y[ids, 3:])))
        y_out[ids, 3:], yd_out[ids, 3:] = phi, attitude.angle_rates(phi, w)
        return y_out, yd_out

    def acceleration(self, y: Array, yd: Array, ydd: Array) -> Array:
        """Return Y'' (n, 6) of the inertial poses.

        Args:
            y, yd, ydd: (n, 6) in the charts.
        """
        if not self._moved.any():
            return ydd
        ids = np.flatnonzero(self._moved)
        pose, rate = (part[ids] for part in self.outside(y, yd))
        missing = twist_rate(y[ids], yd[ids], ydd[ids]) - twist_rate(
            pose, rate, np.zeros_like(rate)
        )
        out = ydd.copy()
        out[ids, :3] = matvec(attitude.to_matrix(self.turn[ids]), ydd[ids, :3])
        turn = rate_matrix(pose)[:, 3:, 3:]
        out[ids, 3:] = np.linalg.solve(turn, missing[:, 3:, None])[..., 0]
        return out
