"""Coupling between joint motion and the base: the matrix Q(q), its spectral form.

Q is reconstructed (the thesis and its sources print no formula; docs/physics.md): the
strain energy that an instantaneous joint displacement leaves in the base. It holds for
motions faster than the base's stiffest mode; `band_limited` is its form for a motion of
a given duration.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.maps import coupling_matrices
from ves_gym.mechanics.modes import (
    InertiaBlocks,
    Modes,
    inertia_blocks,
    natural_modes,
    quintic_spectrum,
)
from ves_gym.mechanics.vehicle import BaseModel
from ves_gym.system.system import System

_MANY = 3000  # angles from which compiled code pays, its first use included


def blocks(system: System, q: npt.ArrayLike, base: BaseModel | None = None) -> InertiaBlocks:
    """Return the inertia blocks of arm and vehicle at configurations q (..., n)."""
    return inertia_blocks(system.arm, (base or system.base).full()[0], q)


def modes(system: System, q: npt.ArrayLike) -> Modes:
    """Return the natural modes of (K, M + H_b(q)), undamped."""
    base = system.base
    return natural_modes(base.full()[2], blocks(system, q, base).Mt)


def coupling_matrix(system: System, q: npt.ArrayLike) -> Array:
    """Q(q) = A^T K A with A = M_t^-1 H_bm, at configurations q (..., n): [J/rad^2].

    An instantaneous joint step dq leaves the strain energy 1/2 dq^T Q dq in the base.
    """
    system.arm.require_rigid("a coupling matrix")
    system.arm.require_turning("a coupling matrix")
    angles = np.asarray(q, float)
    if angles.ndim and angles.shape[-1] == system.arm.n and angles.size >= _MANY:
        flat = angles.reshape(-1, system.arm.n)
        return coupling_matrices(system, flat).reshape(*angles.shape, system.arm.n)
    base = system.base
    b = blocks(system, q, base)
    A = np.linalg.solve(b.Mt, b.Hbm)
    return np.swapaxes(A, -1, -2) @ (base.full()[2] @ A)


def band_limited(system: System, q: npt.ArrayLike, duration: float) -> Array:
    """Q_T(q): Q with each base mode weighted by what a quintic of this duration [s] excites.

    It tends to Q as the duration tends to zero. Configurations (..., n) [rad] to (..., n, n)
    [J/rad^2].

    Raises:
        ParameterError: duration <= 0.
    """
    if not duration > 0:
        raise ParameterError(f"duration must be > 0 s, got {duration!r}")
    base = system.base
    b = blocks(system, q, base)
    m = natural_modes(base.full()[2], b.Mt)
    weight = m.omega * quintic_spectrum(m.omega * duration)
    rows = weight[..., :, None] * (np.swapaxes(m.shapes, -1, -2) @ b.Hbm)
    return np.swapaxes(rows, -1, -2) @ rows


def metric(system: System, q: npt.ArrayLike, duration: float | None) -> Array:
    """Q_T for a duration [s], raw Q for None."""
    if duration is None:
        return coupling_matrix(system, q)
    return band_limited(system, q, duration)


def coupling_length(
    system: System, path: npt.ArrayLike, duration: float | None = None
) -> float:
    """L_c = integral of sqrt(dq^T Q dq) along a polyline (N, n) [rad], in J^(1/2).

    E <= L_c^2 / 2 bounds the energy of an instantaneous motion along it (raw Q; Q_T where
    there is a duration [s]).
    """
    points = np.asarray(path, float)
    step = np.diff(points, axis=0)
    Q = metric(system, (points[1:] + points[:-1]) / 2, duration)
    squares = np.einsum("ki,kij,kj->k", step, Q, step)
    return float(np.sqrt(np.maximum(squares, 0)).sum())
