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
from ves_gym.mechanics.linear_motion import LinearMotion
from ves_gym.mechanics.modes import (
    InertiaBlocks,
    Modes,
    natural_modes,
    quintic_spectrum,
)
from ves_gym.system.system import System

_MANY = 3000  # angles from which compiled code pays, its first use included


def blocks(system: System, q: npt.ArrayLike) -> InertiaBlocks:
    """Return the inertia blocks of arm and base at configurations q (..., n).

    The base is all that is driven by no motor: its pose, flexures of the arm, and what is
    hidden in it (wheels, appendages, internal modes).
    """
    return LinearMotion(system.arm, system.base).blocks(q)


def stiffness(system: System) -> Array:
    """K (b, b) of the coordinates that `blocks` calls the base."""
    free = LinearMotion(system.arm, system.base)
    return free.K[: free.b, : free.b]


def modes(system: System, q: npt.ArrayLike) -> Modes:
    """Return the natural modes of (K, M + H_b(q)), undamped."""
    return natural_modes(stiffness(system), blocks(system, q).Mt)


def coupling_matrix(system: System, q: npt.ArrayLike) -> Array:
    """Q(q) = A^T K A with A = M_t^-1 H_bm, at configurations q (..., n): [J/rad^2].

    An instantaneous joint step dq leaves the strain energy 1/2 dq^T Q dq in the base.
    """
    arm = system.arm
    arm.require_turning("a coupling matrix")
    angles = np.asarray(q, float)
    rigid = not (arm.bends or system.base.carried)
    if rigid and angles.ndim and angles.shape[-1] == arm.n and angles.size >= _MANY:
        flat = angles.reshape(-1, arm.n)
        return coupling_matrices(system, flat).reshape(*angles.shape, arm.n)
    b = blocks(system, q)
    A = np.linalg.solve(b.Mt, b.Hbm)
    return np.swapaxes(A, -1, -2) @ (stiffness(system) @ A)


def band_limited(system: System, q: npt.ArrayLike, duration: float) -> Array:
    """Q_T(q): Q with each base mode weighted by what a quintic of this duration [s] excites.

    It tends to Q as the duration tends to zero. Configurations (..., n) [rad] to (..., n, n)
    [J/rad^2].

    Raises:
        ParameterError: duration <= 0.
    """
    if not duration > 0:
        raise ParameterError(f"duration must be > 0 s, got {duration!r}")
    b = blocks(system, q)
    m = natural_modes(stiffness(system), b.Mt)
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
