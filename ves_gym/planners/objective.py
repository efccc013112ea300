"""What a motion is judged by: E_mean, and with weights the disturbance of base and tool.

With the inertia frozen at one configuration, or taken along one motion, the base is linear and
E_mean a quadratic form in the joint momentum u (`MeanEnergy`). Other measures are functions of
u as well: mean squares, the weighted energy and values at the end are quadratic forms; the
square of a peak is replaced by the smooth, convex (mean |a|^p)^(2/p), a little below it. A
measure counts as a share of the straight line's,

    J = w_E E_mean + E_mean,0 sum_m w_m (m / m_0)^2     (E_weighted / E_weighted,0 not squared),

so J is an energy, and a weight of 1 makes the straight line's measure as dear as its energy.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, require_one_of
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.modes import root
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.linear_response import ENDS, MEANS, PEAKS, LinearResponse
from ves_gym.planners.prediction import (
    NODES,
    BaseState,
    LinearBase,
    Transport,
    hold,
    inertia_along,
    running_integral,
)
from ves_gym.system.disturbance import MEASURES
from ves_gym.system.energy import TAIL
from ves_gym.system.frequency_weight import FrequencyWeight
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
        speed = np.stack([root(linear.base_mass(Mk)) @ np.linalg.inv(Mk)[:b] for Mk in M])
        rows = np.empty((N, 2 * b, m * N + 1))
        rows[:, :b] = root(linear.base_stiffness) @ states[:, :b]
        own = states[:, size:]
        if along is not None:
            own = own - along.momentum @ states[:, :size]
        rows[:, b:] = speed @ own
        for k in range(N):
            direct = speed[k if len(speed) > 1 else 0][:, self.inputs]
            rows[k, b:, m * k : m * k + m] -= direct
        weight = np.full(N, self.t[1])
        weight[[0, -1]] /= 2
        rows *= np.sqrt(weight / (duration + TAIL))[:, None, None]
        flat, last = rows.reshape(2 * b * N, -1), states[-1]
        tail = linear.tail(M[-1]) / (duration + TAIL)
        return np.asarray(flat.T @ flat / 2 + last.T @ tail @ last, np.float64)


ENERGY = "energy"  # the weight of E_mean
WEIGHTS = (ENERGY, *MEASURES)
_POWER = 12.0  # p of a peak
_AFTER, _SAMPLES = 2.0, 64  # s after the motion in which peaks count, and samples of it
_SMALL = 0.2  # of a peak: what is below it adds less than 1e-7 to its slope


def checked_weights(weights: Mapping[str, float] | None) -> dict[str, float]:
    """Return the weights of all measures that count; that of the energy is 1 unless given.

    Raises:
        ParameterError: a name not in `WEIGHTS`, a negative weight, or none above zero.
    """
    out = {ENERGY: 1.0, **(weights or {})}
    for name, value in out.items():
        require_one_of("a weight", name, WEIGHTS)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not (number and value >= 0 and math.isfinite(value)):
            raise ParameterError(f"weight {name} must be a number >= 0, got {value!r}")
    if not any(out.values()):
        raise ParameterError("one weight must be > 0, got all zero")
    return {name: float(value) for name, value in out.items() if value or name == ENERGY}


def parse_weights(text: str) -> dict[str, float]:
    """Read weights like acceleration_peak=0.03+tip=0.1."""
    out = {}
    for part in text.split("+"):
        name, _, value = part.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise ParameterError(
                f"a weight must be NAME=VALUE like acceleration_peak=0.03, got {part!r}"
            ) from None
    checked_weights(out)
    return out


def weighted_name(planner: str, weights: Mapping[str, float]) -> str:
    """A planner's name with its weights, as `get_planner` reads it."""
    weighted = {name: w for name, w in weights.items() if (name, w) != (ENERGY, 1.0)}
    listed = "+".join(f"{name}={w:g}" for name, w in weighted.items())
    return f"{planner}:{listed}" if listed else planner


