"""`ves-gym structure`: a vehicle file from the matrices of a finite-element model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.cli.files import PICTURES
from ves_gym.cli.flags import (
    Answer,
    Flag,
    floats,
    integer,
    integers,
    number,
    path,
    read,
    text,
    word_or,
)
from ves_gym.cli.machine import arm_flag
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.structure import UNITS, read_structure
from ves_gym.mechanics.structure_summary import BAND, ERROR, vehicle_of

_PARTS = ("M", "K", "D")


def _interface(value: str) -> int | list[int]:
    numbers = [int(part) for part in value.split(",")]
    if len(numbers) not in (1, 6):
        raise ValueError
    return numbers[0] if len(numbers) == 1 else numbers


def _names(value: str) -> dict[str, str]:
    pairs = [part.partition("=")[::2] for part in value.split(",")]
    if not all(key in _PARTS and name for key, name in pairs):
        raise ValueError
    return dict(pairs)


def _point(value: str) -> tuple[int, list[float]]:
    node, _, at = value.partition(":")
    x, y, z = floats(at)
    return int(node), [x, y, z]


FLAGS = (
    Flag("FILE", many=True,
         help="one file with mass and stiffness (.npz, .pch, .dmig, .bdf, .op4), or M=FILE"
         " K=FILE and perhaps D=FILE (.npy, .npz, .mtx, .sti, .mas, .op4, .pch)"),
    Flag("--interface", "NODE", read(_interface, "a node or six freedoms"),
         "number of the node where the arm stands, or its six freedoms counted from 0:"
         " A,B,C,D,E,F", required=True),
    Flag("--units", "U", text, ", ".join(UNITS), required=True),
    Flag("--modes", "N", word_or("auto", integer(), "a whole number >= 0 or auto"),
         f"internal modes to keep, or auto: frequencies with the arm below {BAND:g} Hz within"
         f" {100 * ERROR:g} % (default)"),
    Flag("--damping", "R", number(), "damping ratio of every mode (default: the files' D)"),
    Flag("--rigid-modes", "N", integer(),
         "motions without strain: 0 clamped (default), 6 free"),
    Flag("--held", "A,B,...", integers, "freedoms that do not move, where the files have them"),
    Flag("--names", "M=A,K=B", read(_names, "like M=MXX,K=KXX"),
         "what the files call the matrices, if otherwise"),
    Flag("--line", "NODE:X,Y,Z", read(_point, "like 2:0,0,-4 3:0,0,-2"),
         "nodes to draw the structure by, from the interface [m], in order", to="points",
         row=True),
    Flag("--diameter", "M", number("m"), "to draw it with [m]"),
    arm_flag("puma560"),
    Flag("--save", "FILE", path, "the vehicle, .toml or .json (default OUT/vehicle.toml)"),
    *PICTURES,
)  # fmt: skip


def run(
    file: Sequence[str],
    *,
    arm: Arm = PUMA_560,
    modes: int | None = None,
    damping: float | None = None,
    points: Sequence[tuple[int, list[float]]] = (),
    diameter: float | None = None,
    save: Path | None = None,
    out: Path | None = None,
    **source: Any,
) -> Answer:
    """Read, check and reduce the model; write the vehicle and its frequencies."""
    summary = vehicle_of(
        read_structure(_files(file), **source), arm, modes=modes, damping=damping,
        line=[point for _, point in points] or None, nodes=[node for node, _ in points],
        diameter=diameter,
    )  # fmt: skip
    folder, vehicle = out or Path("out/structure"), summary.vehicle
    path = save or folder / "vehicle.toml"
    vehicle.save(path)

    def figures() -> dict[Path, Any]:
        from ves_gym.report.machine_figures import mode_figure

        return {folder / "modes": mode_figure(vehicle)}

    return Answer(
        text=summary,
        plain=summary.to_dict(),
        files=[path],
        figures=figures if vehicle.centreline() is not None else None,
        then=[["simulate", "--vehicle", path]],
    )


def _files(words: Sequence[str]) -> str | dict[str, str]:
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
