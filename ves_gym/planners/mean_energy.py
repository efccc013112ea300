"""E_mean of a motion as a quadratic form in the momentum of its joints.

With the inertia frozen at one configuration, or taken along one motion, the base is linear and
its energy a quadratic form: what `direct` minimises. Where the servo goes by another arm than
the one that moves, the torque that it lacks is an input beside the momentum.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.modes import root
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.prediction import (
    NODES,
    BaseState,
    LinearBase,
    hold,
    inertia_along,
    joint_momentum,
)
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System


class MeanEnergy:
    """E_mean of a motion as a quadratic function, with the inertia frozen at `at`.

    E_mean = 1/2 u^T W u + g^T u + c over the samples u (N + 1, 6) of the joint momentum
    H_bm(q) q' at the times `t`; u is held linear between them. W is `hessian`, g `gradient`
    and c `constant`; the latter are zero where base and joints start at rest.

    With `described`, the arm that the servo's feed-forward goes by, a sample has 6 + n numbers:
    the torque that the arm needs beyond that, integrated over time [N m s], is an input of the
    joints as the momentum is one of the base.

    Args:
        system: arm and vehicle.
        at: (n,) configuration of the frozen inertia [rad], or a motion of the duration: the
            inertia is then that along it.
        duration: of the motions [s].
        servo: that moves them; None: they follow exactly.
        nodes: steps.
        base: its motion at the start; None: at rest.
        momentum: (6,) of the joints at the start; None: at rest.
        described: arm by which the servo is fed forward; None: the system's.
    """

    def __init__(
        self,
        system: System,
        at: npt.ArrayLike | Motion,
        duration: float,
        servo: JointServo | None = None,
        nodes: int = NODES,
        *,
        base: BaseState | None = None,
        momentum: Array | None = None,
        described: Arm | None = None,
    ) -> None:
        self.linear = LinearBase(system, servo)
        self.described: Arm | None = None
        if described not in (None, system.arm) and self.linear.size > self.linear.b:
            self.described = described
        self.inputs = 6 if self.described is None else 6 + system.arm.n
        self.t = np.linspace(0, duration, nodes + 1)
        self.system, self.at = system, at
        u0 = np.zeros(6) if momentum is None else momentum
        self._M, middle = inertia_along(self.linear, at, self.t)
        A, B = self.linear.plant(middle)
        driven = self.linear.seen[: self.inputs]
        self._steps = list(zip(*hold(A, B[..., driven], self.t[1]), strict=True))
        self._start = None
        if base is not None or u0.any():
            self._start = self.linear.begin(self._mass_at(0), base, u0)
        self._form()

    def of(self, motion: Motion) -> float:
        """E_mean of a motion [J]."""
        u = joint_momentum(self.system, motion, self.t)
        if self.described is not None:
            s = motion.at(self.t)
            needed, fed = (
                inverse_dynamics(arm, s.q, s.v, s.a)[0]
                for arm in (self.system.arm, self.described)
            )
            u = np.hstack([u, running_integral(self.t) @ (needed - fed)])
        return self.value(u.ravel())

    def value(self, u: Array) -> float:
        """E_mean [J] of momenta u (6 (N + 1),)."""
        quadratic_part = 0.5 * float(u @ self.hessian @ u)
        if self._start is None:
            return quadratic_part
        return quadratic_part + float(self.gradient @ u) + self.constant

    def force(self, u: Array) -> Array:
        """Derivative of `value` (6 (N + 1),)."""
        out: Array = self.hessian @ u
        return out if self._start is None else out + self.gradient

    def curvature(self, u: Array, slope: Array) -> Array:
        """slope^T W slope (k, k): the same for all u, for slopes (6 (N + 1), k)."""
        out: Array = slope.T @ (self.hessian @ slope)
        return out

    def _mass_at(self, k: int) -> Array:
        out: Array = self._M[k if len(self._M) > 1 else 0]
        return out

    def _form(self) -> None:
        """Make W [J / (kg m/s)^2], g [J / (kg m/s)] and c [J] of N + 1 samples."""
        linear, N, duration, m = self.linear, len(self.t), float(self.t[-1]), self.inputs
        size, b = linear.size, linear.b
        # response of the state at node k to u at node j, and last of all to the start
        states = np.zeros((N, 2 * size, m * N + 1))
        if self._start is not None:
            states[0, :, -1] = self._start
        for k in range(N - 1):
            Phi, first, second = self._steps[k if len(self._steps) > 1 else 0]
            done = m * k + m
            states[k + 1, :, :done] = Phi @ states[k, :, :done]
            states[k + 1, :, -1] = Phi @ states[k, :, -1]
            states[k + 1, :, done - m : done] += first
            states[k + 1, :, done : done + m] = second
        # E_k = 1/2 |R_K z|^2 + 1/2 |R_M z'|^2 with z' = (M^-1 (P - u))[:b]
        pose = root(linear.base_stiffness)
        speed = np.stack([root(M[:b, :b]) @ np.linalg.inv(M)[:b] for M in self._M])
        driven = linear.seen[:m]
        rows = np.empty((N, 2 * b, m * N + 1))
        rows[:, :b] = pose @ states[:, :b]
        rows[:, b:] = speed @ states[:, size:]
        for k in range(N):
            rows[k, b:, m * k : m * k + m] -= speed[k if len(speed) > 1 else 0][:, driven]
        weight = np.full(N, self.t[1])
        weight[[0, -1]] /= 2
        rows *= np.sqrt(weight / (duration + TAIL))[:, None, None]
        flat = rows.reshape(2 * b * N, -1)
        tail = 2 / (duration + TAIL) * linear.tail(self._mass_at(-1))
        last = states[-1]
        whole = flat.T @ flat + last.T @ tail @ last
        self.hessian: Array = np.ascontiguousarray(whole[:-1, :-1])
        self.gradient: Array = whole[:-1, -1].copy()
        self.constant = 0.5 * float(whole[-1, -1])


def running_integral(t: Array) -> Array:
    """Matrix (N, N) that integrates samples at evenly spaced times from the first on.

    By the trapezoidal rule.

    Args:
        t: (N,) times [s].
    """
    weight = np.tril(np.full((len(t), len(t)), t[1] - t[0]), -1)
    weight[:, 0] /= 2
    np.fill_diagonal(weight, (t[1] - t[0]) / 2)
    weight[0] = 0.0
    return weight
