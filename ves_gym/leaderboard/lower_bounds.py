"""What no method can fall below, by conservation of energy and momentum.

Every bound leaves room for what it neglects, so that no honest entry is refused; what
undercuts one is a mistake or a trick of the numerics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.linalg

from ves_gym._util.params import Array
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.modes import natural_modes
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

_ROUNDING = 1e-9
_ROOM = 4.0  # of momentum, for servo lag, sampling of the joint box and large rotations
_GRID = 13  # of every joint's range


def require_energies(row: Mapping[str, Any]) -> None:
    """Refuse energies that are negative, or a mean or an end above the peak.

    E = 1/2 Y'^T M_t Y' + 1/2 Y^T K Y is a sum of squares, and the peak is its largest value
    until the end of the motion; what is left decays. In the laboratory, too, it is computed
    from a pose and a rate.
    """
    for name in ("E_mean", "E_peak", "E_res", "E_int"):
        value = row.get(name)
        if value is not None and value < 0:
            raise BundleError(
                Code.BELOW_FLOOR, f"{row['id']}: {name} is {value:.6g}, below zero"
            )
    peak = row.get("E_peak")
    value = row.get("E_res")
    if peak is not None and value is not None and value > peak * (1 + _ROUNDING):
        raise BundleError(
            Code.BELOW_FLOOR, f"{row['id']}: E_peak {peak:.6g} J is below E_res {value:.6g} J"
        )


def require_path(row: Mapping[str, Any], least: float) -> None:
    """Refuse a motion that disturbs the base less than `path_floor`."""
    if row["E_mean"] is not None and row["E_mean"] < least:
        raise BundleError(
            Code.BELOW_FLOOR,
            f"{row['id']}: E_mean {row['E_mean']:.3g} J, momentum permits {least:.3g} J",
        )


def path_floor(system: System, start: Array, goal: Array, duration: float) -> float:
    """Least E_mean [J] of any motion from rest at start to rest at goal.

    With u = H_bm(q) q' the joints' momentum, P = M_t Y' + u and P' = -D Y' - K Y: whatever the
    arm does, u = P - M_t Y'. In the norm |x| = |m^-1/2 x| with m >= M_t(q) for every q,
    |M_t Y'| <= sqrt(2 E) and |K Y| + |D Y'| <= (w + d) sqrt(2 E), w and d the largest
    frequency of K by m and the largest rate at which D takes momentum from the base's own mass.
    Projected on k of the eigenvectors of K by m, both are those of these k. Integrated,

        s_j |goal_j - start_j| <= int |u| dt <= (1 + (w + d) T) int sqrt(2 E) dt,

    s_j the least momentum that joint j takes at unit rate, however the others move: 1 over the
    norm of its row in the pseudo-inverse of the projected H_bm. By Cauchy and Schwarz the last
    integral is at most sqrt(2 T (T + tail) E_mean). The best of all j and k counts, with s_j
    taken over the joint ranges on a grid and divided by `_ROOM`.
    """
    distance = np.abs(np.asarray(goal) - np.asarray(start))
    best = 0.0
    for least, rate in _momentum(system):
        reach = float((least * distance).max()) / _ROOM / (1 + rate * duration)
        best = max(best, reach**2 / (2 * duration * (duration + TAIL)))
    return best


@lru_cache(maxsize=8)
def _momentum(system: System) -> list[tuple[Array, float]]:
    """s (joints,) and w + d for the first k modes, k = the number of joints and more."""
    arm, base = system.arm, system.base
    axes = [np.linspace(a, b, _GRID) for a, b in zip(
        arm.column("q_min"), arm.column("q_max"), strict=True)]  # fmt: skip
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, arm.n)
    H = inertia(arm, grid)
    # m >= M_t(q): twice the block diagonal of the largest, |a + b|^2 <= 2 |a|^2 + 2 |b|^2
    body = H[:, :6, :6]
    parts = (body[:, :3, :3], body[:, 3:, 3:])
    moving, turning = (np.linalg.eigvalsh(k)[:, -1].max() for k in parts)
    m = base.mass_matrix + 2 * np.diag([moving] * 3 + [turning] * 3)
    omega, shapes = natural_modes(base.K, m)
    lighter = np.linalg.inv(scipy.linalg.sqrtm(base.mass_matrix).real)
    damping = shapes.T @ base.D @ lighter
    out = []
    for k in range(arm.n, 7):
        part = shapes[:, :k].T @ H[:, :6, 6:]
        least = 1 / np.linalg.norm(np.linalg.pinv(part), axis=2).max(axis=0)
        rate = float(omega[k - 1] + np.linalg.norm(damping[:k], 2))
        out.append((least, rate))
    return out


def strain_floor(system: System, strain: float, peak: float) -> float:
    """Least integral of the strain energy V [J s] of a base let go from rest at V = strain.

    With s = K^1/2 Y, V = |s|^2 / 2 and |s'| <= w sqrt(2 E_peak), w the largest frequency of
    K by the base's own mass matrix: sqrt(V) falls no faster than w sqrt(E_peak), and
    V (t) >= (sqrt(V_0) - w sqrt(E_peak) t)^2 until that is nothing. Half of its integral is
    left for peaks between samples.
    """
    mass, K = system.base.mass_matrix, system.base.K
    lightest = float(np.linalg.eigvalsh(mass)[0])
    if lightest <= 0 or peak <= 0 or strain <= 0:
        return 0.0
    w = math.sqrt(float(scipy.linalg.eigh(K, mass, eigvals_only=True)[-1]))
    return strain**1.5 / (6 * w * math.sqrt(max(peak, strain)))
