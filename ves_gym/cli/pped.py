"""`ves-gym pped`: joint gains that take vibration out of the base, beside the thesis's."""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.common import (
    Tell,
    add_format,
    add_system_arguments,
    out_dir,
    progress,
    system_from,
    write_json,
)
from ves_gym.cli.motions import disturbance, joint_angles
from ves_gym.damping.analysis import THESIS_DISPLACEMENT, DampingAnalysis, analyse
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
from ves_gym.damping.plant import GainMatrices, LinearPlant, plant_at
from ves_gym.damping.tuning import OBJECTIVES, WIDE, Bounds, tune
from ves_gym.damping.virtual_manipulator import tune_virtual
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.simulation.divergence import Divergence
from ves_gym.system.system import System

SCHEMA = "ves-pped/1"
_CHOICES = (*OBJECTIVES, "both")
_HIGH, _PPED = "thesis high (4.6)", "thesis PPED (4.5)"
_WIDEST = 3  # joints whose sections a map shows: those that carry the mass
_LISTED = 5  # configurations printed


@dataclass(frozen=True, eq=False, kw_only=True)
class _Row:
    """One set of gains and what it does."""

    name: str
    damping: DampingAnalysis
    objective: str | None = None  # searched for by; None: given
    full: bool = False
    seconds: float | None = None  # of the search


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--q", metavar="A,B,C", help="joint angles [deg] (default 45,0,0)")
    parser.add_argument(
        "--objective",
        choices=_CHOICES,
        default="both",
        help="strain: integral of strain energy; worst: the same, worst displacement;"
        " estimator: thesis eq. 4.4; both: strain and estimator (both)",
    )
    parser.add_argument(
        "--full", action="store_true", help="full symmetric gain matrices as well"
    )
    parser.add_argument(
        "--bounds",
        metavar="K,K,B,B",
        help="least and largest K [N m/rad] and B [N m s/rad] (1,10000,0.1,1000)",
    )
    parser.add_argument(
        "--disturb",
        metavar="Y",
        help="displacement let go: x,y,z [m] and angles [deg] (0.1,0.1,0.1,0,0,0)",
    )
    parser.add_argument(
        "--map", action="store_true", help="also look for the best configuration"
    )
    parser.add_argument(
        "--points", type=int, default=11, metavar="N", help="of a map, per axis (11)"
    )
    parser.add_argument("--no-figures", action="store_true", help="no pictures")
    add_format(parser)
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Search, compare, simulate, draw."""
    system = system_from(args)
    q = joint_angles(args.q, system.arm, "--q", args.angle_unit, default=(45.0, 0.0, 0.0))
    y = np.array(THESIS_DISPLACEMENT) if args.disturb is None else disturbance(args.disturb)
    if not y.any():
        raise ParameterError("--disturb must be a displacement other than zero")
    if args.map and not 2 <= args.points <= 101:
        raise ParameterError(f"--points must be from 2 to 101, got {args.points}")
    if args.map and system.arm.n < 2:
        raise ParameterError(f"--map needs two joints or more, {system.arm.name} has 1")
    bounds = _bounds(args.bounds)
    plant = plant_at(system, q)
    configurations: list[Configuration] = []
    maps: list[DampingMap] = []
    with progress() as on_progress:
        rows = _rows(args, system, plant, q, y, bounds, on_progress)
        linear, simulated, trouble = _released(system, q, y, rows)
        if args.map:
            configurations, maps = _maps(args, system, y, bounds, on_progress)
    best = min((r for r in rows if r.objective), key=lambda r: r.damping.E_int)
    files = _figures(args, plant, system, rows, linear, simulated, maps)
    write_json(
        args.json,
        {
            "schema": SCHEMA,
            "system": system.hash,
            "q": q.tolist(),
            "y": y.tolist(),
            "bounds": {"K": list(bounds.K), "B": list(bounds.B)},
            "seed": args.seed,
            "objective": best.objective,
            "full": best.full,
            **best.damping.to_dict(),
            "gains": [_row_result(r, k, simulated) for k, r in enumerate(rows)],
            "configurations": [
                {"q": c.q.tolist(), "promised": c.estimated, "E_int": c.tuned.value}
                for c in configurations
            ],
            "map": [_map_result(m) for m in maps],
            "files": [str(f) for f in files],
        },
    )
    _print(system, q, y, rows, simulated, configurations)
    if trouble:
        print(f"not simulated: {trouble}")
    if files:
        print("written: " + "  ".join(str(f) for f in files))
    return 0


def _bounds(text: str | None) -> Bounds:
    if text is None:
        return WIDE
    try:
        low_K, high_K, low_B, high_B = (float(k) for k in text.split(","))
    except ValueError:
        raise ParameterError(
            "--bounds must be four numbers, least and largest K and B, like 1,1e4,0.1,1e3,"
            f" got {text!r}"
        ) from None
    return Bounds(K=(low_K, high_K), B=(low_B, high_B))


def _rows(
    args: argparse.Namespace,
    system: System,
    plant: LinearPlant,
    q: Array,
    y: Array,
    bounds: Bounds,
    on_progress: Tell,
) -> list[_Row]:
    """The thesis's gains, then those found."""
    rows = []
    if plant.n == len(HIGH_GAINS.kp):
        for name, servo in ((_HIGH, HIGH_GAINS), (_PPED, PPED_GAINS)):
            rows.append(_Row(name=name, damping=analyse(plant, GainMatrices.of(servo), y)))
    objectives = ("estimator", "strain") if args.objective == "both" else (args.objective,)
    searches = list(itertools.product(objectives, (False, True) if args.full else (False,)))
    for k, (objective, full) in enumerate(searches):
        on_progress("searching gains", k / (len(searches) + 1))
        tuned = tune(plant, objective, y=y, full=full, bounds=bounds, seed=args.seed)
        rows.append(
            _Row(
                name=f"by {objective}" + (", full" if full else ""),
                damping=analyse(plant, tuned.gains, y),
                objective=objective,
                full=full,
                seconds=tuned.seconds,
            )
        )
    on_progress("searching gains", len(searches) / (len(searches) + 1))
    virtual = tune_virtual(system, q, y=y, bounds=bounds, seed=args.seed)
    damping = analyse(plant, virtual.gains, y)
    rows.append(_Row(name="virtual arm (4.1)", damping=damping))
    on_progress("searching gains", 1.0)
    return rows


