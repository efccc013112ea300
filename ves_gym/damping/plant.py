"""Arm and base linearised about rest, closed by joint gains: what PPED tunes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, finite
from ves_gym.engine.linear import linearise_ideal
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.coupling import blocks
from ves_gym.system.system import System


class GainMatrices(NamedTuple):
    """Joint gains, each (n, n), symmetric: tau = -K (q - q0) - B q'."""

    K: Array  # N m/rad
    B: Array  # N m s/rad

    @staticmethod
    def of(servo: JointServo) -> GainMatrices:
        """The diagonal gains of a servo."""
        return GainMatrices(np.diag(servo.kp), np.diag(servo.kd))


@dataclass(frozen=True, eq=False, kw_only=True)
class LinearPlant:
    """x' = free x + drive u, closed by u = -K s - B s' with s = port z; about rest.

    x stacks z and z', each of width w; z starts with the base's Y and ends with its m
    internal modes u. For joint gains z is (Y, q - q0, u) and s the joints.
    """

    free: Array  # (2 w, 2 w)
    drive: Array  # (2 w, n)
    port: Array  # (n, w)
    displacement_map: Array  # (w, 6) z of a displaced base with s = 0
    K: Array  # (6 + m, 6 + m) of the base over (Y, u)
    mass: Array  # (6 + m, 6 + m) of the base with the joints locked, M_t [kg, kg m, kg m^2]

    @property
    def stiffness(self) -> Array:
        """(6, 6) of the base at rest under loads on its interface [N/m, N, N m]."""
        if len(self.K) == 6:
            return self.K
        inner = np.linalg.solve(self.K[6:, 6:], self.K[6:, :6])
        static: Array = self.K[:6, :6] - self.K[:6, 6:] @ inner
        return (static + static.T) / 2

    @property
    def _base(self) -> tuple[Array, Array]:
        """Places of the base's coordinates in z, as a grid."""
        w = len(self.free) // 2
        at = np.r_[:6, w - len(self.K) + 6 : w]
        return at[:, None], at

    @property
    def n(self) -> int:
        """Number of controlled coordinates."""
        return len(self.port)

    def closed(self, gains: GainMatrices) -> Array:
        """(2 w, 2 w) A of x' = A x under gains."""
        feedback = np.hstack([gains.K @ self.port, gains.B @ self.port])
        return self.free - self.drive @ feedback

    def start(self, y: npt.ArrayLike) -> Array:
        """(2 w,) x of the base displaced by y (6,) [m, rad] and let go."""
        displaced = self.displacement_map @ finite(y, (6,), "y")
        return np.r_[displaced, np.zeros_like(displaced)]

    @property
    def strain(self) -> Array:
        """(2 w, 2 w) S of the strain energy x^T S x [J]."""
        S = np.zeros_like(self.free)
        S[self._base] = self.K / 2
        return S

    @property
    def total(self) -> Array:
        """(2 w, 2 w) S of the base energy E = x^T S x, kinetic and strain [J]."""
        S, w = self.strain, len(self.free) // 2
        rows, columns = self._base
        S[rows + w, columns + w] = self.mass / 2
        return S


def plants(system: System, q: npt.ArrayLike) -> list[LinearPlant]:
    """Return the linear models of arm and base at configurations.

    Args:
        system: arm and vehicle, on motor drives.
        q: (m, n) configurations [rad].

    Returns:
        m models.

    Raises:
        ParameterError: mode emulated, a prescribed drive, or a base without stiffness.
    """
    if system.drive != "motor":
        raise ParameterError(f"PPED sets motor gains: it needs drive motor, not {system.drive}")
    K = system.base.K
    stiffest = np.linalg.eigvalsh(K)
    if stiffest[0] <= 1e-12 * stiffest[-1]:
        raise ParameterError(
            "PPED needs a base with stiffness in all six directions (what is damped is its"
            f" strain energy), got a stiffness matrix with eigenvalue {stiffest[0]:.3g}"
        )
    angles = np.atleast_2d(np.asarray(q, float))
    linear = linearise_ideal(system, angles)
    n, base = system.arm.n, system.base
    w = 6 + n + base.m
    masses = blocks(system, angles).Mt
    port = np.eye(w)[6 : 6 + n]
    displacement_map = np.vstack([np.eye(6), np.zeros((n, 6)), base.attached(np.eye(6)).T])
    return [
        LinearPlant(
            free=A,
            drive=B,
            port=port,
            displacement_map=displacement_map,
            K=base.full()[2],
            mass=mass,
        )
        for A, B, mass in zip(linear.A, linear.B.reshape(-1, 2 * w, n), masses, strict=True)
    ]


def plant_at(system: System, q: npt.ArrayLike) -> LinearPlant:
    """Return the linear model of arm and base at one configuration.

    Args:
        system: arm and vehicle, on motor drives.
        q: (n,) configuration [rad].

    Returns:
        The model.

    Raises:
        ParameterError: as `plants`, or a joint beyond its limits.
    """
    return plants(system, system.arm.require_within_limits(q))[0]
