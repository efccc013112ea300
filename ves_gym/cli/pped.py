"""`ves-gym pped`: joint gains that take vibration out of the base, beside the thesis's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.files import FORMAT, NO_FIGURES
from ves_gym.cli.flags import Answer, Flag, Place, joints, one_of, pose, whole
from ves_gym.cli.machine import MACHINE
from ves_gym.damping.gain_comparison import BOTH, GainComparison, compare_gains
from ves_gym.damping.tuning import OBJECTIVES, Bounds
from ves_gym.planners.case import Case


def _bounds(value: str, place: Place) -> Bounds:
    try:
        low_K, high_K, low_B, high_B = (float(k) for k in value.split(","))
    except ValueError:
        raise ParameterError(
            f"{place.name} must be four numbers, least and largest K and B, like"
            f" 1,1e4,0.1,1e3, got {value!r}"
        ) from None
    return Bounds(K=(low_K, high_K), B=(low_B, high_B))


FLAGS = (
    Flag("--q", "A,B,C", joints, "joint angles [deg] (default 45,0,0)"),
    Flag("--objective", "O", one_of(*OBJECTIVES, "both"),
         "strain: integral of strain energy; worst: the same, worst displacement; estimator:"
         " thesis eq. 4.4; both: strain and estimator (both)"),
    Flag("--full", help="full symmetric gain matrices as well"),
    Flag("--bounds", "K,K,B,B", _bounds,
         "least and largest K [N m/rad] and B [N m s/rad] (1,10000,0.1,1000)"),
    Flag("--disturb", "Y", pose,
         "displacement let go: x,y,z [m] and angles [deg] (0.1,0.1,0.1,0,0,0)", to="y"),
    Flag("--map", help="also look for the best configuration"),
    Flag("--points", "N", whole(2, 101), "of a map, per axis (11)"),
    NO_FIGURES,
    FORMAT,
    *MACHINE,
)  # fmt: skip


def run(
    case: Case,
    *,
    q: Array | None = None,
    objective: str = "both",
    map: bool = False,
    points: int = 11,
    no_figures: bool = False,
    format: str = "png",
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Search, compare, simulate, draw."""
    arm = case.system.arm
    if q is None:
        usual = np.deg2rad([45.0, 0.0, 0.0]) if arm.n == 3 and not arm.sliding else 0.0
        q = np.clip(usual, arm.column("q_min"), arm.column("q_max"))
    found = compare_gains(
        case.system,
        q,
        objectives=BOTH if objective == "both" else (objective,),
        points=points if map else None,
        seed=case.seed,
        progress=progress,
        **how,
    )
    files: list[Path] = []
    said = [str(found)]
    if not no_figures and (sentence := lacking("drawing", "matplotlib")):
        said.append(f"no pictures: {sentence}")
    elif not no_figures:
        files = _figures(found, out or Path("out/pped"), format)
    return Answer(text="\n".join(said), plain=found.to_dict(), files=files)


def _figures(found: GainComparison, folder: Path, format: str) -> list[Path]:
    from ves_gym.report.damping import map_figure, pole_figure, response_figure
    from ves_gym.report.figures import write_figure
    from ves_gym.simulation.stability import poles_in_space

    locked = poles_in_space(found.plant.mass, *found.system.base.full()[1:])
    names = [row.name for row in found.rows]
    figures = {
        "poles": pole_figure([(row.name, row.damping.poles) for row in found.rows], locked),
        "responses": response_figure(names, found.linear, found.simulated),
    }
    if found.maps:
        figures["configurations"] = map_figure(found.maps)
    paths = [folder / f"pped_{name}.{format}" for name in figures]
    for figure, path in zip(figures.values(), paths, strict=True):
        write_figure(figure, path)
    return paths