def _released(
    system: System, q: Array, y: Array, rows: list[_Row]
) -> tuple[FreeVibration, FreeVibration | None, str]:
    gains = [r.damping.gains for r in rows]
    linear = linear_free_vibration(system, q, gains, y)
    try:
        return linear, simulate_free_vibration(system, q, gains, y), ""
    except Divergence as error:  # a displacement out of all proportion
        return linear, None, str(error)


def _maps(
    args: argparse.Namespace, system: System, y: Array, bounds: Bounds, on_progress: Tell
) -> tuple[list[Configuration], list[DampingMap]]:
    configurations = best_configurations(
        system, y, bounds=bounds, seed=args.seed,
        progress=lambda done: on_progress("looking for configurations", done),
    )  # fmt: skip
    pairs = list(itertools.combinations(range(min(system.arm.n, _WIDEST)), 2))
    maps = []
    for k, pair in enumerate(pairs):

        def part(done: float, k: int = k) -> None:
            on_progress("mapping", (k + done) / len(pairs))

        maps.append(
            damping_map(
                system, pair, configurations[0].q, y, bounds=bounds, points=args.points,
                seed=args.seed, progress=part,
            )
        )  # fmt: skip
    return configurations, maps


def _row_result(row: _Row, k: int, simulated: FreeVibration | None) -> dict[str, Any]:
    out = {
        "name": row.name,
        "objective": row.objective,
        "full": row.full,
        "seconds": row.seconds,
        **row.damping.to_dict(),
        "simulated": None,
    }
    if simulated is not None:
        t_5 = float(simulated.t_5[k])
        out["simulated"] = {
            "duration": float(simulated.t[-1]),
            "E_int": float(simulated.E_int[k]),
            "t_5": t_5 if math.isfinite(t_5) else None,
            "swing": simulated.swing[k].tolist(),
            "effort": simulated.effort[k].tolist(),
        }
    return out


