"""Direct minimisation of the predicted E_mean over smooth motions.

With the base mass frozen at the middle of the straight line, E_mean = 1/2 u^T W u in
the samples u of the joint momentum H_bm(q) q' (`MeanEnergy`). The decision is
the inner control points of a B-spline; position and speed limits are linear in them,
on the control polygon, so they hold at every instant. Motor torque is kept inside its
limits at sampled times.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.optimize

from ves_gym.core.arm import matrix
from ves_gym.core.dynamics import inertia, inverse_dynamics
from ves_gym.core.motion import DEGREE, Motion, basis, graded, knots
from ves_gym.core.params import Array
from ves_gym.core.spatial import matvec
from ves_gym.planners.prediction import MeanEnergy
from ves_gym.planners.query import Query

_FIXED = 3  # control points held at each end
_SPEED_SHARE = 1 - 1e-4  # of the limit: more than the optimiser's tolerance
_TORQUE_SAMPLES = 81
_TORQUE_SHARE = 0.97  # of the limit, at samples: leaves room between them and for the servo
_DIFFERENCE = 1e-6  # central differences of momentum and torque: error about 1e-9


class Direct:
    """Minimise the predicted E_mean over B-spline motions by sequential programming."""

    name = "direct"
    summary = "minimise predicted E_mean over a smooth motion inside all joint limits"

    def __init__(self, free: int = 12, iterations: int = 150) -> None:
        self.free, self.iterations = free, iterations

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Deterministic: the seed is not used; one start, the straight line."""
        problem = _Problem(query, self.free)
        x0 = problem.straight
        scale = max(problem.value(x0)[0], 1e-12)  # SLSQP's tolerance is absolute
        found = scipy.optimize.minimize(
            lambda x: tuple(part / scale for part in problem.value(x)),
            x0,
            jac=True,
            method="SLSQP",
            bounds=problem.bounds,
            constraints=problem.constraints,
            options={"maxiter": self.iterations, "ftol": 1e-5},
        )
        return problem.motion(found.x), {
            "evaluations": int(found.nfev),
            "iterations": int(found.nit),
            "message": str(found.message),
        }


