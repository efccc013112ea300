"""`ves-gym map`, `pped`, `emulation-check`, `calibrate`, `structure`: what a machine is."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import ves_gym.api as vg
from ves_gym._util.params import Array, ParameterError, write_table
from ves_gym.cli.flags import (
    FORMAT,
    PICTURES,
    Answer,
    Context,
    Flag,
    file_to_write,
    floats,
    integer,
    integers,
    joints,
    log_file,
    number,
    one_of,
    pose,
    read,
    text,
    word_or,
)
from ves_gym.cli.machine import MACHINE, arm_flags
from ves_gym.cli.simulate import GAINS
from ves_gym.damping.gain_comparison import BOTH, compare_gains
from ves_gym.damping.tuning import OBJECTIVES, Bounds
from ves_gym.mechanics.arm import Arm, read_arm
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.structure import BAND, ERROR, UNITS, read_structure, vehicle_of
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.planners.case import Case
from ves_gym.planners.coupling_map import OTHERS
from ves_gym.planners.scenes import map_data
from ves_gym.report.damping import damping_figures
from ves_gym.report.figures import coupling_figure
from ves_gym.report.machine_figures import emulation_figures, mode_figure
from ves_gym.simulation.stable_step import with_stable_step
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System


def coupling_map(
    at: Context, *, pair: tuple[int, int] | None = None, q: Array | None = None, **how: Any
) -> Answer:
    """Sweep, write arrays and pictures."""
    system, folder = at.case.system, at.folder("out/map")
    if q is not None:
        how |= {f"q{k + 1}": value for k, value in enumerate(q)}
    every = list(itertools.combinations(range(1, system.arm.n + 1), 2))
    pairs = every if pair is None else [pair]
    maps, files = [], []
    for k, swept in enumerate(pairs):
        maps.append(vg.coupling_map(system, joints=swept, **how))
        at.progress((k + 1) / len(pairs))
    for section in maps:
        i, j = (k + 1 for k in section.joints)
        files.append(folder / f"map_q{i}_q{j}.npz")
        section.save(files[-1])

    def figures() -> dict[str, Any]:
        vehicle = vehicle_name(system.vehicle)
        return {"map": coupling_figure([map_data(vehicle, k, []) for k in maps], [])}

    plain = {
        "schema": "ves-map/1",
        "system": system.hash,
        "duration": maps[0].duration,
        "at": maps[0].fixed.tolist(),
        "others": maps[0].others,
        "maps": [section.to_dict() for section in maps],
    }
    text = "\n".join(map(str, maps))
    return Answer(text=text, plain=plain, files=files, figures=figures, folder=folder)


def _bounds(value: str) -> Bounds:
    low_K, high_K, low_B, high_B = floats(value)
    return Bounds(K=(low_K, high_K), B=(low_B, high_B))


def pped(
    at: Context,
    *,
    q: Array | None = None,
    objective: str = "both",
    map: bool = False,
    points: int = 11,
    **how: Any,
) -> Answer:
    """Search joint gains, compare them with the thesis's, simulate, draw."""
    arm, folder = at.case.system.arm, at.folder("out/pped") if at.pictures else Path()
    if q is None:
        usual = np.deg2rad([45.0, 0.0, 0.0]) if arm.n == 3 and not arm.sliding else 0.0
        q = np.clip(usual, arm.column("q_min"), arm.column("q_max"))
    comparison = compare_gains(
        at.case.system,
        q,
        objectives=BOTH if objective == "both" else (objective,),
        points=points if map else None,
        seed=at.case.seed,
        progress=at.progress,
        **how,
    )
    return Answer(
        text=comparison,
        plain=comparison.to_dict(),
        figures=lambda: damping_figures(comparison),
        folder=folder,
    )


def emulation_check(
    at: Context,
    *,
    q: Array | None = None,
    gains: JointServo | None = None,
    no_search: bool = False,
) -> Answer:
    """Judge the emulation before it runs; negative if it is unstable."""
    system = at.case.system
    if system.mode != "emulated":
        raise ParameterError(f"emulation-check is about --mode emulated, got {system.mode}")
    q = system.arm.home if q is None else q
    servo = at.case.servo if gains is None else gains
    folder = at.folder("out/emulation-check") if at.pictures else Path()
    at.progress(0.0, "linearising the loop")
    check = vg.check_emulation(system, q, servo=servo, search=not no_search)
    return Answer(
        text=check,
        plain=check.to_dict(),
        figures=lambda: emulation_figures(system, q, servo),
        folder=folder,
        negative=not check.stable,
    )


def calibrate(
    at: Context,
    poses: Path,
    *,
    keep_matrix: bool = False,
    keep_zero: bool = False,
    check: Path | None = None,
    **how: Any,
) -> Answer:
    """Fit, check and write the calibration."""
    if check is not None:
        how["check"] = RunLog.load(check)
    elif "rezero" in how:
        raise ParameterError("--rezero is about a second log: give --check LOG")
    matrix, zero, folder = not keep_matrix, not keep_zero, at.folder("out/calibrate")
    result = vg.calibrate(RunLog.load(poses), matrix=matrix, zero=zero, **how)
    path = folder / "calibration.toml"
    write_table(path, result.calibration)
    return Answer(text=result, plain={**result.to_dict(), "log": str(poses)}, files=[path])


# ---------------------------------------------------------------------------- structures

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