def _map_result(section: DampingMap) -> dict[str, Any]:
    return {
        "joints": [k + 1 for k in section.joints],
        "fixed": section.fixed.tolist(),
        "q": [axis.tolist() for axis in section.axes],
        "coupling": section.coupling.tolist(),
        "promised": section.estimated.tolist(),
        "E_int": section.tuned.tolist(),
    }


def _print(
    system: System,
    q: Array,
    y: Array,
    rows: list[_Row],
    simulated: FreeVibration | None,
    configurations: list[Configuration],
) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 120, markup=False)
    console.print(
        f"{system.arm.name} at {_listed(np.rad2deg(q))} deg on {vehicle_name(system.vehicle)};"
        f" let go from {0.5 * y @ system.base.K @ y:.4g} J"
    )
    table = Table(title="what the gains leave in the base")
    columns = ("gains", "E_int [J s]", "of 4.5", "of 4.6", "simulated", "t_5 [s]",
               "worst [s]", "eq. 4.4", "effort", "found in")  # fmt: skip
    for name in columns:
        table.add_column(name, justify="left" if name == "gains" else "right")
    reference = {r.name: r.damping.E_int for r in rows if r.objective is None}
    for k, row in enumerate(rows):
        d = row.damping
        ratios = (
            f"{d.E_int / reference[name]:.3f}" if name in reference else "-"
            for name in (_PPED, _HIGH)
        )
        table.add_row(
            row.name,
            f"{d.E_int:.4g}",
            *ratios,
            "-" if simulated is None else f"{simulated.E_int[k]:.4g}",
            f"{d.t_5:.2f}",
            f"{d.worst:.3f}",
            f"{d.estimator:.3f}",
            "-" if simulated is None else f"{simulated.effort[k].max():.0%}",
            "-" if row.seconds is None else f"{row.seconds:.2f} s",
        )
    console.print(table)
    console.print(
        "E_int: time integral of strain energy, linear model; simulated: over the first"
        " 30 s; worst: E_int per joule, worst displacement; effort: of the torque limit"
    )
    for row in rows:
        gains, poles = row.damping.gains, row.damping.poles
        console.print(f"{row.name}")
        console.print(
            f"  K {_matrix_text(gains.K)} N m/rad   B {_matrix_text(gains.B)} N m s/rad"
        )
        console.print("  poles " + "  ".join(_pole(p) for p in poles if p.imag >= 0) + " 1/s")
    if configurations:
        console.print("configurations that damp best (strain-energy integral of their gains)")
        for c in configurations[:_LISTED]:
            console.print(f"  {_listed(np.rad2deg(c.q))} deg: {c.tuned.value:.4g} J s")


def _matrix_text(gain: Array) -> str:
    if np.count_nonzero(gain - np.diag(np.diag(gain))) == 0:
        return "diag " + _listed(np.diag(gain))
    cleaned = np.where(np.abs(gain) < 1e-6 * np.abs(gain).max(), 0.0, gain)
    return "[" + "; ".join(_listed(row) for row in cleaned) + "]"


def _listed(values: Array) -> str:
    return ", ".join(f"{v:.4g}" for v in values)


def _pole(p: complex) -> str:
    return f"{p.real:.2f}" if p.imag == 0 else f"{p.real:.2f}±{p.imag:.2f}j"


def _figures(
    args: argparse.Namespace,
    plant: LinearPlant,
    system: System,
    rows: list[_Row],
    linear: FreeVibration,
    simulated: FreeVibration | None,
    maps: list[DampingMap],
) -> list[Path]:
    if args.no_figures:
        return []
    if sentence := lacking("drawing", "matplotlib"):
        print(f"no pictures: {sentence}")
        return []
    from ves_gym.report.damping import map_figure, pole_figure, response_figure
    from ves_gym.report.figures import write_figure
    from ves_gym.simulation.stability import poles_in_space

    base = system.base
    names = [r.name for r in rows]
    figures = {
        "poles": pole_figure(
            [(r.name, r.damping.poles) for r in rows],
            poles_in_space(plant.mass, *base.full()[1:]),
        ),
        "responses": response_figure(names, linear, simulated),
    }
    if maps:
        figures["configurations"] = map_figure(maps)
    folder = out_dir(args, "out/pped")
    paths = [folder / f"pped_{name}.{args.format}" for name in figures]
    for figure, path in zip(figures.values(), paths, strict=True):
        write_figure(figure, path)
    return paths
