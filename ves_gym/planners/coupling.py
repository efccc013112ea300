"""Coupling between joint motion and the base: the matrix Q(q), its spectral form, maps.

Q is reconstructed (the thesis and its sources print no formula; docs/physics.md): the
strain energy that an instantaneous joint displacement leaves in the base. It holds for
motions faster than the base's stiffest mode; `band_limited` is its form for a motion of
a given duration.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
import scipy.optimize
from scipy.stats import qmc

from ves_gym._util.params import Array, ParameterError, write_bytes
from ves_gym._util.views import Viewable
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

# of a map's file
_ARRAYS = ("joints", "first", "second", "fixed", "duration", "least", "most", "direction",
           "disturbance")  # fmt: skip
_MANY = 3000  # angles from which compiled code pays, its first use included
_SAME = 0.2  # rad: spots nearer than this are one


def blocks(system: System, q: npt.ArrayLike, base: BaseModel | None = None) -> InertiaBlocks:
    """Return the inertia blocks of arm and vehicle at configurations q (..., n)."""
    return inertia_blocks(system.arm, (base or system.base).mass_matrix, q)


def modes(system: System, q: npt.ArrayLike) -> Modes:
    """Return the natural modes of (K, M + H_b(q)), undamped."""
    base = system.base
    return natural_modes(base.K, blocks(system, q, base).Mt)


def coupling_matrix(system: System, q: npt.ArrayLike) -> Array:
    """Q(q) = A^T K A with A = M_t^-1 H_bm.

    An instantaneous joint step dq leaves the strain energy 1/2 dq^T Q dq in the base.

    Args:
        system: arm and vehicle.
        q: (..., n) configurations [rad].

    Returns:
        (..., n, n) [J/rad^2].
    """
    angles = np.asarray(q, float)
    if angles.ndim and angles.shape[-1] == system.arm.n and angles.size >= _MANY:
        flat = angles.reshape(-1, system.arm.n)
        compiled = coupling_matrices(system, flat)
        if compiled is not None:
            return compiled.reshape(*angles.shape, system.arm.n)
    base = system.base
    b = blocks(system, q, base)
    A = np.linalg.solve(b.Mt, b.Hbm)
    return np.swapaxes(A, -1, -2) @ (base.K @ A)


def band_limited(system: System, q: npt.ArrayLike, duration: float) -> Array:
    """Q_T(q): Q with each base mode weighted by what a quintic of this duration excites.

    It tends to Q as the duration tends to zero.

    Args:
        system: arm and vehicle.
        q: (..., n) configurations [rad].
        duration: of the motions meant [s].

    Returns:
        (..., n, n) [J/rad^2].

    Raises:
        ParameterError: duration <= 0.
    """
    if not duration > 0:
        raise ParameterError(f"duration must be > 0 s, got {duration!r}")
    base = system.base
    b = blocks(system, q, base)
    m = natural_modes(base.K, b.Mt)
    weight = m.omega * quintic_spectrum(m.omega * duration)
    rows = weight[..., :, None] * (np.swapaxes(m.shapes, -1, -2) @ b.Hbm)
    return np.swapaxes(rows, -1, -2) @ rows


def metric(system: System, q: npt.ArrayLike, duration: float | None) -> Array:
    """Q_T for a duration, raw Q for None.

    Args:
        system: arm and vehicle.
        q: (..., n) configurations [rad].
        duration: of the motions meant [s].

    Returns:
        (..., n, n) [J/rad^2].
    """
    if duration is None:
        return coupling_matrix(system, q)
    return band_limited(system, q, duration)


def disturbance_matrix(system: System, q: npt.ArrayLike) -> Array:
    """A_r^T A_r with the base's rotation per joint motion A_r.

    The disturbance map of a free-floating base: from rest a small joint motion dq turns it
    by sqrt(dq^T A_r^T A_r dq) [rad], for momentum is conserved (Vafa and Dubowsky's map).

    Args:
        system: arm and vehicle.
        q: (..., n) configurations [rad].

    Returns:
        (..., n, n) [1].
    """
    b = blocks(system, q)
    turn = np.linalg.solve(b.Mt, b.Hbm)[..., 3:, :]
    return np.swapaxes(turn, -1, -2) @ turn


class Directions(NamedTuple):
    """Joint directions of least to most coupling, independent of joint scaling."""

    values: Array  # (..., n) J per kg m^2 rad^2: coupling per joint inertia, ascending
    vectors: Array  # (..., n, n) columns, normalised in the effective joint inertia


def invariant_directions(
    system: System, q: npt.ArrayLike, duration: float | None = None
) -> Directions:
    """Solutions of Q v = lambda (H_m - H_bm^T M_t^-1 H_bm) v.

    Args:
        system: arm and vehicle.
        q: (..., n) configurations [rad].
        duration: of Q_T [s]; None for raw Q.

    Returns:
        Eigenvalues (..., n) and eigenvectors (..., n, n).
    """
    b = blocks(system, q)
    effective = b.Hm - np.swapaxes(b.Hbm, -1, -2) @ np.linalg.solve(b.Mt, b.Hbm)
    directions = _modes_of(metric(system, q, duration), effective)
    return Directions(*directions)


def _modes_of(K: Array, M: Array) -> tuple[Array, Array]:
    solution = natural_modes(K, M)
    return solution.omega**2, solution.shapes


def coupling_length(
    system: System, path: npt.ArrayLike, duration: float | None = None
) -> float:
    """L_c = integral of sqrt(dq^T Q dq) along a polyline.

    E <= L_c^2 / 2 bounds the energy of an instantaneous motion along it (raw Q).

    Args:
        system: arm and vehicle.
        path: (N, n) way-points [rad].
        duration: of Q_T [s]; None for raw Q.

    Returns:
        The length [J^(1/2)].
    """
    points = np.asarray(path, float)
    step = np.diff(points, axis=0)
    Q = metric(system, (points[1:] + points[:-1]) / 2, duration)
    squares = np.einsum("ki,kij,kj->k", step, Q, step)
    return float(np.sqrt(np.maximum(squares, 0)).sum())


# ------------------------------------------------------------------------------- maps


@dataclass(frozen=True)
class CouplingMap(Viewable):
    """A cross-section of the coupling matrix: two joints swept, the others fixed."""

    joints: tuple[int, int]  # which joints, from 0
    axes: tuple[Array, Array]  # grid of each [rad]
    fixed: Array  # (n,) configuration of the others [rad]
    duration: float | None  # of Q_T [s]; None is raw Q, or the disturbance matrix
    least: Array  # (ni, nj) smaller eigenvalue of the 2x2 block [J/rad^2; disturbance: 1]
    most: Array  # (ni, nj) larger eigenvalue
    direction: Array  # (ni, nj, 2) unit joint direction of least coupling
    disturbance: bool = False  # of a free-floating base instead of coupling

    def __repr__(self) -> str:
        i, j = self.joints
        kind = "Q" if self.duration is None else f"Q_T for {self.duration:g} s"
        kind, unit = ("disturbance", "") if self.disturbance else (kind, " J/rad^2")
        return (
            f"<CouplingMap: {kind} of joints {i + 1} and {j + 1}, {self.most.min():.4g} to"
            f" {self.most.max():.4g}{unit} along the worst direction>"
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays as .npz, completely or not at all."""
        if Path(path).suffix != ".npz":
            raise ParameterError(f"{path}: expected a .npz name, got {Path(path).suffix!r}")
        buffer = io.BytesIO()
        duration = np.nan if self.duration is None else self.duration
        np.savez_compressed(
            buffer,
            joints=np.array(self.joints),
            first=self.axes[0],
            second=self.axes[1],
            fixed=self.fixed,
            duration=duration,
            least=self.least,
            most=self.most,
            direction=self.direction,
            disturbance=self.disturbance,
        )
        write_bytes(path, buffer.getvalue())

    @staticmethod
    def load(path: str | os.PathLike[str]) -> CouplingMap:
        """Read what `save` wrote.

        Raises:
            ParameterError: it cannot be read, or is no coupling map.
        """
        try:
            with np.load(io.BytesIO(Path(path).read_bytes())) as file:  # unpickles nothing
                arrays = {name: file[name] for name in _ARRAYS}
        except (
            OSError,
            EOFError,
            ValueError,
            KeyError,
            AttributeError,
            TypeError,
            BadZipFile,
        ) as error:
            raise ParameterError(f"{path}: no coupling map can be read: {error}") from None
        duration = float(arrays["duration"])
        i, j = (int(k) for k in arrays["joints"])
        return CouplingMap(
            joints=(i, j),
            axes=(arrays["first"], arrays["second"]),
            fixed=arrays["fixed"],
            duration=None if np.isnan(duration) else duration,
            least=arrays["least"],
            most=arrays["most"],
            direction=arrays["direction"],
            disturbance=bool(arrays["disturbance"]),
        )

    def lines(self, spacing: float = 0.05, step: float = 0.2) -> list[Array]:
        """Minimum-energy lines: curves along the least-coupling direction.

        Args:
            spacing: least distance between lines, as a fraction of the map's width.
            step: integration step in grid cells.

        Returns:
            Polylines (k, 2) in joint angles [rad].
        """
        for name, value in (("spacing", spacing), ("step", step)):
            if not 0 < value <= 1:
                raise ParameterError(f"{name} must be > 0 and <= 1, got {value!r}")
        return _trace_lines(self.axes, self.direction, spacing, step)


def require_section(
    system: System, joints: tuple[int, int], fixed: npt.ArrayLike, points: int, *, least: int
) -> Array:
    """Check a cross-section of joint space and return the configuration it is laid through.

    Args:
        system: its arm has n joints.
        joints: numbers of the two joints swept, from 0.
        fixed: (n,) configuration of the others [rad].
        points: of the grid, per axis.
        least: points needed.

    Returns:
        `fixed` as an array (n,) [rad].

    Raises:
        ParameterError: no two joints of the arm, too few points, or a joint beyond its limits.
    """
    n = system.arm.n
    i, j = joints
    if not (0 <= i < n and 0 <= j < n and i != j):
        raise ParameterError(f"joints must be two different numbers in [0, {n}), got {joints}")
    if points < least:
        raise ParameterError(f"points must be >= {least}, got {points}")
    return system.arm.require_within_limits(fixed, "fixed")


def coupling_map(
    system: System,
    joints: tuple[int, int],
    fixed: npt.ArrayLike,
    *,
    duration: float | None = None,
    points: int = 61,
    limits: tuple[tuple[float, float], tuple[float, float]] | None = None,
    disturbance: bool = False,
) -> CouplingMap:
    """Sweep two joints over their range with the others fixed.

    Args:
        system: arm and vehicle.
        joints: numbers of the two joints, from 0.
        fixed: (n,) configuration of the others [rad].
        duration: of Q_T [s]; None for raw Q.
        points: of the grid, per axis.
        limits: (low, high) of both joints [rad]; default their range.
        disturbance: map `disturbance_matrix` instead.

    Returns:
        Eigenvalues and directions of the 2 x 2 block on the grid.

    Raises:
        ParameterError: bad joints, limits or points, or a disturbance map with a duration.
    """
    if disturbance and duration is not None:
        raise ParameterError(f"a disturbance map has no duration, got {duration!r}")
    i, j = joints
    at = require_section(system, joints, fixed, points, least=4)
    ranges = limits or tuple(
        (system.arm.links[k].q_min, system.arm.links[k].q_max) for k in joints
    )
    for low, high in ranges:
        if not (np.isfinite([low, high]).all() and low < high):
            raise ParameterError(f"limits must be (low, high) in rad, got ({low}, {high})")
    axes = tuple(np.linspace(*r, points) for r in ranges)
    q = np.broadcast_to(at, (points, points, len(at))).copy()
    q[..., i], q[..., j] = np.meshgrid(*axes, indexing="ij")
    full = disturbance_matrix(system, q) if disturbance else metric(system, q, duration)
    block = full[..., [i, j], :][..., :, [i, j]]
    values, vectors = np.linalg.eigh(block)
    return CouplingMap(
        (i, j),
        (axes[0], axes[1]),
        at,
        duration,
        values[..., 0],
        values[..., 1],
        vectors[..., :, 0],
        disturbance,
    )


class Spot(NamedTuple):
    """A configuration where coupling is locally largest (a hot spot) or least."""

    q: Array  # (n,) rad
    coupling: float  # largest eigenvalue of the matrix [J/rad^2]


def spots(
    system: System,
    *,
    hot: bool = True,
    duration: float | None = None,
    count: int = 5,
    samples: int = 4096,
) -> list[Spot]:
    """Return the strongest hot spots in the joint space of all n joints, or the least coupled.

    Starts from the best of Halton's points in the joint box, each followed uphill (or
    downhill) inside the box; those within 0.2 rad of a better one are the same spot.

    Args:
        system: arm and vehicle.
        hot: largest coupling; False for least.
        duration: of Q_T [s]; None for raw Q.
        count: spots wanted.
        samples: Halton's points.

    Returns:
        At most `count` spots, strongest (or least coupled) first.

    Raises:
        ParameterError: not 1 <= count <= samples.
    """
    if count < 1 or samples < count:
        raise ParameterError(f"need 1 <= count <= samples, got {count} and {samples}")
    arm, sign = system.arm, -1.0 if hot else 1.0
    low, high = arm.column("q_min"), arm.column("q_max")
    at = qmc.scale(qmc.Halton(arm.n, scramble=False).random(samples), low, high)

    def strength(q: npt.ArrayLike) -> Array:
        return np.asarray(
            sign * np.linalg.eigvalsh(metric(system, q, duration))[..., -1], float
        )

    extrema: list[Spot] = []
    for k in np.argsort(strength(at)):
        if any(np.linalg.norm(at[k] - spot.q) < _SAME for spot in extrema):
            continue
        best = scipy.optimize.minimize(
            lambda q: float(strength(q)), at[k], method="L-BFGS-B",
            bounds=scipy.optimize.Bounds(low, high),
        )  # fmt: skip
        if all(np.linalg.norm(best.x - spot.q) >= _SAME for spot in extrema):
            extrema.append(Spot(best.x, float(sign * best.fun)))
        if len(extrema) >= count:
            break
    return sorted(extrema, key=lambda spot: sign * spot.coupling)


def _trace_lines(
    axes: tuple[Array, Array], field: Array, spacing: float, step: float
) -> list[Array]:
    """Evenly spaced curves of a line field (sign-free directions) on a grid."""
    size = np.array(field.shape[:2]) - 1
    origin = np.array([axes[0][0], axes[1][0]])
    cell = np.array([axes[0][1] - axes[0][0], axes[1][1] - axes[1][0]])
    bins = max(2, round(1 / spacing))
    taken = np.zeros((bins, bins), bool)

    def bin_of(p: Array) -> tuple[int, int]:
        k = np.minimum((p / size * bins).astype(int), bins - 1)
        return int(k[0]), int(k[1])

    def towards(p: Array, heading: Array) -> Array:
        k = np.minimum(p.astype(int), size - 1)
        f = p - k
        total = np.zeros(2)
        for dx, dy in ((0, 0), (0, 1), (1, 0), (1, 1)):
            d = field[k[0] + dx, k[1] + dy] / cell
            weight = (f[0] if dx else 1 - f[0]) * (f[1] if dy else 1 - f[1])
            total += weight * (d if d @ heading >= 0 else -d)
        length = np.linalg.norm(total)
        return total / length if length > 0 else heading

    def march(start: Array, heading: Array, visited: set[tuple[int, int]]) -> list[Array]:
        curve, p = [], start
        last_visit = {bin_of(start): 0}  # when the line was last in a bin
        lap = int(3 * size.max() / bins / step)  # longer away than this, it has come round
        for i in range(1, int(8 * size.max() / step)):
            heading = towards(p, heading)
            heading = towards(np.clip(p + heading * step / 2, 0, size), heading)
            p = p + heading * step
            if (p < 0).any() or (p > size).any():
                break
            cell_index = bin_of(p)
            if (taken[cell_index] and cell_index not in visited) or i - last_visit.get(
                cell_index, i
            ) > lap:
                break
            last_visit[cell_index] = i
            visited.add(cell_index)
            curve.append(p)
        return curve

    lines = []
    for k in range(bins * bins):
        seed = (np.array(divmod(k * 7919 % (bins * bins), bins)) + 0.5) / bins * size
        if taken[bin_of(seed)]:
            continue
        visited = {bin_of(seed)}
        node = np.minimum(seed.round().astype(int), size)
        heading = field[node[0], node[1]] / cell
        heading = heading / np.linalg.norm(heading)
        back, ahead = march(seed, -heading, visited), march(seed, heading, visited)
        curve = np.array([*back[::-1], seed, *ahead])
        for cell_index in visited:
            taken[cell_index] = True
        if len(curve) * step > 1.5 / spacing / bins:
            lines.append(origin + curve * cell)
    return lines