class Objective(QuadraticForm):
    """J of motions as a function of their momentum, where `MeanEnergy` is E_mean.

    Args:
        energy: E_mean of the query's motions, with the frozen inertia.
        weights: as `checked_weights` returns them.
        straight: what measures are shares of.
        filter: of `E_weighted`.
        base: its motion at the start; None: at rest.
        path: of the tool while its error is linear in the base's motion; default straight.
    """

    def __init__(
        self,
        energy: MeanEnergy,
        weights: Mapping[str, float],
        straight: Motion,
        filter: FrequencyWeight,
        base: BaseState | None = None,
        path: Motion | None = None,
    ) -> None:
        self.mean, self.weights, self.straight = energy, weights, straight
        self.t, self.linear, self.system = energy.t, energy.linear, energy.system
        self._filter, self._base = filter, base
        self._start = energy.linear.load(straight, self.t).ravel()
        self._response = self._linearised(straight)
        scale = energy.value(self._start)
        self.shares: dict[str, float] = {}  # of J per unit of the squared measure
        for name in self._measures:
            there = self._form(name).value(self._start)
            self.shares[name] = weights[name] * scale / there if there > 0 else 0.0
        if path is not None and self.follows_path:
            self._response = self._linearised(path)
        w = weights[ENERGY]
        self.hessian, self.gradient = w * energy.hessian, w * energy.gradient
        self.constant = w * energy.constant
        self._peaks: list[tuple[float, _Peak]] = []
        for name, share in self.shares.items():
            form = self._form(name)
            if isinstance(form, _Peak):  # peaks stay what they are
                self._peaks.append((share, form))
                continue
            self.hessian = self.hessian + share * form.hessian
            self.gradient = self.gradient + share * form.gradient
            self.constant += share * form.constant

    @property
    def _measures(self) -> list[str]:
        return [name for name in self.weights if name != ENERGY]

    @property
    def follows_path(self) -> bool:
        """True where J depends on where the tool is, which is that of one path."""
        return any(name.startswith("tip") for name in self._measures)

    def about(self, path: Motion) -> Objective:
        """Return the same with the tool on another path."""
        settings = self.mean, self.weights, self.straight, self._filter, self._base
        return Objective(*settings, path=path)

    def _linearised(self, path: Motion) -> LinearResponse:
        """Response per sample of u, and in the last column to the base's motion."""
        N, k = len(self.t), len(self.linear.driven)
        inputs = np.zeros((N, k, k * N + 1))
        inputs[:, :, :-1] = np.eye(k * N).reshape(N, k, k * N)
        at = self.mean.at
        return LinearResponse(
            self.linear, at, path, self.t, inputs, self._filter, base=self._base
        )

    def _form(self, name: str) -> QuadraticForm | _Peak:
        if name in MEANS:
            rows, after = self._response.mean_square(MEANS[name])
            return QuadraticForm(rows.T @ rows + after)
        if name in ENDS:
            rows = self._response.quantity(ENDS[name]).nodes[-1]
            return QuadraticForm(rows.T @ rows)
        step = _AFTER / _SAMPLES
        return _Peak(self._response.samples(PEAKS[name], step, _AFTER))

    def measure(self, name: str, u: Array) -> float:
        """One of `MEASURES` of momenta u (6 (N + 1),), a peak by its power mean."""
        square = self._form(name).value(u)
        return square if name == "E_weighted" else max(square, 0.0) ** 0.5

    def value(self, u: Array) -> float:
        """J [J] of momenta u (6 (N + 1),)."""
        return super().value(u) + sum(share * peak.value(u) for share, peak in self._peaks)

    def force(self, u: Array) -> Array:
        return sum((w * peak.force(u) for w, peak in self._peaks), start=super().force(u))

    def curvature(self, u: Array, slope: Array) -> Array:
        """slope^T W slope (k, k), W the second derivative of `value` at u."""
        parts = (w * peak.curvature(u, slope) for w, peak in self._peaks)
        return sum(parts, start=super().curvature(u, slope))


class _Peak:
    """(mean_k |a_k|^p)^(2/p) of vectors a_k that are affine in u."""

    def __init__(self, rows: Array) -> None:
        self._rows, self._offset = rows[..., :-1], rows[..., -1]

    def _parts(self, u: Array) -> tuple[float, Array, Array, float]:
        """Largest |a|, which are not small, their |a| over it, and the mean of its powers."""
        a = self._rows @ u + self._offset
        sizes = np.linalg.norm(a, axis=-1)
        largest = float(sizes.max())
        if largest == 0:
            return 0.0, a, sizes, 0.0
        return largest, a, sizes / largest, float(np.mean((sizes / largest) ** _POWER))

    def value(self, u: Array) -> float:
        largest, _, _, mean = self._parts(u)
        return largest**2 * mean ** (2 / _POWER)

    def force(self, u: Array) -> Array:
        _, a, x, mean = self._parts(u)
        if not mean:
            return np.zeros(len(u))
        large = x > _SMALL
        pull = x[large, None] ** (_POWER - 2) * a[large] / len(x)
        out: Array = np.tensordot(pull, self._rows[large], 2)
        return 2 * mean ** (2 / _POWER - 1) * out

    def curvature(self, u: Array, slope: Array) -> Array:
        largest, a, x, mean = self._parts(u)
        if not mean:
            return np.zeros((slope.shape[1],) * 2)
        large = x > _SMALL
        rows = self._rows[large] @ slope
        weight, a = x[large] ** (_POWER - 2) / len(x), a[large]
        along = np.einsum("kr,krc->kc", a / np.linalg.norm(a, axis=1)[:, None], rows)
        flat = (np.sqrt(weight)[:, None, None] * rows).reshape(-1, slope.shape[1])
        steep = np.sqrt((_POWER - 2) * weight)[:, None] * along
        pull = np.tensordot(weight[:, None] * a, rows, 2)
        out: Array = flat.T @ flat + steep.T @ steep
        out -= (_POWER - 2) / (mean * largest**2) * np.outer(pull, pull)
        return 2 * mean ** (2 / _POWER - 1) * out
