"""`ves-gym structure`: a vehicle file from the matrices of a finite-element model."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.common import add_format, out_dir, write_json
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexible_base import FlexibleBase, Reduced
from ves_gym.mechanics.modes_needed import BAND, ERROR, FINE, frequencies, modes_needed
from ves_gym.mechanics.puma import PUMA_560
from ves_gym.mechanics.structure import UNITS, Structure, read_structure

SCHEMA = "ves-structure/1"
_POSES = 20  # of the arm in which frequencies must be right
_LISTED = 12  # frequencies printed
_PARTS = ("M", "K", "D")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        help="one file with mass and stiffness (.npz, .pch, .dmig, .bdf, .op4), or M=FILE"
        " K=FILE and perhaps D=FILE (.npy, .npz, .mtx, .sti, .mas, .op4, .pch)",
    )
    parser.add_argument(
        "--interface",
        metavar="NODE",
        required=True,
        help="number of the node where the arm stands, or its six freedoms counted from 0:"
        " A,B,C,D,E,F",
    )
    parser.add_argument("--units", metavar="U", required=True, help=", ".join(UNITS))
    parser.add_argument(
        "--modes",
        metavar="N",
        default="auto",
        help=f"internal modes to keep, or auto: frequencies with the arm below {BAND:g} Hz"
        f" within {100 * ERROR:g} %% (default)",
    )
    parser.add_argument(
        "--damping",
        type=float,
        metavar="R",
        help="damping ratio of every mode (default: the files' D)",
    )
    parser.add_argument(
        "--rigid-modes",
        type=int,
        default=0,
        metavar="N",
        help="motions without strain: 0 clamped (default), 6 free",
    )
    parser.add_argument(
        "--held", metavar="A,B,...", help="freedoms that do not move, where the files have them"
    )
    parser.add_argument(
        "--names", metavar="M=A,K=B", help="what the files call the matrices, if otherwise"
    )
    parser.add_argument(
        "--line",
        metavar="NODE:X,Y,Z",
        nargs="+",
        help="nodes to draw the structure by, from the interface [m], in order",
    )
    parser.add_argument("--diameter", type=float, metavar="M", help="to draw it with [m]")
    parser.add_argument("--arm", metavar="A", help="that stands on it (default puma560)")
    parser.add_argument(
        "--save", metavar="FILE", help="the vehicle, .toml or .json (default OUT/vehicle.toml)"
    )
    parser.add_argument("--no-figures", action="store_true", help="no picture of the modes")
    add_format(parser)


def run(args: argparse.Namespace) -> int:
    """Read, check and reduce the model; write the vehicle and its frequencies."""
    structure = read_structure(
        _files(args.files),
        interface=_interface(args.interface),
        units=args.units,
        rigid_modes=args.rigid_modes,
        held=() if args.held is None else _integers(args.held, "--held"),
        names=None if args.names is None else _names(args.names),
    )
    arm = PUMA_560 if args.arm is None else get_arm(args.arm)
    poses = np.random.default_rng(0).uniform(
        arm.column("q_min"), arm.column("q_max"), (_POSES, arm.n)
    )
    poses[0] = (arm.column("q_min") + arm.column("q_max")) / 2
    stood = inertia(arm, poses)[:, :6, :6]
    count = _count(structure, args.modes, stood)
    base = _base(args, structure, count)
    folder = out_dir(args, "out/structure")
    path = Path(args.save) if args.save else folder / "vehicle.toml"
    base.save(path)
    reduced = base.reduction()
    alone, loaded = (frequencies(reduced, H) for H in (np.zeros((6, 6)), stood[0]))
    _print(structure, base, alone, loaded)
    files = [path]
    if base.centreline() is not None and not args.no_figures:
        files += _picture(base, folder / f"modes.{args.format}")
    for file in files:
        print(f"written: {file}")
    print(f"use it: ves-gym plan --vehicle {path} ...")
    result = {
        "schema": SCHEMA,
        "source": structure.source,
        "freedoms": int(structure.stiffness.shape[0]),
        "modes": reduced.m,
        "frequencies": alone.tolist(),
        "frequencies_with_arm": loaded.tolist(),
        "frequencies_held": (reduced.omega / (2 * np.pi)).tolist(),
        "mass": float(reduced.M[0, 0]),
        "files": [str(file) for file in files],
    }
    write_json(args.json, result)
    return 0


def _files(words: list[str]) -> str | dict[str, str]:
    """One path, or paths by M, K and D."""
    named = {word[0]: word[2:] for word in words if word[1:2] == "=" and word[0] in _PARTS}
    if len(words) == 1 and not named:
        return words[0]
    if len(named) != len(words) or not {"M", "K"} <= named.keys():
        raise ParameterError(
            "structure reads one file, or M=FILE K=FILE and perhaps D=FILE, got"
            f" {' '.join(words)!r}"
        )
    return named


def _interface(text: str) -> int | list[int]:
    numbers = _integers(text, "--interface")
    if len(numbers) not in (1, 6):
        raise ParameterError(f"--interface must be a node or six freedoms, got {text!r}")
    return numbers[0] if len(numbers) == 1 else numbers


def _integers(text: str, option: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ParameterError(
            f"{option} must be whole numbers like 4,5,6, got {text!r}"
        ) from None


def _names(text: str) -> dict[str, str]:
    pairs = [part.partition("=")[::2] for part in text.split(",")]
    if not all(key in _PARTS and value for key, value in pairs):
        raise ParameterError(f"--names must be like M=MXX,K=KXX, got {text!r}")
    return dict(pairs)


def _count(structure: Structure, text: str, stood: Array) -> int:
    """Internal modes to keep."""
    if text != "auto":
        try:
            count = int(text)
        except ValueError:
            count = -1
        if count < 0:
            raise ParameterError(f"--modes must be a whole number >= 0 or auto, got {text!r}")
        return count
    outside = np.r_[structure.interface, structure.held].astype(int)
    heavy = np.delete(structure.mass.diagonal(), outside)
    most = int((heavy > 1e-9 * heavy.max(initial=0.0)).sum())
    return modes_needed(structure.reduce(min(FINE, most)), stood)


def _base(args: argparse.Namespace, structure: Structure, count: int) -> FlexibleBase:
    line, nodes = _line(args.line)
    if args.damping is None and structure.damping is None:
        raise ParameterError(
            "the files hold no damping: --damping must give a ratio, like 0.01"
        )
    reduced = Reduced.of(structure, count, centreline=line, nodes=nodes, diameter=args.diameter)
    return FlexibleBase(
        structure=reduced,
        modes=len(reduced.omega),
        damping_ratio=args.damping,
        source=structure.source,
    )


def _line(words: list[str] | None) -> tuple[Array | None, tuple[int, ...]]:
    if words is None:
        return None, ()
    nodes, points = [], []
    for word in words:
        node, _, place = word.partition(":")
        try:
            nodes.append(int(node))
            point = [float(part) for part in place.split(",")]
        except ValueError:
            point = []
        if len(point) != 3:
            raise ParameterError(f"--line must be like 2:0,0,-4 3:0,0,-2, got {word!r}")
        points.append(point)
    return np.array(points), tuple(nodes)


def _print(structure: Structure, base: FlexibleBase, alone: Array, loaded: Array) -> None:
    from rich.console import Console
    from rich.table import Table

    reduced = base.reduction()
    print(
        f"{structure.source}: {structure.stiffness.shape[0]} freedoms, {reduced.M[0, 0]:.4g} kg"
        f" felt at the interface; {reduced.m} internal modes kept"
    )
    table = Table(title="natural frequencies [Hz]")
    for name in ("mode", "alone", "with the arm", "interface held"):
        table.add_column(name, justify="right")
    held = reduced.omega / (2 * np.pi)
    for k in range(min(len(alone), _LISTED)):
        last = f"{held[k]:.4g}" if k < len(held) else ""
        table.add_row(str(k + 1), f"{alone[k]:.4g}", f"{loaded[k]:.4g}", last)
    Console(width=None if sys.stdout.isatty() else 100, markup=False).print(table)


def _picture(base: FlexibleBase, path: Path) -> list[Path]:
    """Draw the modes; a machine without the extra gets everything else."""
    if sentence := lacking("its picture", "matplotlib"):
        print(f"no picture: {sentence}")
        return []
    from ves_gym.report.figures import write_figure
    from ves_gym.report.structure import mode_figure

    write_figure(mode_figure(base), path)
    return [path]
