"""What a motion is judged by: E_mean, and bounds on vectors that are linear in its momentum.

With the inertia frozen at one configuration, or taken along one motion, the base is linear and
E_mean a quadratic form in the joint momentum u (`MeanEnergy`). Accelerations of the base are
linear in u, and a bound on their norm is enforced by `Lagrangian`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

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
    Transport,
    hold,
    inertia_along,
    running_integral,
)
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System


class QuadraticForm:
    """1/2 u^T W u + g^T u + c: W `hessian`, g `gradient`, c `constant`, u momenta at `t`."""

    t: Array  # (N,) s
    linear: LinearBase

    def __init__(self, form: Array) -> None:
        """Of (u, 1)^T form (u, 1), symmetric."""
        self.hessian: Array = np.ascontiguousarray(2 * form[:-1, :-1])
        self.gradient: Array = 2 * form[:-1, -1]
        self.constant = float(form[-1, -1])

    def of(self, motion: Motion) -> float:
        """Value of a motion [J]."""
        return self.value(self.linear.load(motion, self.t).ravel())

    def value(self, u: Array) -> float:
        return float(0.5 * u @ self.hessian @ u + self.gradient @ u) + self.constant

    def force(self, u: Array) -> Array:
        """Derivative of `value`."""
        return np.asarray(self.hessian @ u + self.gradient)

    def curvature(self, u: Array, slope: Array) -> Array:
        """slope^T W slope (k, k): second derivative of `value` along `slope` of u."""
        return np.asarray(slope.T @ (self.hessian @ slope))


class MeanEnergy(QuadraticForm):
    """E_mean of a motion [J] as a quadratic form, with the inertia frozen at `at`.

    Of the samples u (N + 1, 6) of the joint momentum H_bm(q) q' at the times `t`, held linear
    between them; `gradient` and `constant` are zero where base and joints start at rest.

    Where flexures or gears give way a sample has the torque that they have to give as well,
    integrated over time [N m s] (`LinearBase.load`); with `described`, the arm that the servo's
    feed-forward goes by, also that which the motors need beyond it.

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
        start: (n,) where the motions start [rad], for a pointing law; None: see `LinearBase`.
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
        start: Array | None = None,
    ) -> None:
        if servo is not None and described not in (None, system.arm):
            servo = replace(servo, moving_base=False)  # to what it lacks, joints yield
        start = at.start if isinstance(at, Motion) else start
        self.linear = LinearBase(system, servo, start)
        self.inputs, self.described = self.linear.driven, None
        if described not in (None, system.arm) and len(self.linear.motors):
            self.described = described
            self.inputs = np.r_[self.inputs, self.linear.motors]
        self.t = np.linspace(0, duration, nodes + 1)
        self.system, self.at = system, at
        M, middle = inertia_along(self.linear, at, self.t)
        along = between = None
        if isinstance(at, Motion):
            half = (self.t[1:] + self.t[:-1]) / 2
            along, between = (self.linear.transport(at, t) for t in (self.t, half))
        A, B = self.linear.plant(middle, between)
        steps = hold(A, B[..., self.inputs], self.t[1])
        pushed = np.zeros(len(self.linear.driven))
        pushed[:6] = 0.0 if momentum is None else momentum
        start_state = self.linear.begin(M[0], base, pushed, along)
        super().__init__(self._form(M, steps, start_state, along))

    def of(self, motion: Motion) -> float:
        """E_mean of a motion [J]."""
        u = self.linear.load(motion, self.t)
        if self.described is not None:
            s = motion.at(self.t)
            needed, fed = (
                inverse_dynamics(arm, s.q, s.v, s.a)[0]
                for arm in (self.system.arm, self.described)
            )
            u = np.hstack([u, running_integral(needed - fed, self.t)])
        return self.value(u.ravel())

    def _form(
        self,
        M: Array,
        steps: tuple[Array, Array, Array],
        start: Array,
        along: Transport | None,
    ) -> Array:
        """E_mean as a form of all samples and 1, from the response to each of them."""
        linear, N, duration, m = self.linear, len(self.t), float(self.t[-1]), len(self.inputs)
        size, b = linear.size, linear.b
        # response of the state at node k to u at node j, and last of all to the start
        states = np.zeros((N, 2 * size, m * N + 1))
        states[0, :, -1] = start
        for k in range(N - 1):
            i = k if len(steps[0]) > 1 else 0  # one step is all of them where inertia is frozen
            Phi, first, second = steps[0][i], steps[1][i], steps[2][i]
            done = m * k + m
            states[k + 1, :, :done] = Phi @ states[k, :, :done]
            states[k + 1, :, -1] = Phi @ states[k, :, -1]
            states[k + 1, :, done - m : done] += first
            states[k + 1, :, done : done + m] = second
        # E_k = 1/2 |R_K z|^2 + 1/2 |R_M z'|^2 with z' = (M^-1 (P - u))[:b], x's part off P
        speed = root(linear.base_mass(M)) @ np.linalg.inv(M)[:, :b]
        rows = np.empty((N, 2 * b, m * N + 1))
        rows[:, :b] = root(linear.base_stiffness) @ states[:, :b]
        held_states = states[:, size:]
        if along is not None:
            held_states = held_states - along.momentum @ states[:, :size]
        rows[:, b:] = speed @ held_states
        for k in range(N):
            direct = speed[k if len(speed) > 1 else 0][:, self.inputs]
            rows[k, b:, m * k : m * k + m] -= direct
        weight = np.full(N, self.t[1])
        weight[[0, -1]] /= 2
        rows *= np.sqrt(weight / (duration + TAIL))[:, None, None]
        flat, last = rows.reshape(2 * b * N, -1), states[-1]
        tail = linear.tail(M[-1]) / (duration + TAIL)
        return np.asarray(flat.T @ flat / 2 + last.T @ tail @ last, np.float64)


