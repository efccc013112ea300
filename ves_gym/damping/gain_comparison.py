"""Joint gains that take vibration out of the base, beside the thesis's (thesis 4.3)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.tables import table
from ves_gym.damping.configurations import (
    Configuration,
    DampingMap,
    best_configurations,
    damping_map,
)
from ves_gym.damping.free_vibration import (
    FreeVibration,
    linear_free_vibration,
    simulate_free_vibration,
)
from ves_gym.damping.plant import (
    THESIS_DISPLACEMENT,
    DampingAnalysis,
    GainMatrices,
    LinearPlant,
    analyse,
    plant_at,
)
from ves_gym.damping.tuning import WIDE, Bounds, tune
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.simulation.machines import Divergence
from ves_gym.system.system import System

SCHEMA = "ves-pped/1"
BOTH = ("estimator", "strain")  # objectives that are searched for unless one is asked
_HIGH, _PPED = "thesis high (4.6)", "thesis PPED (4.5)"
_WIDEST = 3  # joints whose sections a map shows: those that carry the mass
_LISTED = 5  # configurations printed

Progress = Callable[[str, float], None]


class GainRow(NamedTuple):
    """One set of gains and what it does."""

    name: str
    damping: DampingAnalysis
    objective: str | None = None  # searched for by; None: given
    full: bool = False
    seconds: float | None = None  # of the search


@dataclass(frozen=True, eq=False, kw_only=True)
class GainComparison:
    """Sets of gains at one configuration, the base let go from one displacement."""

    system: System
    plant: LinearPlant
    q: Array  # (n,) [rad]
    y: Array  # (6,) [m, rad]
    bounds: Bounds
    seed: int
    rows: tuple[GainRow, ...]
    linear: FreeVibration
    simulated: FreeVibration | None
    trouble: str = ""  # why it is not simulated
    configurations: tuple[Configuration, ...] = ()  # that damp best, where they were looked for
    maps: tuple[DampingMap, ...] = ()

    @property
    def best(self) -> GainRow:
        """Of the gains that were searched for those that leave least."""
        return min((r for r in self.rows if r.objective), key=lambda r: r.damping.E_int)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; what is infinite is None."""
        best = self.best
        return {
            "schema": SCHEMA,
            "system": self.system.hash,
            "q": self.q.tolist(),
            "y": self.y.tolist(),
            "bounds": {"K": list(self.bounds.K), "B": list(self.bounds.B)},
            "seed": self.seed,
            "objective": best.objective,
            "full": best.full,
            **best.damping.to_dict(),
            "gains": [self._row(row, k) for k, row in enumerate(self.rows)],
            "configurations": [
                {"q": c.q.tolist(), "promised": c.estimated, "E_int": c.tuned.value}
                for c in self.configurations
            ],
            "map": [_section(m) for m in self.maps],
        }

    def _row(self, row: GainRow, k: int) -> dict[str, Any]:
        out, run = row._asdict(), self.simulated
        simulated = run and {
            "duration": float(run.t[-1]),
            "E_int": float(run.E_int[k]),
            "t_5": float(run.t_5[k]) if math.isfinite(run.t_5[k]) else None,
            "swing": run.swing[k].tolist(),
            "effort": run.effort[k].tolist(),
        }
        return out | {**out.pop("damping").to_dict(), "simulated": simulated}

    def __str__(self) -> str:
        system, y, run = self.system, self.y, self.simulated
        reference = {r.name: r.damping.E_int for r in self.rows if r.objective is None}
        rows = []
        for k, row in enumerate(self.rows):
            d = row.damping
            ratios = (
                f"{d.E_int / reference[name]:.3f}" if name in reference else "-"
                for name in (_PPED, _HIGH)
            )
            simulated, effort = "-", "-"
            if run is not None:
                simulated, effort = f"{run.E_int[k]:.4g}", f"{run.effort[k].max():.0%}"
            settled = "-" if row.seconds is None else f"{row.seconds:.2f} s"
            rows.append((row.name, f"{d.E_int:.4g}", *ratios, simulated, f"{d.t_5:.2f}",
                         f"{d.worst:.3f}", f"{d.estimator:.3f}", effort, settled))  # fmt: skip
        head = ("gains", "E_int [J s]", "of 4.5", "of 4.6", "simulated", "t_5 [s]",
                "worst [s]", "eq. 4.4", "effort", "found in")  # fmt: skip
        lines = [
            f"{system.arm.name} at {_listed(np.rad2deg(self.q))} deg on"
            f" {vehicle_name(system.vehicle)}; let go from {0.5 * y @ system.base.K @ y:.4g} J",
            table(head, rows, title="what the gains leave in the base"),
            "E_int: time integral of strain energy, linear model; simulated: over the first"
            " 30 s; worst: E_int per joule, worst displacement; effort: of the torque limit",
        ]
        for row in self.rows:
            gains, poles = row.damping.gains, row.damping.poles
            lines += [
                row.name,
                f"  K {_matrix(gains.K)} N m/rad   B {_matrix(gains.B)} N m s/rad",
                "  poles " + "  ".join(_pole(p) for p in poles if p.imag >= 0) + " 1/s",
            ]
        if self.configurations:
            lines.append(
                "configurations that damp best (strain-energy integral of their gains)"
            )
        for c in self.configurations[:_LISTED]:
            lines.append(f"  {_listed(np.rad2deg(c.q))} deg: {c.tuned.value:.4g} J s")
        if self.trouble:
            lines.append(f"not simulated: {self.trouble}")
        return "\n".join(lines)


