"""Pseudo-passive energy dissipation (thesis 4.3.2): joint gains that damp the base.

Arm and base are linearised about rest and closed by tau = -K (q - q0) - B q'. Gains are
judged by the thesis's damping estimator (eq. 4.4), or by what is meant: the strain energy
that the base holds, integrated over time. With A^T P + P A + S = 0 that is J = x0^T P x0;
with A X + X A^T + x0 x0^T = 0 its gradient is dJ/dA = 2 P X, at the cost of one more solve.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize

from ves_gym._util.params import Array, ParameterError, Vector, finite, unit
from ves_gym._util.suggest import did_you_mean
from ves_gym.engine.linear import linearise_ideal
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.coupling import blocks
from ves_gym.system.energy import SETTLED
from ves_gym.system.system import System

Complexes = npt.NDArray[np.complex128]
Objective = Callable[[Array], tuple[float, Array]]  # closed A -> value to minimise, d / dA

THESIS_DISPLACEMENT = (0.1, 0.1, 0.1, 0.0, 0.0, 0.0)  # Y(0) of thesis 4.3.2 [m, rad]
OBJECTIVES = {
    "strain": "time integral of strain energy after one displacement [J s]",
    "worst": "the same per joule of initial strain energy, worst displacement [s]",
    "estimator": "damping estimator, thesis eq. 4.4 [1], the larger the better",
}
_MARGIN = 1e-9  # 1/s: a pole this near the imaginary axis does not decay
_SCREENING = 30  # iterations given to every start; the best _FINALISTS go on to the end
_FINALISTS = 6
# long memory for long valleys; ftol of a logarithm: 4e-7 of the integral per step
_SEARCH = {"maxcor": 30, "ftol": 1e-7}
_SAMPLE = 0.01  # s, of the response in which t_5 is looked for


class GainMatrices(NamedTuple):
    """Joint gains, each (n, n), symmetric: tau = -K (q - q0) - B q'."""

    K: Array  # N m/rad
    B: Array  # N m s/rad

    @staticmethod
    def of(servo: JointServo) -> GainMatrices:
        """The diagonal gains of a servo."""
        return GainMatrices(np.diag(servo.kp), np.diag(servo.kd))


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Least and largest gain; of full matrices, least and largest eigenvalue."""

    K: Vector = unit("N m/rad", default=(1.0, 1e4))
    B: Vector = unit("N m s/rad", default=(0.1, 1e3))

    def __post_init__(self) -> None:
        for name in ("K", "B"):
            low, high = finite(getattr(self, name), (2,), f"Bounds.{name}")
            if not 0 < low < high:
                raise ParameterError(
                    f"Bounds.{name} must be 0 < least < largest, got {low:g} and {high:g}"
                )


WIDE = Bounds()


# ------------------------------------------------------------------------- the plant


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


# -------------------------------------------------------------------------- analysis


@dataclass(frozen=True, eq=False, kw_only=True)
class DampingAnalysis:
    """Poles and measures of a displaced base under a set of gains, by the linear model."""

    gains: GainMatrices
    poles: Complexes  # (2 w,) 1/s, slowest first
    estimator: float  # thesis eq. 4.4
    E_int: float  # time integral of strain energy [J s]
    t_5: float  # s until the base energy stays below 5 % of its peak
    worst: float  # largest E_int per joule of initial strain energy [s]
    worst_y: Array  # (6,) displacement of 1 J for which it is reached [m, rad]

    def to_dict(self) -> dict[str, Any]:
        """Plain data; None where a value is not finite."""
        numbers = {k: float(getattr(self, k)) for k in ("estimator", "E_int", "t_5", "worst")}
        return {
            "K": self.gains.K.tolist(),
            "B": self.gains.B.tolist(),
            **{k: v if math.isfinite(v) else None for k, v in numbers.items()},
            "worst_y": self.worst_y.tolist() if math.isfinite(self.worst) else None,
            "poles": [[p.real, p.imag] for p in self.poles.tolist()],
        }


def analyse(
    plant: LinearPlant, gains: GainMatrices, y: npt.ArrayLike = THESIS_DISPLACEMENT
) -> DampingAnalysis:
    """Poles and measures of the base released from y.

    A system that does not decay by itself (free joints, say) has infinite measures.

    Args:
        plant: the linear model.
        gains: K [N m/rad] and B [N m s/rad], (n, n) each.
        y: (6,) initial displacement of the base [m, rad].

    Returns:
        Poles [1/s], E_int [J s], t_5 [s] and the worst displacement.

    Raises:
        ParameterError: gains of another shape, or not finite.
    """
    for name, gain in gains._asdict().items():
        finite(gain, (plant.n, plant.n), name)
    A = plant.closed(gains)
    poles = np.linalg.eigvals(A).astype(np.complex128)
    poles = poles[np.lexsort((poles.imag, np.abs(poles).round(9)))]
    value = estimator(poles)
    if poles.real.max() > -_MARGIN:
        never, nowhere = math.inf, np.full(6, np.nan)
        return DampingAnalysis(
            gains=gains, poles=poles, estimator=value, E_int=never, t_5=never, worst=never,
            worst_y=nowhere,
        )  # fmt: skip
    P = _Lyapunov(A).cost(plant.strain)
    x = plant.start(y)
    worst, direction = _worst(plant, P)
    return DampingAnalysis(
        gains=gains,
        poles=poles,
        estimator=value,
        E_int=float(x @ P @ x),
        t_5=_settling_time(plant, A, x),
        worst=worst,
        worst_y=direction,
    )


def estimator(poles: npt.ArrayLike) -> float:
    """Thesis eq. 4.4: sum of zeta_i (1 - omega_i / sum omega) over all poles [1/s].

    A pole at zero has no damping ratio and counts nothing.
    """
    p = np.asarray(poles, complex)
    omega = np.abs(p)
    p, omega = p[omega > _MARGIN], omega[omega > _MARGIN]
    return float(np.sum(-p.real / omega * (1 - omega / omega.sum())))


def respond(
    plant: LinearPlant, gains: GainMatrices, y: npt.ArrayLike, t: npt.ArrayLike
) -> Array:
    """Simulate the linear model after a release from y.

    Args:
        plant: the linear model, of w coordinates.
        gains: K [N m/rad] and B [N m s/rad], (n, n) each.
        y: (6,) initial displacement of the base [m, rad].
        t: (N,) evenly spaced times from 0 [s].

    Returns:
        (N, 2 w) states x at these times.

    Raises:
        ParameterError: times that are not evenly spaced from 0.
    """
    times = np.asarray(t, float)
    if (
        times.ndim != 1
        or len(times) < 2
        or not np.allclose(times, times[1] * np.arange(len(times)), rtol=1e-9)
    ):
        raise ParameterError(f"t must be at least two evenly spaced times from 0, got {t!r}")
    step = scipy.linalg.expm(plant.closed(gains) * times[1])
    return _march(step, plant.start(y), len(times))


def _march(step: Array, x: Array, count: int) -> Array:
    """(count, 2 w): x, step x, step^2 x, ... by doubling."""
    out, power = x[None], step
    while len(out) < count:
        out = np.concatenate([out, out @ power.T])
        power = power @ power
    return out[:count]


def _settling_time(plant: LinearPlant, A: Array, x: Array) -> float:
    """s until x^T S x, S of the base energy, stays below 5 % of its peak; to _SAMPLE."""
    rates, shapes = np.linalg.eig(A)
    S = plant.total
    size = np.sqrt(np.maximum(np.real(np.einsum("ik,ij,jk->k", shapes.conj(), S, shapes)), 0))
    size = size * np.abs(np.linalg.solve(shapes, x.astype(complex)))
    floor = SETTLED * float(x @ S @ x)
    horizon = 1.0
    # E <= (sum of the modes' own)^2 bounds what is still to come
    while np.sum(size * np.exp(rates.real * horizon)) ** 2 > floor:
        horizon *= 2
        if horizon > 1e5:
            return math.inf
    states = _march(scipy.linalg.expm(A * _SAMPLE), x, math.ceil(horizon / _SAMPLE) + 1)
    E = np.einsum("ki,ij,kj->k", states, S, states)
    above = np.flatnonzero(SETTLED * E.max() < E)
    return float((above[-1] + 1) * _SAMPLE) if len(above) else 0.0


class _Lyapunov:
    """Lyapunov equations of one stable A, by one Schur form."""

    def __init__(self, A: Array) -> None:
        self.T, self.Z = scipy.linalg.schur(A)

    def cost(self, S: Array) -> Array:
        """P of A^T P + P A + S = 0: x^T P x is the integral of x^T S x from x on."""
        return self._solve(S, "T", "N")

    def spread(self, X0: Array) -> Array:
        """X of A X + X A^T + X0 = 0: the integral of x x^T, X0 = x x^T at the start."""
        return self._solve(X0, "N", "T")

    def _solve(self, C: Array, transpose_first: str, transpose_second: str) -> Array:
        inner, scale, _ = scipy.linalg.lapack.dtrsyl(
            self.T,
            self.T,
            -(self.Z.T @ C @ self.Z),
            trana=transpose_first,
            tranb=transpose_second,
        )
        out: Array = self.Z @ (inner / scale) @ self.Z.T
        return (out + out.T) / 2


def _worst(plant: LinearPlant, P: Array) -> tuple[float, Array]:
    """Largest cost per joule of initial strain energy [s], and its displacement of 1 J."""
    w = len(plant.displacement_map)
    cost = plant.displacement_map.T @ P[:w, :w] @ plant.displacement_map
    values, vectors = scipy.linalg.eigh(cost, plant.stiffness / 2)
    y = vectors[:, -1]
    return float(values[-1]), y * np.sign(y[np.abs(y).argmax()])


# -------------------------------------------------------------------------- objectives


def objective_of(
    plant: LinearPlant, name: str, y: npt.ArrayLike = THESIS_DISPLACEMENT
) -> Objective:
    """One of `OBJECTIVES` as a function to minimise, of the closed A, with its gradient.

    strain and worst are in logarithms (they differ by decades), the estimator negative.

    Args:
        plant: the linear model.
        name: of the objective.
        y: (6,) initial displacement of "strain" [m, rad].

    Returns:
        A function of A (2 w, 2 w) with value and derivative (2 w, 2 w).

    Raises:
        ParameterError: an unknown name, or a displacement of zero.
    """
    if name == "strain":
        x = plant.start(y)
        if not x.any():
            raise ParameterError("y must be a displacement other than zero")
        return _strain_objective(plant.strain, np.outer(x, x))
    if name == "worst":
        return _worst_objective(plant)
    if name == "estimator":
        return _estimator_objective
    raise ParameterError(
        f"objective must be one of {', '.join(OBJECTIVES)}, got {name!r}"
        f"{did_you_mean(name, OBJECTIVES)}"
    )


def _strain_objective(S: Array, X0: Array) -> Objective:
    def value(A: Array) -> tuple[float, Array]:
        equation = _Lyapunov(A)
        P = equation.cost(S)
        J = float(np.sum(P * X0))
        return math.log(J), 2 / J * P @ equation.spread(X0)

    return value


def _worst_objective(plant: LinearPlant) -> Objective:
    S = plant.strain

    def value(A: Array) -> tuple[float, Array]:
        equation = _Lyapunov(A)
        P = equation.cost(S)
        J, y = _worst(plant, P)
        x = plant.start(y)  # the eigenvector: J moves as its own cost does
        return math.log(J), 2 / J * P @ equation.spread(np.outer(x, x))

    return value


def _estimator_objective(A: Array) -> tuple[float, Array]:
    poles, shapes = np.linalg.eig(A)
    omega = np.abs(poles)
    zeta, total = -poles.real / omega, omega.sum()
    by_zeta = 1 - omega / total
    by_omega = -zeta / total + np.sum(zeta * omega) / total**2 + by_zeta * poles.real / omega**2
    # d omega = Re(conj(p) dp) / omega, d zeta = -Re(dp) / omega + zeta's share of omega
    weight = -by_zeta / omega + by_omega * poles.conj() / omega
    # dp_i = (left_i dA right_i), left = shapes^-1
    slope = np.real((shapes * weight) @ np.linalg.inv(shapes)).T
    return -float(np.sum(zeta * by_zeta)), -slope


# ---------------------------------------------------------------------- the gain search


class _Inside:
    """Symmetric matrices with eigenvalues inside bounds, from free parameters u.

    gain = f(T), T symmetric (or diagonal) with entries u, f(t) = exp(middle + half sin t):
    smooth, positive, never out of bounds, and no dead end at a bound.
    """

    def __init__(self, n: int, bounds: Vector, full: bool) -> None:
        low, high = math.log(bounds[0]), math.log(bounds[1])
        self.n, self.middle, self.half = n, (low + high) / 2, (high - low) / 2
        self.at = np.triu_indices(n) if full else (np.arange(n), np.arange(n))
        self.size = len(self.at[0])
        self.twice = np.where(self.at[0] == self.at[1], 1.0, 2.0)

    def gain(self, u: Array) -> tuple[Array, Callable[[Array], Array]]:
        """The matrix, and what turns a gradient by its entries into one by u."""
        T = np.zeros((self.n, self.n))
        T[self.at] = u
        T[self.at[::-1]] = u
        t, V = np.linalg.eigh(T)
        f = np.exp(self.middle + self.half * np.sin(t))
        slope = f * self.half * np.cos(t)

        def by_u(G: Array) -> Array:
            # Daleckii and Krein: the derivative of a matrix function by divided differences
            gap = t[:, None] - t
            near = np.abs(gap) < 1e-6
            ratio = (f[:, None] - f) / np.where(near, 1.0, gap)
            ratio = np.where(near, (slope[:, None] + slope) / 2, ratio)
            inner = V.T @ ((G + G.T) / 2) @ V
            back: Array = (V @ (ratio * inner) @ V.T)[self.at] * self.twice
            return back

        return (V * f) @ V.T, by_u

    def parameters(self, gain: Array) -> Array:
        """u of a matrix, the nearest one if it is out of bounds."""
        values, V = np.linalg.eigh(gain)
        inside = (np.log(np.maximum(values, 1e-300)) - self.middle) / self.half
        t = np.arcsin(np.clip(inside, -1 + 1e-6, 1 - 1e-6))
        T: Array = (V * t) @ V.T
        return T[self.at]


@dataclass(frozen=True, eq=False, kw_only=True)
class Tuned:
    """Gains found by a search."""

    gains: GainMatrices
    objective: str
    value: float  # of the objective, in its unit (`OBJECTIVES`)
    evaluations: int
    seconds: float


def tune(
    plant: LinearPlant,
    objective: str = "strain",
    *,
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    full: bool = False,
    bounds: Bounds = WIDE,
    starts: int = 24,
    seed: int = 0,
    first: GainMatrices | None = None,
) -> Tuned:
    """Find the gains that are best by an objective: quasi-Newton search from several starts.

    Args:
        plant: the linear model.
        objective: one of `OBJECTIVES`.
        y: (6,) initial displacement of "strain" [m, rad].
        full: symmetric positive definite matrices instead of diagonal ones.
        bounds: of the gains [N m/rad, N m s/rad].
        starts: random starts; full matrices also start from the best diagonal ones.
        seed: of the random starts; the same seed finds the same gains.
        first: gains to start from as well.

    Returns:
        The gains, the objective's value and the effort.

    Raises:
        ParameterError: an unknown objective, or a base that no gains bring to rest.
    """
    if starts < 1:
        raise ParameterError(f"starts must be >= 1, got {starts}")
    began = time.perf_counter()
    goal = objective_of(plant, objective, y)
    boxes = [_Inside(plant.n, b, full) for b in (bounds.K, bounds.B)]
    split = boxes[0].size
    w = plant.port.shape[1]
    evaluations = 0

    def gains_of(u: Array) -> GainMatrices:
        return GainMatrices(boxes[0].gain(u[:split])[0], boxes[1].gain(u[split:])[0])

    def value(u: Array) -> tuple[float, Array]:
        nonlocal evaluations
        evaluations += 1
        K, by_K = boxes[0].gain(u[:split])
        B, by_B = boxes[1].gain(u[split:])
        measure, slope = goal(plant.closed(GainMatrices(K, B)))
        inner = -plant.drive.T @ slope  # A falls by drive [K port, B port]
        by_gains = inner[:, :w] @ plant.port.T, inner[:, w:] @ plant.port.T
        return measure, np.r_[by_K(by_gains[0]), by_B(by_gains[1])]

    _require_decay(plant, gains_of(np.zeros(2 * split)))
    rng = np.random.default_rng(seed)
    points = list(rng.uniform(-1.2, 1.2, (starts, 2 * split)))
    seeds = [] if first is None else [first]
    if full:
        diagonal = tune(plant, objective, y=y, bounds=bounds, starts=starts, seed=seed)
        seeds.append(diagonal.gains)
        evaluations += diagonal.evaluations
    points += [np.r_[boxes[0].parameters(g.K), boxes[1].parameters(g.B)] for g in seeds]
    best = _minimise(value, points)
    if objective == "estimator":  # where two poles meet it has a kink, and gradients stop
        best = min(best, _simplex(value, best[1]), key=_least)
    gains = gains_of(best[1])
    return Tuned(
        gains=gains,
        objective=objective,
        value=-best[0] if objective == "estimator" else math.exp(best[0]),
        evaluations=evaluations,
        seconds=time.perf_counter() - began,
    )


def _least(result: tuple[float, Array]) -> float:
    return result[0]


def _minimise(
    value: Callable[[Array], tuple[float, Array]], points: list[Array]
) -> tuple[float, Array]:
    """Least value and where: every point for a few steps, the best of them to the end."""

    def search(u: Array, steps: int) -> tuple[float, Array]:
        result = scipy.optimize.minimize(
            value, u, jac=True, method="L-BFGS-B", options={**_SEARCH, "maxiter": steps}
        )
        return float(result.fun), result.x

    tried = sorted((search(u, _SCREENING) for u in points), key=_least)
    return min((search(u, 1000) for _, u in tried[:_FINALISTS]), key=_least)


def _simplex(value: Callable[[Array], tuple[float, Array]], u: Array) -> tuple[float, Array]:
    result = scipy.optimize.minimize(
        lambda x: value(x)[0], u, method="Nelder-Mead", options={"maxfev": 1000}
    )
    return float(result.fun), result.x


def _require_decay(plant: LinearPlant, gains: GainMatrices) -> None:
    slowest = np.linalg.eigvals(plant.closed(gains)).real.max()
    if slowest > -_MARGIN:
        raise ParameterError(
            "the base has a motion that neither its own damping nor the joints bring to rest"
            f" (a pole at {slowest:.3g} 1/s): no gains are best"
        )