class _Problem:
    """E_mean of a query's motions as a function of the free control points."""

    def __init__(self, query: Query, free: int) -> None:
        self.query, self.arm = query, query.system.arm
        self.start, self.goal = query.ends
        self.n, self.m = self.arm.n, free + 2 * _FIXED
        middle = (self.start + self.goal) / 2
        self.energy = MeanEnergy(query.system, middle, query.duration, query.servo)
        u = self.energy.t / query.duration
        self.position = basis(self.m, u)  # (N + 1, m)
        self.velocity = basis(self.m, u, 1) / query.duration
        at = graded(_TORQUE_SAMPLES)
        self._torque_bases = [
            basis(self.m, at, order) / query.duration**order for order in range(3)
        ]
        self._tau_max = _TORQUE_SHARE * self.arm.column("tau_max")
        # the straight quintic lies in the spline space, so its fit is exact
        self.straight = np.array(
            Motion.fit(
                query.straight.at(np.linspace(0, query.duration, 200)).q,
                query.duration,
                controls=self.m,
            ).control
        )[_FIXED:-_FIXED].ravel()

    def control(self, x: Array) -> Array:
        """(m, n) control points from the free ones."""
        inner = x.reshape(-1, self.n)
        return np.vstack([[self.start] * _FIXED, inner, [self.goal] * _FIXED])

    def motion(self, x: Array) -> Motion:
        """The motion of a decision."""
        return Motion(duration=self.query.duration, control=matrix(self.control(x)))

    def value(self, x: Array) -> tuple[float, Array]:
        """E_mean [J] and its gradient."""
        control = self.control(x)
        q, v = self.position @ control, self.velocity @ control
        shifted = np.stack(
            [q] + [q + s * d for d in np.eye(self.n) for s in (_DIFFERENCE, -_DIFFERENCE)]
        )
        H = inertia(self.arm, shifted)[..., :6, 6:]
        momenta = matvec(H, np.broadcast_to(v, shifted.shape))  # (1 + 2n, N + 1, 6)
        u = momenta[0]
        force = (self.energy.hessian @ u.ravel()).reshape(u.shape)  # dE/du
        by_q = (momenta[1::2] - momenta[2::2]) / (2 * _DIFFERENCE)  # (n, N + 1, 6)
        dq = np.einsum("jkc,kc->kj", by_q, force)
        dv = np.einsum("kcj,kc->kj", H[0], force)
        gradient = self.position.T @ dq + self.velocity.T @ dv
        return 0.5 * float(np.sum(u * force)), gradient[_FIXED:-_FIXED].ravel()

    @property
    def bounds(self) -> scipy.optimize.Bounds:
        """Joint limits: a B-spline stays inside the hull of its control points."""
        free = self.m - 2 * _FIXED
        low, high = self.arm.column("q_min"), self.arm.column("q_max")
        return scipy.optimize.Bounds(np.tile(low, free), np.tile(high, free))

    @property
    def constraints(self) -> list[dict[str, Any]]:
        """Inequalities f(x) >= 0: the query's speed limits, and on motors the torque's."""
        out = []
        if self.query.v_max is not None:
            room, jacobian = self._speed_limits(_SPEED_SHARE * np.array(self.query.v_max))
            out.append(
                {
                    "type": "ineq",
                    "fun": lambda x: room + jacobian @ x,
                    "jac": lambda x: jacobian,
                }
            )
        if self.query.system.drive == "motor":
            out.append({"type": "ineq", "fun": self.torque_room, "jac": self.torque_slope})
        return out

    def _speed_limits(self, v_max: Array) -> tuple[Array, Array]:
        """room + jacobian @ x >= 0 on the control polygon of the velocity spline."""
        t = knots(self.m) * self.query.duration
        span = t[DEGREE + 1 : self.m + DEGREE] - t[1 : self.m]
        speed = DEGREE * np.diff(np.eye(self.m), axis=0) / span[:, None]
        rows = np.kron(speed, np.diag(1 / v_max))  # on control.ravel(); within +-1
        free = slice(_FIXED * self.n, (self.m - _FIXED) * self.n)
        A, offset = rows[:, free], rows @ self.control(np.zeros(self.straight.size)).ravel()
        active = np.abs(A).max(axis=1) > 0
        A, offset = A[active], offset[active]
        return np.concatenate([1 - offset, 1 + offset]), np.vstack([-A, A])

    def torque_room(self, x: Array) -> Array:
        """How far each joint torque is inside its limit, at sampled times: (2 K n,)."""
        tau = self._torque(*self._sampled(x))
        return np.concatenate([1 - tau.ravel(), 1 + tau.ravel()])

    def torque_slope(self, x: Array) -> Array:
        """Derivative of `torque_room`: (2 K n, free n)."""
        sampled = self._sampled(x)
        steps = _DIFFERENCE * np.eye(self.n)[:, None, :]
        slope = np.zeros((len(self._torque_bases[0]), self.n, self.m, self.n))
        for k, basis_k in enumerate(self._torque_bases):
            shifted = [np.broadcast_to(s, (self.n, *s.shape)) for s in sampled]
            ahead, behind = list(shifted), list(shifted)
            ahead[k], behind[k] = shifted[k] + steps, shifted[k] - steps
            change = self._torque(*ahead) - self._torque(*behind)
            by = change / (2 * _DIFFERENCE)  # (n inputs, K, n torques)
            slope += np.einsum("iko,km->komi", by, basis_k)
        flat = slope[:, :, _FIXED : self.m - _FIXED].reshape(-1, x.size)
        return np.vstack([-flat, flat])

    def _torque(self, q: Array, v: Array, a: Array) -> Array:
        """Joint torque over its limit, on a base that stands still."""
        return inverse_dynamics(self.arm, q, v, a)[0] / self._tau_max

    def _sampled(self, x: Array) -> list[Array]:
        """q, v, a at the times where torque is checked, each (K, n)."""
        control = self.control(x)
        return [b @ control for b in self._torque_bases]
