"""`ves-gym map`: coupling-map arrays and the picture of thesis figure 4-1."""

from __future__ import annotations

import argparse
import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import lacking
from ves_gym._util.params import ParameterError, write_bytes
from ves_gym.cli.common import (
    add_format,
    add_system_arguments,
    out_dir,
    progress,
    system_from,
    write_json,
)
from ves_gym.cli.motions import joint_angles
from ves_gym.planners.coupling_map import OTHERS, CouplingMap, coupling_map
from ves_gym.planners.scenes import map_data
from ves_gym.system.system import System

SCHEMA = "ves-map/1"
_MOST = 1001  # points per axis


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--joints", default="all", metavar="I,J", help="two joints to sweep, or all pairs (all)"
    )
    parser.add_argument(
        "--at",
        metavar="A,B,C",
        help="all joints; of the two swept it is not used [deg] (0,0,0)",
    )
    parser.add_argument(
        "--others",
        default="given",
        metavar="O",
        help=f"{', '.join(OTHERS)}: the other joints as --at gives them, or at every point"
        " where the two couple least or most (given)",
    )
    parser.add_argument(
        "--duration",
        default="raw",
        metavar="T",
        help="of the motions meant, for Q_T [s]; raw: Q of the thesis (raw)",
    )
    parser.add_argument("--points", type=int, default=61, metavar="N", help="per axis (61)")
    add_format(parser)
    add_system_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Sweep, write arrays and pictures."""
    system = system_from(args)
    pairs = _pairs(args.joints, system.arm.n)
    at = np.clip(0.0, system.arm.column("q_min"), system.arm.column("q_max"))
    if args.at is not None:
        at = joint_angles(args.at, system.arm, "--at", args.angle_unit)
    duration = _duration(args.duration)
    if not 4 <= args.points <= _MOST:
        raise ParameterError(f"--points must be from 4 to {_MOST}, got {args.points}")
    maps: list[CouplingMap] = []
    with progress() as on_progress:

        def tell(done: float) -> None:
            on_progress("mapping", (len(maps) + done) / len(pairs))

        for pair in pairs:
            section = coupling_map(
                system,
                pair,
                at,
                duration=duration,
                points=args.points,
                others=args.others,
                progress=tell,
            )
            maps.append(section)
            tell(0.0)
            _print(section)
    if args.json is not None:
        write_json(args.json, _result(system, maps))
    written = _write(args, maps, out_dir(args, "out/map"))
    print("written: " + "  ".join(str(p) for p in written))
    return 0


def _print(section: CouplingMap) -> None:
    """Say what a section holds as soon as it is there."""
    i, j = section.joints
    print(
        f"joints {i + 1} and {j + 1}: coupling {section.most.min():.4g} to"
        f" {section.most.max():.4g} J/rad^2 along the worst direction,"
        f" {section.least.min():.4g} to {section.least.max():.4g} along the best",
        flush=True,
    )


def _pairs(text: str, n: int) -> list[tuple[int, int]]:
    if text == "all":
        return list(itertools.combinations(range(n), 2))
    try:
        i, j = (int(part) for part in text.split(","))
    except ValueError:
        i = j = 0
    if not (1 <= i <= n and 1 <= j <= n and i != j):
        raise ParameterError(
            f"--joints must be all, or two different numbers from 1 to {n}, got {text!r}"
        )
    return [(i - 1, j - 1)]


def _duration(text: str) -> float | None:
    if text == "raw":
        return None
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < np.inf:
        raise ParameterError(f"--duration must be raw or seconds > 0, got {text!r}")
    return value


def _result(system: System, maps: list[CouplingMap]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "system": system.hash,
        "duration": maps[0].duration,
        "at": maps[0].fixed.tolist(),
        "others": maps[0].others,
        "maps": [
            {
                "joints": [k + 1 for k in section.joints],
                "q": [axis.tolist() for axis in section.axes],
                "least": section.least.tolist(),
                "most": section.most.tolist(),
                "direction": section.direction.tolist(),
                "lines": [curve.tolist() for curve in section.lines()],
                **({} if section.angles is None else {"angles": section.angles.tolist()}),
            }
            for section in maps
        ],
    }


def _write(args: argparse.Namespace, maps: list[CouplingMap], folder: Path) -> list[Path]:
    arrays: dict[str, Any] = {"fixed": maps[0].fixed}
    for section in maps:
        name = "q{}_q{}".format(*(k + 1 for k in section.joints))
        arrays[f"{name}_first"], arrays[f"{name}_second"] = section.axes
        arrays[f"{name}_least"], arrays[f"{name}_most"] = section.least, section.most
        arrays[f"{name}_direction"] = section.direction
        if section.angles is not None:
            arrays[f"{name}_angles"] = section.angles
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    written = [folder / "map.npz"]
    write_bytes(written[0], buffer.getvalue())
    if sentence := lacking("drawing", "matplotlib"):
        print(f"no picture: {sentence}")
        return written
    from ves_gym.report.figures import coupling_figure, write_figure

    vehicle = args.vehicle or ("own system" if args.system else "bent")
    figure = coupling_figure([map_data(vehicle, section, []) for section in maps], [])
    written.append(folder / f"map.{args.format}")
    write_figure(figure, written[-1])
    return written
