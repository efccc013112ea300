"""Configurations in which the arm damps its base best (thesis 4.3).

The thesis finds such configurations by the coupling map. Its modes one by one, as in Q_T,
do show them; the size of raw Q does not (tests/claims/test_pped.py).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, finite
from ves_gym.damping.plant import THESIS_DISPLACEMENT, plants
from ves_gym.damping.tuning import WIDE, Bounds, Tuned, tune
from ves_gym.planners.coupling import blocks, coupling_matrix, modes
from ves_gym.planners.coupling_map import cross_section
from ves_gym.system.system import System

_STARTS = 3  # random starts at each configuration
_APART = 0.5  # rad in at least one joint, between candidates


def estimated_integral(
    system: System, q: npt.ArrayLike, y: npt.ArrayLike = THESIS_DISPLACEMENT
) -> Array:
    """Estimate the strain-energy integral (...) [J s] from the coupling; no search.

    Each base mode by itself: released with strain energy E_i, with damping ratio z_i it
    leaves E_i (1/z_i + 4 z_i) / (4 omega_i). z_i is the base's own and sqrt(k_i) / 2, what
    a tuned damper of mass ratio k_i adds at most; k_i = g_i^T H_m^-1 g_i is the share of
    the mode that the joints can take over (g_i = H_bm^T phi_i, as in Q and Q_T). An
    estimate that ranks configurations q (..., n) [rad].
    """
    angles, base = np.asarray(q, float), system.base
    pose = finite(y, (6,), "y")
    release = np.r_[pose, base.attached(pose)]
    b, m = blocks(system, angles), modes(system, angles)
    across = np.swapaxes(m.shapes, -1, -2) @ b.Hbm  # rows g_i
    share = np.einsum(
        "...ij,...ji->...i", across, np.linalg.solve(b.Hm, np.swapaxes(across, -1, -2))
    )
    amplitude = np.einsum("...ji,...jk,k->...i", m.shapes, b.Mt, release)
    energy = 0.5 * (m.omega * amplitude) ** 2
    material = np.einsum("...ji,jk,...ki->...i", m.shapes, base.full()[1], m.shapes) / (
        2 * m.omega
    )
    zeta = material + np.sqrt(np.maximum(share, 0)) / 2
    return np.asarray(np.sum(energy * (1 / zeta + 4 * zeta) / (4 * m.omega), axis=-1))


class Configuration(NamedTuple):
    """A configuration of the arm and what its best gains leave in the base."""

    q: Array  # (n,) rad
    estimated: float  # by the coupling [J s]
    tuned: Tuned  # its value is the strain-energy integral [J s]


def best_configurations(
    system: System,
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    *,
    bounds: Bounds = WIDE,
    samples: int = 4096,
    candidates: int = 24,
    seed: int = 0,
    progress: Callable[[float], None] = lambda done: None,
) -> list[Configuration]:
    """Return configurations in which the arm damps a release from y best, best first.

    The coupling ranks random configurations; gains are tuned for the first of them that
    lie apart. Only joint limits are respected: collisions are not checked.

    Args:
        system: arm and vehicle.
        y: (6,) initial displacement of the base [m, rad].
        bounds: of the gains [N m/rad, N m s/rad].
        samples: configurations ranked.
        candidates: how many of them are tuned, at most.
        seed: of the configurations and of the searches.
        progress: called with the fraction done.

    Raises:
        ParameterError: a base that PPED cannot damp.
    """
    arm, rng = system.arm, np.random.default_rng(seed)
    angles = rng.uniform(arm.column("q_min"), arm.column("q_max"), (samples, arm.n))
    estimated = estimated_integral(system, angles, y)
    chosen: list[int] = []
    for i in np.argsort(estimated, kind="stable").tolist():
        gaps = np.abs(angles[chosen] - angles[i]).max(axis=1)
        if len(chosen) < candidates and (gaps > _APART).all():
            chosen.append(i)
    configurations: list[Configuration] = []
    for i, plant in zip(chosen, plants(system, angles[chosen]), strict=True):
        tuned = tune(plant, y=y, bounds=bounds, starts=_STARTS, seed=seed)
        configurations.append(Configuration(angles[i], float(estimated[i]), tuned))
        progress(len(configurations) / len(chosen))
    return sorted(configurations, key=lambda c: c.tuned.value)


class DampingMap(NamedTuple):
    """A cross-section of joint space: two joints swept, the others fixed."""

    joints: tuple[int, int]  # which joints, from 0
    axes: tuple[Array, Array]  # grid of each [rad]
    fixed: Array  # (n,) configuration of the others [rad]
    coupling: Array  # (ni, nj) trace of raw Q [J/rad^2]
    estimated: Array  # (ni, nj) strain-energy integral by the coupling [J s]
    tuned: Array  # (ni, nj) what the best gains there leave [J s]


def damping_map(
    system: System,
    joints: tuple[int, int],
    fixed: npt.ArrayLike,
    y: npt.ArrayLike = THESIS_DISPLACEMENT,
    *,
    bounds: Bounds = WIDE,
    points: int = 11,
    seed: int = 0,
) -> DampingMap:
    """Tune gains all over a cross-section of joint space, beside what the coupling says.

    Args:
        system: arm and vehicle.
        joints: numbers of the two joints swept, from 0.
        fixed: (n,) configuration of the others [rad].
        y: (6,) initial displacement of the base [m, rad].
        bounds: of the gains [N m/rad, N m s/rad].
        points: of the grid, per axis.
        seed: of the searches.

    Raises:
        ParameterError: bad points, or a base that PPED cannot damp.
    """
    axes, q = cross_section(system, joints, fixed, points, least=2)
    integrals: list[float] = []
    near = None  # gains of the neighbour
    for plant in plants(system, q.reshape(-1, system.arm.n)):
        tuned = tune(plant, y=y, bounds=bounds, starts=_STARTS, seed=seed, first=near)
        near = tuned.gains
        integrals.append(tuned.value)
    return DampingMap(
        joints=joints,
        axes=axes,
        fixed=np.asarray(fixed, float),
        coupling=np.trace(coupling_matrix(system, q), axis1=-2, axis2=-1),
        estimated=estimated_integral(system, q, y),
        tuned=np.reshape(integrals, (points, points)),
    )
