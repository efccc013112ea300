"""Motions of least reaction on the base: the optimisation behind planner reaction-null.

The reaction of a joint rate is R(q) q', zero along the reaction null space. Where the base has
stiffness |R dq|^2 = dq^T Q dq, its inertia frozen at the middle; a free-floating base must not
turn, and R q' is its rate of rotation, exact in direction, its inertia frozen likewise.
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import skew
from ves_gym.planners.coupling import blocks
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.mean_energy import MeanEnergy
from ves_gym.planners.momentum import BaseMomentum, momentum
from ves_gym.planners.prediction import NODES
from ves_gym.planners.query import Query
from ves_gym.system.system import System


class ReactionProblem(MotionProblem):
    """Mean square reaction of a query's motions, and their limits, by free control points x."""

    def __init__(self, query: Query, free: int) -> None:
        self._body: Array | None = None
        if not query.system.base.full()[2].any():
            self._body = query.system.base.mass_matrix[:6, :6]
        start, goal = query.ends
        weight = _weight(query.system, (start + goal) / 2)
        super().__init__(query, free, MeanSquare(weight, query.duration))

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples of what the base has to balance, and their derivative.

        Args:
            x: (free n,) control points [rad].

        Returns:
            Momentum (6 (N + 1),), of a free base the angular part about the common centre of
            mass (3 (N + 1),) [kg m^2/s], and its derivative (..., free n).
        """
        position, velocity = self._bases
        control = self.control(x)
        q = position @ control
        sample = momentum(self.arm, q, velocity @ control)
        if self._body is not None:
            sample = _about_centre(sample, inertia(self.arm, q)[:, :6, :6] + self._body)
        return self.chained(sample)

    def reaction(self, x: Array) -> float:
        """Root mean square reaction [J^(1/2)/s; of a free base rad/s]."""
        return float(np.sqrt(2 * self.energy.value(self.momentum(x)[0])))


class MeanSquare(MeanEnergy):
    """Half the mean over time of u^T weight u, in the place of E_mean.

    Args:
        weight: (k, k) of the samples u (N + 1, k) at the times `t`.
        duration: of the motions [s].
    """

    def __init__(self, weight: Array, duration: float) -> None:
        self.t = np.linspace(0, duration, NODES + 1)
        share = np.full(NODES + 1, 1 / NODES)  # of the trapezoid rule
        share[[0, -1]] /= 2
        self.hessian = np.asarray(np.kron(np.diag(share), weight), np.float64)

    def value(self, u: Array) -> float:
        """Half the mean square of samples u (k (N + 1),)."""
        return 0.5 * float(u @ self.hessian @ u)

    def force(self, u: Array) -> Array:
        """Its derivative by the samples (k (N + 1),)."""
        out: Array = self.hessian @ u
        return out


def _weight(system: System, at: Array) -> Array:
    """R^T R of the momentum (6, 6), or of a free base's angular one about the centre (3, 3)."""
    Mt, K = blocks(system, at).Mt, system.base.full()[2]
    if K.any():
        moved = np.linalg.inv(Mt)[:, :6]
        return np.asarray(moved.T @ K @ moved, np.float64)
    mass = Mt[0, 0]
    centre = skew(_centre(Mt))
    turned = np.linalg.inv(Mt[3:6, 3:6] - mass * centre @ centre.T)
    return np.asarray(turned.T @ turned, np.float64)


def _centre(M: Array) -> Array:
    """Centre of mass (..., 3) [m] from a spatial inertia (..., 6, 6)."""
    return np.stack([M[..., 5, 1], M[..., 3, 2], M[..., 4, 0]], axis=-1) / M[..., :1, 0]


def _about_centre(sample: BaseMomentum, M: Array) -> BaseMomentum:
    """Angular momentum of the joints about the common centre of mass, with derivatives.

    Args:
        sample: momentum of joint rates (N, 6).
        M: (N, 6, 6) inertia of arm and base.
    """
    u, by_q, by_v = sample
    centre, moved = _centre(M), by_v[:, :3] / M[:, :1, :1]  # its derivative by the joints
    push = u[:, :3]
    return BaseMomentum(
        u[:, 3:6] - np.cross(centre, push),
        by_q[:, 3:6]
        - np.cross(moved, push[:, :, None], axis=1)
        - np.cross(centre[:, :, None], by_q[:, :3], axis=1),
        by_v[:, 3:6] - np.cross(centre[:, :, None], by_v[:, :3], axis=1),
    )
