"""Coupling maps: two joints of an arm swept, the others given or chosen, thesis figure 4-1."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, write_bytes
from ves_gym._util.suggest import did_you_mean
from ves_gym._util.views import Viewable
from ves_gym.planners.coupling import disturbance_matrix, metric
from ves_gym.planners.field_lines import trace_lines
from ves_gym.planners.grid_search import minimise_on_grid
from ves_gym.planners.metric import Metric
from ves_gym.system.system import System

OTHERS = ("given", "least", "most")
# of a map's file
_ARRAYS = ("joints", "first", "second", "fixed", "duration", "least", "most", "direction",
           "disturbance", "others")  # fmt: skip


@dataclass(frozen=True)
class CouplingMap(Viewable):
    """A cross-section of the coupling matrix: two joints swept, the others given or chosen."""

    joints: tuple[int, int]  # which joints, from 0
    axes: tuple[Array, Array]  # grid of each [rad]
    fixed: Array  # (n,) configuration of the others, where they are given [rad]
    duration: float | None  # of Q_T [s]; None is raw Q, or the disturbance matrix
    least: Array  # (ni, nj) smaller eigenvalue of the 2x2 block [J/rad^2; disturbance: 1]
    most: Array  # (ni, nj) larger eigenvalue
    direction: Array  # (ni, nj, 2) unit joint direction of least coupling
    disturbance: bool = False  # of a free-floating base instead of coupling
    others: str = "given"  # or chosen at every point: one of OTHERS
    angles: Array | None = None  # (ni, nj, n) configurations, where the others are chosen

    def __repr__(self) -> str:
        i, j = self.joints
        kind = "Q" if self.duration is None else f"Q_T for {self.duration:g} s"
        kind, unit = ("disturbance", "") if self.disturbance else (kind, " J/rad^2")
        return (
            f"<CouplingMap: {kind} of joints {i + 1} and {j + 1}, {self.most.min():.4g} to"
            f" {self.most.max():.4g}{unit} along the worst direction>"
        )

    def __str__(self) -> str:
        i, j = self.joints
        return (
            f"joints {i + 1} and {j + 1}: coupling {self.most.min():.4g} to"
            f" {self.most.max():.4g} J/rad^2 along the worst direction,"
            f" {self.least.min():.4g} to {self.least.max():.4g} along the best"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, with lines along the direction of least coupling."""
        return {
            "joints": [k + 1 for k in self.joints],
            "q": [axis.tolist() for axis in self.axes],
            "least": self.least.tolist(),
            "most": self.most.tolist(),
            "direction": self.direction.tolist(),
            "lines": [curve.tolist() for curve in self.lines()],
            **({} if self.angles is None else {"angles": self.angles.tolist()}),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays as .npz, completely or not at all."""
        if Path(path).suffix != ".npz":
            raise ParameterError(f"{path}: expected a .npz name, got {Path(path).suffix!r}")
        buffer = io.BytesIO()
        duration = np.nan if self.duration is None else self.duration
        chosen: dict[str, Any] = {} if self.angles is None else {"angles": self.angles}
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
            others=self.others,
            **chosen,
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
                if "angles" in file:  # where the others were chosen
                    arrays["angles"] = file["angles"]
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
            others=str(arrays["others"]),
            angles=arrays.get("angles"),
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
        return trace_lines(self.axes, self.direction, spacing, step)


def cross_section(
    system: System,
    joints: tuple[int, int],
    fixed: npt.ArrayLike,
    points: int,
    *,
    least: int,
    limits: tuple[tuple[float, float], tuple[float, float]] | None = None,
) -> tuple[tuple[Array, Array], Array]:
    """Return the grid of a cross-section of joint space.

    Args:
        system: its arm has n joints.
        joints: numbers of the two joints swept, from 0.
        fixed: (n,) configuration of the others [rad].
        points: of the grid, per axis.
        least: points needed.
        limits: (low, high) of both joints [rad]; default their range.

    Returns:
        Both axes (points,) and the configurations (points, points, n) [rad].

    Raises:
        ParameterError: no two joints of the arm, bad limits, too few points, or a joint beyond
            its limits.
    """
    arm, (i, j) = system.arm, joints
    arm.require_rigid("a coupling map")
    arm.require_turning("a coupling map")
    if not (0 <= i < arm.n and 0 <= j < arm.n and i != j):
        raise ParameterError(
            f"joints must be two different numbers in [0, {arm.n}), got {joints}"
        )
    if points < least:
        raise ParameterError(f"points must be >= {least}, got {points}")
    at = arm.require_within_limits(fixed, "fixed")
    ranges = limits or tuple((arm.links[k].q_min, arm.links[k].q_max) for k in joints)
    for low, high in ranges:
        if not (np.isfinite([low, high]).all() and low < high):
            raise ParameterError(f"limits must be (low, high) in rad, got ({low}, {high})")
    first, second = (np.linspace(low, high, points) for low, high in ranges)
    q = np.tile(at, (points, points, 1))
    q[..., i], q[..., j] = np.meshgrid(first, second, indexing="ij")
    return (first, second), q


def coupling_map(
    system: System,
    joints: tuple[int, int],
    fixed: npt.ArrayLike,
    *,
    duration: float | None = None,
    points: int = 61,
    limits: tuple[tuple[float, float], tuple[float, float]] | None = None,
    disturbance: bool = False,
    others: str = "given",
    progress: Callable[[float], None] | None = None,
) -> CouplingMap:
    """Sweep two joints over their range, the others given or chosen at every point.

    With `others` "least" ("most") they are where the larger eigenvalue of the two joints' block
    is least (greatest): the best (worst) that a posture can make of the two.

    Args:
        system: arm and vehicle.
        joints: numbers of the two joints, from 0.
        fixed: (n,) configuration of the others [rad]; where they are chosen, a first guess.
        duration: of Q_T [s]; None for raw Q.
        points: of the grid, per axis.
        limits: (low, high) of both joints [rad]; default their range.
        disturbance: map `disturbance_matrix` instead.
        others: one of OTHERS.
        progress: called with the fraction done.

    Returns:
        Eigenvalues and directions of the 2 x 2 block on the grid.

    Raises:
        ParameterError: bad joints, limits, points or others, or a disturbance map with a
            duration.
    """
    if disturbance and duration is not None:
        raise ParameterError(f"a disturbance map has no duration, got {duration!r}")
    if others not in OTHERS:
        raise ParameterError(
            f"others must be one of {', '.join(OTHERS)}, got {others!r}"
            f"{did_you_mean(others, OTHERS)}"
        )
    arm, (i, j) = system.arm, joints
    axes, q = cross_section(system, joints, fixed, points, least=4, limits=limits)

    def block(angles: Array) -> Array:
        if disturbance:
            full = disturbance_matrix(system, angles)
        else:
            full = metric(system, angles, duration)
        return full[..., [i, j], :][..., :, [i, j]]

    chosen = others != "given"
    if chosen:
        sign = 1.0 if others == "least" else -1.0
        of = _fast_block(system, (i, j), duration, disturbance) or block
        q = minimise_on_grid(
            lambda angles: sign * _larger(of(angles)),
            q,
            [k for k in range(arm.n) if k not in joints],
            arm.column("q_min"),
            arm.column("q_max"),
            progress,
        )
    values, vectors = np.linalg.eigh(block(q))
    return CouplingMap(
        (i, j),
        axes,
        np.asarray(fixed, float),
        duration,
        values[..., 0],
        values[..., 1],
        vectors[..., :, 0],
        disturbance,
        others,
        q if chosen else None,
    )


def _larger(block: Array) -> Array:
    """The larger eigenvalue of symmetric (..., 2, 2)."""
    a, b, c = block[..., 0, 0], block[..., 0, 1], block[..., 1, 1]
    out: Array = (a + c) / 2 + np.hypot((a - c) / 2, b)
    return out


def _fast_block(
    system: System, joints: tuple[int, int], duration: float | None, disturbance: bool
) -> Callable[[Array], Array] | None:
    """The block from compiled squares (a's, c's and that of their sum), None for raw Q.

    Raw Q is compiled as a whole (`coupling_matrix`).
    """
    if not disturbance and (duration is None or not system.base.K.any()):
        return None
    squares = Metric(system, "disturbance" if disturbance else "qt", duration)
    steps = np.eye(system.arm.n)[list(joints)]
    steps = np.stack([*steps, steps.sum(axis=0)])

    def block(angles: Array) -> Array:
        a, c, sum_of_both = squares.squares(angles, steps[:, None, :])
        b = (sum_of_both - a - c) / 2
        out = np.array([[a, b], [b, c]]) - squares.least * np.eye(2)[..., None]
        return np.moveaxis(out, -1, 0)

    return block