class Lagrangian:
    """E_mean under bounds |y_k| <= 1 on vectors, by an augmented Lagrangian.

    With multipliers m_k, the straight line's energy E_0 and a penalty p,

        L = E_mean + E_0 / (2 p) sum_k (max(0, m_k + p (|y_k| - 1))^2 - m_k^2)

    is smooth; `update` makes m_k the forces that hold the bounds (Hestenes 1969, Powell 1969).

    Args:
        energy: of the first samples.
        scale: E_0 [J].
        parts: (G, r) number and size of the vectors that follow, part by part.
        penalty: p.
    """

    def __init__(
        self,
        energy: QuadraticForm,
        scale: float,
        parts: Sequence[tuple[int, int]],
        penalty: float,
    ) -> None:
        self.energy, self.scale, self.penalty = energy, scale, penalty
        self.t, self._n = energy.t, len(energy.gradient)
        ends = self._n + np.cumsum([0, *(count * size for count, size in parts)])
        self._parts = [(slice(*ends[k : k + 2]), shape) for k, shape in enumerate(parts)]
        self._multipliers = [np.zeros(count) for count, _ in parts]

    def _forces(self, u: Array) -> Iterator[tuple[slice, Array, Array, Array]]:
        """Of every part where it lies in u, its vectors (G, r), their norms, and the forces."""
        for (at, shape), last in zip(self._parts, self._multipliers, strict=True):
            y = u[at].reshape(shape)
            size = np.linalg.norm(y, axis=1)
            yield at, y, size, np.maximum(0.0, last + self.penalty * (size - 1))

    def value(self, u: Array) -> float:
        """L [J] of samples and vectors u."""
        total = sum(float(force @ force) for *_, force in self._forces(u))
        before = sum(float(m @ m) for m in self._multipliers)
        extra = self.scale * (total - before) / (2 * self.penalty)
        return self.energy.value(u[: self._n]) + extra

    def force(self, u: Array) -> Array:
        """Derivative of `value`."""
        out = np.zeros_like(u)
        out[: self._n] = self.energy.force(u[: self._n])
        for at, y, size, force in self._forces(u):
            pull = force / np.maximum(size, _TINY)
            out[at] = self.scale * (pull[:, None] * y).ravel()
        return out

    def curvature(self, u: Array, slope: Array) -> Array:
        """Second derivative of `value` along `slope` of u (k, k)."""
        out = self.energy.curvature(u[: self._n], slope[: self._n])
        for at, y, size, force in self._forces(u):
            on = force > 0
            rows = slope[at].reshape(*y.shape, -1)[on]
            pull = force[on] / size[on]  # curves a sphere across, the penalty along its normal
            normal = np.einsum("kr,krc->kc", y[on] / size[on, None], rows)
            flat = (np.sqrt(pull)[:, None, None] * rows).reshape(-1, slope.shape[1])
            out = out + self.scale * (
                flat.T @ flat + (normal.T * (self.penalty - pull)) @ normal
            )
        return np.asarray(out)

    def update(self, u: Array, steeper: float, most: float) -> None:
        """Make the forces at u the multipliers, and the penalty steeper, up to `most`."""
        self._multipliers = [force for *_, force in self._forces(u)]
        self.penalty = min(steeper * self.penalty, most)


_TINY = 1e-12  # of a bound
