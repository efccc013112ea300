"""Estimate the motion of a base from its measured pose: a Kalman filter on the linear base.

Between measurements the base moves as `prediction.LinearBase` says, driven by the momentum of
the joints, which is known; what it does not know of is a wrench of white noise. So rates are
found, and internal modes, which nothing measures.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.linalg

from ves_gym._util.params import Array
from ves_gym.planners.prediction import BaseState, LinearBase, hold
from ves_gym.system.system import System

# Standard deviations, this project: what is unknown of the motion against what is of a pose.
_WRENCH = 2.0  # N s^0.5, N m s^0.5
_MODE = 1.0  # kg^0.5 m/s^1.5, the same as of a wrench, on internal modes
_POSE = 1e-4  # m, rad


class BaseObserver:
    """Estimates (x, P) of the bases in n simulations, each with its inertia frozen.

    x (b) are pose and internal coordinates, P (b) is the momentum of base and joints.

    Args:
        system: arm and vehicle.
        at: (n, joints) configurations [rad].
        dt: between measurements [s].
    """

    def __init__(self, system: System, at: npt.ArrayLike, dt: float) -> None:
        angles = np.atleast_2d(np.asarray(at, float))
        # what the sensor sees does not tell a gear's or a link's deflection
        self._linear = LinearBase(system.replace(arm=system.arm.rigid()))
        b = self.b = self._linear.b
        self._M = self._linear.mass(self._linear.inertia(angles))
        A, B = self._linear.plant(self._M)
        n, size = len(angles), 2 * b
        self._Phi, *drive = hold(A, B[..., :6], dt)
        self._drive = np.stack(drive)
        # a mode that nothing unknown ever moved would be believed for good
        force = np.r_[np.full(6, _WRENCH), np.full(b - 6, _MODE)]
        unknown = np.vstack([np.zeros((b, b)), np.diag(force) * np.sqrt(dt)])
        noise = _POSE**2 * np.eye(6)
        C = np.eye(6, size)
        gains = []
        for Phi in self._Phi:
            floor = 1e-18 * np.eye(size)  # keeps the Riccati equation regular
            S = scipy.linalg.solve_discrete_are(Phi.T, C.T, unknown @ unknown.T + floor, noise)
            gains.append(S @ C.T @ np.linalg.inv(C @ S @ C.T + noise))
        self._gain = np.stack(gains)
        self.s = np.zeros((n, size))

    def begin(self, y: Array, yd: Array, u: Array) -> None:
        """Start from measured motion y, yd (n, 6), internal modes carried along.

        The joints' momentum is u (n, 6).
        """
        start = [
            self._linear.coordinates(BaseState(y=tuple(a.tolist()), yd=tuple(b.tolist())))
            for a, b in zip(y, yd, strict=True)
        ]
        z, zd = (np.stack(part) for part in zip(*start, strict=True))
        self.s = np.concatenate([z, (self._M @ zd[..., None])[..., 0]], axis=1)
        self.s[:, self.b : self.b + 6] += u

    def ahead(self, s: Array, before: Array, after: Array) -> Array:
        """States (n, 2 b) one step on, the joints' momentum (n, 6) linear between its ends."""
        moved = self._Phi @ s[..., None]
        for drive, u in zip(self._drive, (before, after), strict=True):
            moved += drive @ u[..., None]
        return np.asarray(moved[..., 0])

    def step(self, before: Array, after: Array, y: Array) -> None:
        """Go one step on (`ahead`) and take measured poses y (n, 6) into account."""
        s = self.ahead(self.s, before, after)
        self.s = s + (self._gain @ (y - s[:, :6])[..., None])[..., 0]

    def base_state(self, i: int, s: Array, u: Array) -> BaseState:
        """Return the motion of base i of state s (2 b,), its joints' momentum u (6,)."""
        P = s[self.b :].copy()
        P[:6] -= u
        return self._linear.base_state(s[: self.b], np.linalg.solve(self._M[i], P))
