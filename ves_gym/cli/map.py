"""`ves-gym map`: coupling-map arrays and the picture of thesis figure 4-1."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym._util.params import Array
from ves_gym.cli.files import FORMAT
from ves_gym.cli.flags import Answer, Flag, integer, integers, joints, number, one_of, word_or
from ves_gym.cli.machine import MACHINE
from ves_gym.mechanics.vehicle import vehicle_name
from ves_gym.planners.case import Case
from ves_gym.planners.coupling_map import OTHERS
from ves_gym.planners.scenes import map_data

SCHEMA = "ves-map/1"
FLAGS = (
    Flag("--joints", "I,J", word_or("all", integers, "whole numbers like 1,2, or all"),
         "two joints to sweep, or all pairs (all)", to="pair"),
    Flag("--at", "A,B,C", joints,
         "all joints; of the two swept it is not used [deg] (0,0,0)"),
    Flag("--others", "O", one_of(*OTHERS),
         f"{', '.join(OTHERS)}: the other joints as --at gives them, or at every point where"
         " the two couple least or most (given)"),
    Flag("--duration", "T", word_or("raw", number("s", above=0), "raw or seconds > 0"),
         "of the motions meant, for Q_T [s]; raw: Q of the thesis (raw)"),
    Flag("--points", "N", integer(4, 1001), "per axis (61)"),
    FORMAT,
    *MACHINE,
)  # fmt: skip


def run(
    case: Case,
    *,
    pair: tuple[int, int] | None = None,
    at: Array | None = None,
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Sweep, write arrays and pictures."""
    system, folder = case.system, out or Path("out/map")
    if at is not None:
        how |= {f"q{k + 1}": value for k, value in enumerate(at)}
    every = list(itertools.combinations(range(1, system.arm.n + 1), 2))
    pairs = every if pair is None else [pair]
    maps, files = [], []
    for k, swept in enumerate(pairs):
        maps.append(vg.coupling_map(system, joints=swept, **how))
        progress((k + 1) / len(pairs))
    for section in maps:
        i, j = (k + 1 for k in section.joints)
        files.append(folder / f"map_q{i}_q{j}.npz")
        section.save(files[-1])

    def figures() -> dict[Path, Any]:
        from ves_gym.report.figures import coupling_figure

        vehicle = vehicle_name(system.vehicle)
        data = [map_data(vehicle, section, []) for section in maps]
        return {folder / "map": coupling_figure(data, [])}

    plain = {
        "schema": SCHEMA,
        "system": system.hash,
        "duration": maps[0].duration,
        "at": maps[0].fixed.tolist(),
        "others": maps[0].others,
        "maps": [section.to_dict() for section in maps],
    }
    return Answer(text="\n".join(map(str, maps)), plain=plain, files=files, figures=figures)
