"""Direct minimisation of the predicted E_mean over smooth motions.

With the base mass frozen at the middle of the straight line, E_mean = 1/2 u^T W u in
the samples u of the joint momentum H_bm(q) q' (`MeanEnergy`). The decision is
the inner control points of a B-spline; position and speed limits are linear in them,
on the control polygon, so they hold at every instant, not only at samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.optimize

from ves_gym.core.arm import matrix
from ves_gym.core.dynamics import inertia
from ves_gym.core.motion import DEGREE, Motion, basis, knots, limit_ratios
from ves_gym.core.params import Array
from ves_gym.core.spatial import matvec
from ves_gym.planners.prediction import MeanEnergy
from ves_gym.planners.query import Query

_FIXED = 3  # control points held at each end
_TIGHTENINGS = 4  # attempts at keeping the torque limits
_LEAST_SHARE = 0.3  # of the acceleration limits; tighter ones leave no motion
_DIFFERENCE = 1e-6  # rad, central differences of the momentum: error about 1e-9


class Direct:
    """Minimise the predicted E_mean over B-spline motions by sequential programming."""

    name = "direct"
    summary = "minimise predicted E_mean over a smooth motion (B-spline, exact limits)"

    def __init__(self, free: int = 10, iterations: int = 60) -> None:
        self.free, self.iterations = free, iterations

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Deterministic: the seed is not used; one start, the straight line.

        A motion that asks too much torque is found again under tighter acceleration
        limits.
        """
        share = 1.0
        for _ in range(_TIGHTENINGS):
            motion, info = self._minimise(_Problem(query, self.free, share))
            torque = float(limit_ratios(query.system.arm, motion)["torque"].max())
            if query.system.drive != "motor" or torque <= 1 or share < _LEAST_SHARE:
                break
            share *= 0.95 / torque
        return motion, {**info, "acceleration_share": share}

    def _minimise(self, problem: _Problem) -> tuple[Motion, dict[str, Any]]:
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

    def __init__(self, query: Query, free: int, acceleration_share: float) -> None:
        self.a_max = acceleration_share * query.system.arm.column("a_max")
        self.query, self.arm = query, query.system.arm
        self.start, self.goal = query.ends
        self._motor = query.system.drive == "motor"
        self.n, self.m = self.arm.n, free + 2 * _FIXED
        middle = (self.start + self.goal) / 2
        self.energy = MeanEnergy(query.system, middle, query.duration, query.servo)
        u = self.energy.t / query.duration
        self.position = basis(self.m, u)  # (N + 1, m)
        self.velocity = basis(self.m, u, 1) / query.duration
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
        """Speed and acceleration limits on the control polygons of the spline's derivatives.

        The arm's acceleration limits keep the joint torque within reach of its motors.
        """
        t = knots(self.m) * self.query.duration
        rows, points = [], np.eye(self.m)
        limits = [self.query.v_max, self.a_max if self._motor else None]
        for order, limit in enumerate(limits, start=1):
            degree = DEGREE - order + 1
            span = t[DEGREE + 1 : self.m + DEGREE + 1 - order] - t[order : self.m]
            points = degree * np.diff(points, axis=0) / span[:, None]
            if limit is not None:
                rows.append(np.kron(points, np.diag(1 / np.asarray(limit))))
        if not rows:
            return []
        stacked = np.vstack(rows)  # on control.ravel(); each entry within +-1
        free = slice(_FIXED * self.n, (self.m - _FIXED) * self.n)
        A, offset = (
            stacked[:, free],
            stacked @ self.control(np.zeros(self.straight.size)).ravel(),
        )
        active = np.abs(A).max(axis=1) > 0
        A, offset = A[active], offset[active]
        jacobian = np.vstack([-A, A])
        room = np.concatenate([1 - offset, 1 + offset])
        return [
            {"type": "ineq", "fun": lambda x: room + jacobian @ x, "jac": lambda x: jacobian}
        ]
