"""An admissible estimate of coupling length: what no path between two configurations is below.

The arm's linear momentum is its mass times the velocity of its centre of mass, so what a path
passes on to the base has a part that depends on its ends only. With a step's base momentum
H dq = (m dc, dL) its squared length is (H dq)^T G (H dq) + floor^2 |dq|^2; G = M_t^-1 K M_t^-1
for raw Q. Whatever the angular part, the first term is at least (m dc)^T S (m dc) with S the
Schur complement of G. With one S below those of all configurations both terms are squares of
norms of what integrates along the path, and Minkowski's inequality gives

    length >= sqrt((m c_b - m c_a)^T S (m c_b - m c_a) + floor^2 |b - a|^2).

S is found from samples of the joint box, looked at more closely where they are least, and made
smaller by `_MARGIN`. The second term alone is exact. A constant metric below Q(q) is no better
than it: over a whole joint box nearly every joint direction is somewhere without reaction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.special import spherical_jn
from scipy.stats import qmc

from ves_gym._util.params import Array
from ves_gym.engine.kernel.maps import InertiaMap
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import natural_modes, root
from ves_gym.planners.metric import Metric
from ves_gym.system.system import System

_SAMPLES = 2048  # configurations
_WORST = 16  # of them that are looked at more closely,
_CLOUD = 64  # by so many samples around each,
_ROUNDS = 3  # as often, each time closer by
_CLOSER = 0.25
_WINDOW = 0.02  # of a frequency, to either side: modes in it count as its least excited one
_MARGIN = 0.98  # of what the samples allow: squares of lengths
_RIDGE = 1e-13  # of the trace of G: where its angular part is singular
_LOST = 1e-10  # of it: what the ridge may add
_CUTS = 12  # rounds of fitting S, a cutting plane each
_STEPS = 200  # of the fit in a round
_FEW = 200_000  # centres of mass that are remembered


class LeastLength:
    """Length in a metric that no path between two configurations is below."""

    def __init__(self, metric: Metric) -> None:
        self.floor = metric.floor
        self._moments: dict[tuple[float, ...], list[float]] = {}
        self._root: Array | None = None
        if metric.kind == "disturbance":
            return  # it counts rotation alone, of which no part depends on the ends only
        system = metric.system
        S = least_weight(system, metric.duration if metric.kind == "qt" else None)
        if np.linalg.eigvalsh(S)[-1] > 0:
            self._root = root(S)
            self._inertia = InertiaMap(system, 1)

    def __call__(self, a: Sequence[float], b: Sequence[float]) -> float:
        """Return the bound.

        Args:
            a, b: n joint angles [rad].

        Returns:
            A length, in the metric's unit.
        """
        distance = self.floor * math.dist(a, b)
        if self._root is None:
            return distance
        return math.hypot(distance, math.dist(self._moment(a), self._moment(b)))

    def _moment(self, q: Sequence[float]) -> list[float]:
        """Root of S times mass times centre of mass, of a configuration."""
        key = tuple(q)
        moment = self._moments.get(key)
        if moment is None:
            assert self._root is not None
            if len(self._moments) >= _FEW:
                self._moments.clear()
            H = self._inertia(np.array(key)[None])[0]
            moment = [float(k) for k in self._root @ first_moment(H)]
            self._moments[key] = moment
        return moment


def first_moment(H: Array) -> Array:
    """Mass times centre of mass from an inertia matrix.

    Args:
        H: (..., 6 + n, 6 + n) of base and joints.

    Returns:
        (..., 3) [kg m].
    """
    return np.stack([H[..., 1, 5], H[..., 2, 3], H[..., 0, 4]], axis=-1)


@lru_cache(maxsize=32)
def least_weight(system: System, duration: float | None) -> Array:
    """Return S (3, 3) below the Schur complements of all configurations of the joint box.

    Args:
        system: arm and vehicle, ideal.
        duration: of Q_T [s]; None for raw Q.

    Returns:
        S [J / (kg m)^2]; of a base without stiffness [1/kg].
    """
    arm = system.arm
    low, high = arm.column("q_min"), arm.column("q_max")
    q = qmc.scale(qmc.Halton(arm.n, scramble=False).random(_SAMPLES), low, high)
    S = _complements(system, q, duration)
    if not S.any():  # motions this slow may move no mode of the base
        return np.zeros((3, 3))
    B = _largest_below(S)
    cloud = qmc.Halton(arm.n, scramble=False).random(_CLOUD) - 0.5
    width, least = high - low, 1.0
    for _ in range(_ROUNDS):
        values = _relative(B, S)
        least = min(least, float(values.min()))
        width = _CLOSER * width
        near = q[np.argsort(values)[:_WORST], None] + width * cloud
        q = np.clip(near, low, high).reshape(-1, arm.n)
        S = _complements(system, q, duration)
    least = min(least, float(_relative(B, S).min()))
    values, vectors = np.linalg.eigh(_MARGIN * least * B)
    lost = _LOST * float(np.trace(_weights(system, q[:1], duration)[0]))
    out: Array = (vectors * np.maximum(values - lost, 0.0)) @ vectors.T
    return out


def _weights(system: System, q: Array, duration: float | None) -> Array:
    """G (..., b, b): the square of a step's length is (H dq)^T G (H dq), or for Q_T more."""
    M, _, K = system.base.condensed()  # as the metric has it
    Mt = inertia(system.arm, q)[..., : len(M), : len(M)] + M
    if not K.any():
        return np.asarray(np.linalg.inv(Mt), float)
    if duration is None:
        inverse = np.linalg.inv(Mt)
        return np.asarray(inverse @ K @ inverse, float)
    m = natural_modes(K, Mt)
    weight = m.omega * _least_spectrum(m.omega * duration)
    rows = weight[..., :, None] * np.swapaxes(m.shapes, -1, -2)
    return np.asarray(np.swapaxes(rows, -1, -2) @ rows, float)