def compare_gains(
    system: System,
    q: Array,
    y: Array | Sequence[float] = THESIS_DISPLACEMENT,
    *,
    objectives: Sequence[str] = BOTH,
    full: bool = False,
    bounds: Bounds = WIDE,
    points: int | None = None,
    seed: int = 0,
    progress: Progress = lambda stage, done: None,
) -> GainComparison:
    """Search gains, compare them with the thesis's, simulate the base let go.

    Args:
        system: mode ideal, drive motor.
        q: (n,) joint angles [rad].
        y: (6,) displacement of the base that is let go [m, rad].
        objectives: that gains are searched by.
        full: search full symmetric gain matrices as well.
        bounds: of the gains.
        points: per axis of maps of configurations; None: none are made.
        seed: of the searches.
        progress: called with a stage and the fraction done.

    Raises:
        ParameterError: no displacement, a base without stiffness, or a value out of range.
    """
    y = np.asarray(y, float)
    if not y.any():
        raise ParameterError("the base must be let go from a displacement other than zero")
    if points is not None and system.arm.n < 2:
        raise ParameterError(f"a map needs two joints or more, {system.arm.name} has 1")
    plant = plant_at(system, q)
    rows = []
    if plant.n == len(HIGH_GAINS.kp):
        for name, servo in ((_HIGH, HIGH_GAINS), (_PPED, PPED_GAINS)):
            rows.append(GainRow(name, analyse(plant, GainMatrices.of(servo), y)))
    searches = list(itertools.product(objectives, (False, True) if full else (False,)))
    for k, (objective, symmetric) in enumerate(searches):
        progress("searching gains", k / len(searches))
        tuned = tune(plant, objective, y=y, full=symmetric, bounds=bounds, seed=seed)
        name = f"by {objective}" + (", full" if symmetric else "")
        damping = analyse(plant, tuned.gains, y)
        rows.append(GainRow(name, damping, objective, symmetric, tuned.seconds))
    progress("searching gains", 1.0)
    gains = [row.damping.gains for row in rows]
    simulated, trouble = None, ""
    try:
        simulated = simulate_free_vibration(system, q, gains, y)
    except Divergence as error:  # a displacement out of all proportion
        trouble = str(error)
    configurations: list[Configuration] = []
    maps: list[DampingMap] = []
    if points is not None:
        search: dict[str, Any] = {"y": y, "bounds": bounds, "seed": seed}
        configurations = best_configurations(
            system, **search, progress=lambda done: progress("looking for configurations", done)
        )
        pairs = list(itertools.combinations(range(min(system.arm.n, _WIDEST)), 2))
        for k, two in enumerate(pairs):
            progress("mapping", k / len(pairs))
            at = configurations[0].q
            maps.append(damping_map(system, two, at, points=points, **search))
    return GainComparison(
        system=system,
        plant=plant,
        q=q,
        y=y,
        bounds=bounds,
        seed=seed,
        rows=tuple(rows),
        linear=linear_free_vibration(system, q, gains, y),
        simulated=simulated,
        trouble=trouble,
        configurations=tuple(configurations),
        maps=tuple(maps),
    )


def _section(section: DampingMap) -> dict[str, Any]:
    return {
        "joints": [k + 1 for k in section.joints],
        "fixed": section.fixed.tolist(),
        "q": [axis.tolist() for axis in section.axes],
        "coupling": section.coupling.tolist(),
        "promised": section.estimated.tolist(),
        "E_int": section.tuned.tolist(),
    }


def _matrix(gain: Array) -> str:
    if np.count_nonzero(gain - np.diag(np.diag(gain))) == 0:
        return "diag " + _listed(np.diag(gain))
    cleaned = np.where(np.abs(gain) < 1e-6 * np.abs(gain).max(), 0.0, gain)
    return "[" + "; ".join(_listed(row) for row in cleaned) + "]"


def _listed(values: Array) -> str:
    return ", ".join(f"{v:.4g}" for v in values)


def _pole(p: complex) -> str:
    return f"{p.real:.2f}" if p.imag == 0 else f"{p.real:.2f}±{p.imag:.2f}j"
