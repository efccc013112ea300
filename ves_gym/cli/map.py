"""`ves-gym map`: coupling-map arrays and the picture of thesis figure 4-1."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.files import FORMAT
from ves_gym.cli.flags import Answer, Flag, Place, joints, number, one_of, whole, wholes
from ves_gym.cli.machine import MACHINE
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.planners.case import Case
from ves_gym.planners.coupling_map import OTHERS
from ves_gym.planners.scenes import map_data

SCHEMA = "ves-map/1"


def _pairs(value: str, place: Place) -> Any:
    return None if value == "all" else wholes(value, place)


def _duration(value: str, place: Place) -> float | None:
    try:
        return None if value == "raw" else float(number("s", above=0)(value, place))
    except ParameterError:
        raise ParameterError(
            f"{place.name} must be raw or seconds > 0, got {value!r}"
        ) from None


FLAGS = (
    Flag("--joints", "I,J", _pairs, "two joints to sweep, or all pairs (all)"),
    Flag("--at", "A,B,C", joints,
         "all joints; of the two swept it is not used [deg] (0,0,0)"),
    Flag("--others", "O", one_of(*OTHERS),
         f"{', '.join(OTHERS)}: the other joints as --at gives them, or at every point where"
         " the two couple least or most (given)"),
    Flag("--duration", "T", _duration,
         "of the motions meant, for Q_T [s]; raw: Q of the thesis (raw)"),
    Flag("--points", "N", whole(4, 1001), "per axis (61)"),
    FORMAT,
    *MACHINE,
)  # fmt: skip


def run(
    case: Case,
    *,
    joints: tuple[int, int] | None = None,
    at: Array | None = None,
    format: str = "png",
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Sweep, write arrays and pictures."""
    system = case.system
    fixed = {} if at is None else {f"q{k + 1}": value for k, value in enumerate(at)}
    every = itertools.combinations(range(1, system.arm.n + 1), 2)
    pairs = list(every) if joints is None else [joints]
    maps = []
    for k, pair in enumerate(pairs):
        maps.append(vg.coupling_map(system, joints=pair, **how, **fixed))
        progress((k + 1) / len(pairs))
    folder = out or Path("out/map")
    files = []
    for section in maps:
        i, j = (k + 1 for k in section.joints)
        files.append(folder / f"map_q{i}_q{j}.npz")
        section.save(files[-1])
    said = [str(section) for section in maps]
    if sentence := lacking("drawing", "matplotlib"):
        said.append(f"no picture: {sentence}")
    else:
        from ves_gym.report.figures import coupling_figure, write_figure

        vehicle = vehicle_name(system.vehicle)
        figure = coupling_figure([map_data(vehicle, section, []) for section in maps], [])
        files.append(folder / f"map.{format}")
        write_figure(figure, files[-1])
    plain = {
        "schema": SCHEMA,
        "system": system.hash,
        "duration": maps[0].duration,
        "at": maps[0].fixed.tolist(),
        "others": maps[0].others,
        "maps": [section.to_dict() for section in maps],
    }
    return Answer(text="\n".join(said), plain=plain, files=files)
