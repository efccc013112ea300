"""A finite-element model as a vehicle: how many modes it needs, and its frequencies.

Modes are counted by the frequencies of the structure with the arm on it: all below a band must
be as with many modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.tables import table
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.craig_bampton import Reduction
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.structure import Structure

BAND = 20.0  # Hz
ERROR = 0.01  # of a frequency
FINE = 40  # modes that stand for all of them

SCHEMA = "ves-structure/1"
_POSES = 20  # of the arm in which frequencies must be right
_LISTED = 12  # frequencies printed


@dataclass(frozen=True, eq=False)
class StructureSummary:
    """The vehicle of a model, and its natural frequencies [Hz]; `vehicle_of` makes it."""

    vehicle: FlexibleBase
    freedoms: int  # of the model
    alone: Array
    loaded: Array  # with the arm on it, in the middle of its range

    @property
    def fixed(self) -> Array:
        """Frequencies of the internal modes, the interface held."""
        out: Array = self.vehicle.reduction().omega / (2 * np.pi)
        return out

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        reduced = self.vehicle.reduction()
        return {
            "schema": SCHEMA,
            "source": self.vehicle.source,
            "freedoms": self.freedoms,
            "modes": reduced.m,
            "frequencies": self.alone.tolist(),
            "frequencies_with_arm": self.loaded.tolist(),
            "frequencies_held": self.fixed.tolist(),
            "mass": float(reduced.M[0, 0]),
        }

    def __str__(self) -> str:
        reduced, fixed = self.vehicle.reduction(), self.fixed
        rows = []
        for k in range(min(len(self.alone), _LISTED)):
            last = f"{fixed[k]:.4g}" if k < len(fixed) else ""
            rows.append([str(k + 1), f"{self.alone[k]:.4g}", f"{self.loaded[k]:.4g}", last])
        head = ("mode", "alone", "with the arm", "interface held")
        return (
            f"{self.vehicle.source}: {self.freedoms} freedoms, {reduced.M[0, 0]:.4g} kg felt at"
            f" the interface; {reduced.m} internal modes kept\n"
            + table(head, rows, title="natural frequencies [Hz]", left=())
        )


def vehicle_of(
    structure: Structure,
    arm: Arm,
    *,
    modes: int | None = None,
    damping: float | None = None,
    line: npt.ArrayLike | None = None,
    nodes: Sequence[int] = (),
    diameter: float | None = None,
) -> StructureSummary:
    """Reduce a model to its interface and as many internal modes as the arm asks for.

    Args:
        arm: that stands on it.
        modes: to keep; None: so many that frequencies with the arm are right.
        damping: ratio of every mode; None: the model's own matrix.
        line: (k, 3) points to draw it by, from the interface [m].
        nodes: of these points.
        diameter: to draw it with [m].

    Raises:
        ParameterError: no damping anywhere, or more modes than there are.
    """
    if damping is None and structure.damping is None:
        raise ParameterError(
            "the files hold no damping: --damping must give a ratio, like 0.01"
        )
    low, high = arm.column("q_min"), arm.column("q_max")
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, arm.n))
    poses[0] = (low + high) / 2
    stood = inertia(arm, poses)[:, :6, :6]
    if modes is None:
        outside = np.r_[structure.interface, structure.held].astype(int)
        heavy = np.delete(structure.mass.diagonal(), outside)
        most = int((heavy > 1e-9 * heavy.max(initial=0.0)).sum())
        modes = modes_needed(structure.reduce(min(FINE, most)), stood)
    drawn = None if line is None else np.asarray(line, float)
    reduced = structure.reduced(modes, centreline=drawn, nodes=nodes, diameter=diameter)
    base = FlexibleBase(
        structure=reduced,
        modes=len(reduced.omega),
        damping_ratio=damping,
        source=structure.source,
    )
    alone, loaded = (frequencies(base.reduction(), H) for H in (np.zeros((6, 6)), stood[0]))
    return StructureSummary(base, int(structure.stiffness.shape[0]), alone, loaded)


def modes_needed(
    fine: Reduction, inertia: Array, *, band: float = BAND, error: float = ERROR
) -> int:
    """Return the fewest internal modes with which every frequency in the band is right.

    Args:
        fine: with all modes that are considered, in SI units.
        inertia: (poses, 6, 6) of what stands on the interface, joints locked.
        band: up to which frequencies count [Hz].
        error: of a frequency, relative.
    """
    exact = [frequencies(fine, H) for H in inertia]
    for m in range(fine.m):
        coarse = [frequencies(fine.truncated(m), H) for H in inertia]
        pairs = zip(coarse, exact, strict=True)
        if all(_agree(a, b, band, error) for a, b in pairs):
            return m
    return fine.m


def frequencies(reduction: Reduction, inertia: Array) -> Array:
    """Natural frequencies (6 + m,) [Hz] with a mass on the interface, slowest first.

    Args:
        reduction: in SI units.
        inertia: (6, 6) of what stands on the interface; zeros: nothing does.
    """
    mass, stiffness = reduction.matrices()
    mass = mass.copy()
    mass[:6, :6] += inertia
    out: Array = natural_modes(stiffness, mass).omega / (2 * np.pi)
    return out


def _agree(coarse: Array, exact: Array, band: float, error: float) -> bool:
    inside = exact[exact < band]
    if len(coarse) < len(inside):
        return False
    gap = np.abs(coarse[: len(inside)] - inside)
    return bool((gap <= error * np.maximum(inside, 1e-9)).all())
