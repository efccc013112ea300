"""Arm and base linearised about rest, closed by joint gains, and what these do to the base.

Pseudo-passive energy dissipation (thesis 4.3.2): tau = -K (q - q0) - B q'. Gains are judged by
the thesis's damping estimator (eq. 4.4), or by what is meant: the strain energy that the base
holds, integrated over time. With A^T P + P A + S = 0 that is J = x0^T P x0; with
A X + X A^T + x0 x0^T = 0 its gradient is dJ/dA = 2 P X, at the cost of one more solve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize

from ves_gym._util.params import Array, ParameterError, finite
from ves_gym.engine.linear import linearise_ideal
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.coupling import blocks
from ves_gym.system.energy import SETTLED
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
    stiffness: Array  # (6, 6) of the base at rest under loads on its interface [N/m, N, N m]
    mass: Array  # (6 + m, 6 + m) of the base with the joints locked, M_t [kg, kg m, kg m^2]

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
    """Return the linear models of arm and base at configurations q (m, n) [rad].

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
    system.arm.require_rigid("PPED")
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
            stiffness=K,
            mass=mass,
        )
        for A, B, mass in zip(linear.A, linear.B.reshape(-1, 2 * w, n), masses, strict=True)
    ]


def plant_at(system: System, q: npt.ArrayLike) -> LinearPlant:
    """Return the linear model of arm and base at one configuration q (n,) [rad].

    Raises:
        ParameterError: as `plants`, or a joint beyond its limits.
    """
    return plants(system, system.arm.require_within_limits(q))[0]


Complexes = npt.NDArray[np.complex128]

THESIS_DISPLACEMENT = (0.1, 0.1, 0.1, 0.0, 0.0, 0.0)  # Y(0) of thesis 4.3.2 [m, rad]
_MARGIN = 1e-9  # 1/s: a pole this near the imaginary axis does not decay
_SAMPLE = 0.01  # s, of the response in which t_5 is looked for


class DampingAnalysis(NamedTuple):
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
    """Poles and measures of the base released from y (6,) [m, rad].

    A system that does not decay by itself (free joints, say) has infinite measures.

    Raises:
        ParameterError: gains of another shape, or not finite.
    """
    for name, gain in gains._asdict().items():
        finite(gain, (plant.n, plant.n), name)
    A = plant.closed(gains)
    poles = np.linalg.eigvals(A).astype(np.complex128)
    poles = poles[np.lexsort((poles.imag, np.abs(poles).round(9)))]
    E_int = t_5 = worst = math.inf
    worst_y = np.full(6, np.nan)
    if poles.real.max() <= -_MARGIN:
        P, x = Lyapunov(A).cost(plant.strain), plant.start(y)
        E_int, t_5 = float(x @ P @ x), _settling_time(plant, A, x)
        worst, worst_y = worst_displacement(plant, P)
    return DampingAnalysis(gains, poles, estimator(poles), E_int, t_5, worst, worst_y)


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
    """States (N, 2 w) at even times t (N,) [s] after a release from y (6,), linear model."""
    times = np.asarray(t, float)
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


class Lyapunov:
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


def worst_displacement(plant: LinearPlant, P: Array) -> tuple[float, Array]:
    """Largest cost per joule of initial strain energy [s], and its displacement of 1 J."""
    w = len(plant.displacement_map)
    cost = plant.displacement_map.T @ P[:w, :w] @ plant.displacement_map
    values, vectors = scipy.linalg.eigh(cost, plant.stiffness / 2)
    y = vectors[:, -1]
    return float(values[-1]), y * np.sign(y[np.abs(y).argmax()])


def require_decay(plant: LinearPlant, gains: GainMatrices) -> None:
    """Refuse gains that leave a motion of the base which does not decay."""
    slowest = np.linalg.eigvals(plant.closed(gains)).real.max()
    if slowest > -_MARGIN:
        raise ParameterError(
            "the base has a motion that neither its own damping nor the joints bring to rest"
            f" (a pole at {slowest:.3g} 1/s): no gains are best"
        )