def _least_spectrum(x: Array) -> Array:
    """Least |spectrum of a quintic| near x (...): it has zeros that samples would miss."""
    around = x[..., None] * (1 + _WINDOW * np.linspace(-1, 1, 9))
    values = spectral_shape(around)
    return np.where(np.ptp(np.sign(values), axis=-1) > 0, 0.0, np.abs(values).min(axis=-1))


def spectral_shape(x: Array) -> Array:
    """Signed spectrum of a rest-to-rest quintic, whose size is `modes.quintic_spectrum`.

    Args:
        x: (...) omega T, > 0 [1].

    Returns:
        (...) [1].
    """
    half = np.maximum(x / 2, 1e-2)  # below, it is 1 to 1e-5
    return np.asarray(15 * spherical_jn(2, half) / half**2, float)


def _complements(system: System, q: Array, duration: float | None) -> Array:
    """Schur complements (N, 3, 3) of the linear part of G."""
    G = _weights(system, q, duration)
    trace = np.trace(G, axis1=-2, axis2=-1)[:, None, None]
    G = G + _RIDGE * np.where(trace > 0, trace, 1.0) * np.eye(G.shape[-1])
    out = G[:, :3, :3] - G[:, :3, 3:] @ np.linalg.solve(G[:, 3:, 3:], G[:, 3:, :3])
    return np.asarray(out + np.swapaxes(out, -1, -2), float) / 2


def _relative(B: Array, S: Array) -> Array:
    """Least eigenvalue (N,) of S by B: how many times B fits below it."""
    inverse = np.linalg.inv(np.linalg.cholesky(B))
    return np.asarray(np.linalg.eigvalsh(inverse @ S @ inverse.T)[:, 0], float)


def _largest_below(S: Array) -> Array:
    """Matrix below all of S (N, k, k), about the largest by determinant.

    B is below S where the ellipsoid x^T S x <= 1 is inside x^T B x <= 1: the least ellipsoid
    around points, those of the ellipsoids that stick out most (Titterington's iteration).
    """
    k = S.shape[-1]
    scale = float(np.trace(S.mean(axis=0)))
    B = S.mean(axis=0) + 1e-12 * scale * np.eye(k)
    S = S + 1e-12 * scale * np.eye(k)
    points = np.zeros((0, k))
    for _ in range(_CUTS):
        inverse = np.linalg.inv(np.linalg.cholesky(B))
        values, vectors = np.linalg.eigh(inverse @ S @ inverse.T)
        worst = np.argsort(values[:, 0])[:2]
        ends = vectors[worst, :, :] / np.sqrt(values[worst, None, :])  # axes of the ellipsoid
        points = np.vstack([points, np.swapaxes(ends, -1, -2).reshape(-1, k) @ inverse])
        share = np.full(len(points), 1 / len(points))
        for _ in range(_STEPS):
            spread = np.asarray(np.linalg.inv((points.T * share) @ points), float)
            share *= np.einsum("ki,ij,kj->k", points, spread, points) / k
            B = spread / k
    return B
