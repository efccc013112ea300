"""`ves-gym structure`: a vehicle file from the matrices of a finite-element model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ves_gym._util.optional import lacking
from ves_gym._util.params import ParameterError
from ves_gym.cli.files import FORMAT, NO_FIGURES
from ves_gym.cli.flags import Answer, Flag, Place, number, path, text, whole, wholes
from ves_gym.cli.machine import arm_flag
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.structure import UNITS, read_structure
from ves_gym.mechanics.structure_summary import BAND, ERROR, vehicle_of

_PARTS = ("M", "K", "D")


def _interface(value: str, place: Place) -> int | list[int]:
    numbers = wholes(value, place)
    if len(numbers) not in (1, 6):
        raise ParameterError(f"{place.name} must be a node or six freedoms, got {value!r}")
    return numbers[0] if len(numbers) == 1 else list(numbers)


def _names(value: str, place: Place) -> dict[str, str]:
    pairs = [part.partition("=")[::2] for part in value.split(",")]
    if not all(key in _PARTS and name for key, name in pairs):
        raise ParameterError(f"{place.name} must be like M=MXX,K=KXX, got {value!r}")
    return dict(pairs)


def _modes(value: str, place: Place) -> int | None:
    try:
        return None if value == "auto" else int(whole()(value, place))
    except ParameterError:
        raise ParameterError(
            f"{place.name} must be a whole number >= 0 or auto, got {value!r}"
        ) from None


def _point(value: str, place: Place) -> tuple[int, list[float]]:
    node, _, at = value.partition(":")
    try:
        point = [float(part) for part in at.split(",")]
        if len(point) == 3:
            return int(node), point
    except ValueError:
        pass
    raise ParameterError(f"{place.name} must be like 2:0,0,-4 3:0,0,-2, got {value!r}")


FLAGS = (
    Flag("FILE", many=True,
         help="one file with mass and stiffness (.npz, .pch, .dmig, .bdf, .op4), or M=FILE"
         " K=FILE and perhaps D=FILE (.npy, .npz, .mtx, .sti, .mas, .op4, .pch)"),
    Flag("--interface", "NODE", _interface,
         "number of the node where the arm stands, or its six freedoms counted from 0:"
         " A,B,C,D,E,F", required=True),
    Flag("--units", "U", text, ", ".join(UNITS), required=True),
    Flag("--modes", "N", _modes,
         f"internal modes to keep, or auto: frequencies with the arm below {BAND:g} Hz within"
         f" {100 * ERROR:g} % (default)"),
    Flag("--damping", "R", number(), "damping ratio of every mode (default: the files' D)"),
    Flag("--rigid-modes", "N", whole(),
         "motions without strain: 0 clamped (default), 6 free"),
    Flag("--held", "A,B,...", wholes, "freedoms that do not move, where the files have them"),
    Flag("--names", "M=A,K=B", _names, "what the files call the matrices, if otherwise"),
    Flag("--line", "NODE:X,Y,Z", _point,
         "nodes to draw the structure by, from the interface [m], in order", row=True),
    Flag("--diameter", "M", number("m"), "to draw it with [m]"),
    arm_flag("puma560"),
    Flag("--save", "FILE", path, "the vehicle, .toml or .json (default OUT/vehicle.toml)"),
    NO_FIGURES,
    FORMAT,
)  # fmt: skip


def run(
    file: Sequence[str],
    interface: int | list[int],
    units: str,
    *,
    rigid_modes: int = 0,
    held: Sequence[int] = (),
    names: dict[str, str] | None = None,
    arm: Arm = PUMA_560,
    modes: int | None = None,
    damping: float | None = None,
    line: Sequence[tuple[int, list[float]]] = (),
    diameter: float | None = None,
    save: Path | None = None,
    no_figures: bool = False,
    format: str = "png",
    out: Path | None = None,
) -> Answer:
    """Read, check and reduce the model; write the vehicle and its frequencies."""
    structure = read_structure(
        _files(file), interface=interface, units=units, rigid_modes=rigid_modes, held=held,
        names=names,
    )  # fmt: skip
    summary = vehicle_of(
        structure, arm, modes=modes, damping=damping, line=[p for _, p in line] or None,
        nodes=[node for node, _ in line], diameter=diameter,
    )  # fmt: skip
    folder = out or Path("out/structure")
    files = [save or folder / "vehicle.toml"]
    summary.vehicle.save(files[0])
    said = [str(summary)]
    if summary.vehicle.centreline() is not None and not no_figures:
        if sentence := lacking("its picture", "matplotlib"):
            said.append(f"no picture: {sentence}")
        else:
            from ves_gym.report.figures import write_figure
            from ves_gym.report.structure import mode_figure

            files.append(folder / f"modes.{format}")
            write_figure(mode_figure(summary.vehicle), files[-1])
    return Answer(
        text="\n".join(said),
        plain=summary.to_dict(),
        files=files,
        next=[["simulate", "--vehicle", files[0]]],
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