def structure(
    at: Context,
    file: Sequence[str],
    *,
    arm: Arm = PUMA_560,
    modes: int | None = None,
    damping: float | None = None,
    points: Sequence[tuple[int, list[float]]] = (),
    diameter: float | None = None,
    save: Path | None = None,
    **source: Any,
) -> Answer:
    """Read, check and reduce the model; write the vehicle, a case of the arm on it, figures."""
    folder = at.folder("out/structure")
    summary = vehicle_of(
        read_structure(_files(file), **source), arm, modes=modes, damping=damping,
        line=[point for _, point in points] or None, nodes=[node for node, _ in points],
        diameter=diameter,
    )  # fmt: skip
    vehicle = summary.vehicle
    path = save or folder / "vehicle.toml"
    vehicle.save(path)
    case = path.with_suffix(".case.toml")
    Case(system=with_stable_step(System(arm=arm, vehicle=vehicle))).save(case)
    drawn = vehicle.centreline() is not None
    return Answer(
        text=summary,
        plain=summary.to_dict(),
        files=[path, case],
        figures=(lambda: {"modes": mode_figure(vehicle)}) if drawn else None,
        folder=folder,
        then=[["simulate", "--case", case]],
    )


# -------------------------------------------------------------------------------- tables

TABLE = {
    "map": (coupling_map, (
        Flag("--joints", "I,J", word_or("all", integers, "whole numbers like 1,2, or all"),
             "two joints to sweep, or all pairs (all)", to="pair"),
        Flag("--at", "A,B,C", joints,
             "all joints; of the two swept it is not used [deg] (0,0,0)", to="q"),
        Flag("--others", "O", one_of(*OTHERS),
             f"{', '.join(OTHERS)}: the other joints as --at gives them, or at every point"
             " where the two couple least or most (given)"),
        Flag("--duration", "T", word_or("raw", number("s", above=0), "raw or seconds > 0"),
             "of the motions meant, for Q_T [s]; raw: Q of the thesis (raw)"),
        Flag("--points", "N", integer(4, 1001), "per axis (61)"),
        FORMAT,
        *MACHINE,
    )),
    "pped": (pped, (
        Flag("--q", "A,B,C", joints, "joint angles [deg] (default 45,0,0)"),
        Flag("--objective", "O", one_of(*OBJECTIVES, "both"),
             "strain: integral of strain energy; worst: the same, worst displacement;"
             " estimator: thesis eq. 4.4; both: strain and estimator (both)"),
        Flag("--full", help="full symmetric gain matrices as well"),
        Flag("--bounds", "K,K,B,B",
             read(_bounds, "four numbers, least and largest K and B, like 1,1e4,0.1,1e3"),
             "least and largest K [N m/rad] and B [N m s/rad] (1,10000,0.1,1000)"),
        Flag("--disturb", "Y", pose,
             "displacement let go: x,y,z [m] and angles [deg] (0.1,0.1,0.1,0,0,0)", to="y"),
        Flag("--map", help="also look for the best configuration"),
        Flag("--points", "N", integer(2, 101), "of a map, per axis (11)"),
        *PICTURES,
        *MACHINE,
    )),
    "emulation-check": (emulation_check, (
        Flag("--at", "A,B,C", joints, "joint angles [deg] (default 0,0,0)", to="q"),
        GAINS,
        Flag("--no-search", help="do not look for the largest bandwidth"),
        *PICTURES,
        *MACHINE,
    )),
    "calibrate": (calibrate, (
        Flag("POSES", read=log_file, help="run log of static poses with q, y, w"),
        Flag("--arm", "FILE", read(read_arm), "an Arm (default: that of the log)"),
        Flag("--iterations", "N", word_or("limit", integer(1), "a number >= 1, or limit"),
             "iterations, or `limit`: the limit of many (default 2)"),
        Flag("--keep-matrix", help="trust the sensor's calibration matrix"),
        Flag("--keep-zero", help="trust the sensor's zero in POSES"),
        Flag("--check", "LOG", log_file, "a second log, to predict"),
        Flag("--rezero", help="the sensor was zeroed anew for --check"),
    )),
    "structure": (structure, (
        Flag("FILE", many=True,
             help="one file with mass and stiffness (.npz, .pch, .dmig, .bdf, .op4, .full), or"
             " M=FILE K=FILE and perhaps D=FILE (.npy, .npz, .mtx, .matrix, .sti, .mas, .op4)"),
        Flag("--interface", "NODE", read(_interface, "a node or six freedoms"),
             "number of the node where the arm stands, or its six freedoms counted from 0:"
             " A,B,C,D,E,F", required=True),
        Flag("--units", "U", text, ", ".join(UNITS), required=True),
        Flag("--modes", "N", word_or("auto", integer(), "a whole number >= 0 or auto"),
             f"internal modes to keep, or auto: frequencies with the arm below {BAND:g} Hz"
             f" within {100 * ERROR:g} % (default)"),
        Flag("--damping", "R", number(), "damping ratio of every mode (default: the files' D)"),
        Flag("--rigid-modes", "N", integer(),
             "motions without strain: 0 clamped (default), 6 free"),
        Flag("--held", "A,B,...", integers,
             "freedoms that do not move, where the files have them"),
        Flag("--names", "M=A,K=B", read(_names, "like M=MXX,K=KXX"),
             "names of the matrices in the files, where they differ"),
        Flag("--line", "NODE:X,Y,Z", read(_point, "like 2:0,0,-4 3:0,0,-2"),
             "nodes to draw the structure by, from the interface [m], in order", to="points",
             row=True),
        Flag("--diameter", "M", number("m"), "of the drawn members [m]"),
        *arm_flags("puma560"),
        Flag("--save", "FILE", file_to_write,
             "the vehicle, .toml or .json (default OUT/vehicle.toml)"),
        *PICTURES,
    )),
}  # fmt: skip
