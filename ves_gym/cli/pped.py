"""`ves-gym pped`: joint gains that take vibration out of the base, beside the thesis's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.cli.files import PICTURES
from ves_gym.cli.flags import Answer, Flag, floats, integer, joints, one_of, pose, read
from ves_gym.cli.machine import MACHINE
from ves_gym.damping.gain_comparison import BOTH, compare_gains
from ves_gym.damping.tuning import OBJECTIVES, Bounds
from ves_gym.planners.case import Case


def _bounds(value: str) -> Bounds:
    low_K, high_K, low_B, high_B = floats(value)
    return Bounds(K=(low_K, high_K), B=(low_B, high_B))


FLAGS = (
    Flag("--q", "A,B,C", joints, "joint angles [deg] (default 45,0,0)"),
    Flag("--objective", "O", one_of(*OBJECTIVES, "both"),
         "strain: integral of strain energy; worst: the same, worst displacement; estimator:"
         " thesis eq. 4.4; both: strain and estimator (both)"),
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
)  # fmt: skip


def run(
    case: Case,
    *,
    q: Array | None = None,
    objective: str = "both",
    map: bool = False,
    points: int = 11,
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Search, compare, simulate, draw."""
    arm = case.system.arm
    if q is None:
        usual = np.deg2rad([45.0, 0.0, 0.0]) if arm.n == 3 and not arm.sliding else 0.0
        q = np.clip(usual, arm.column("q_min"), arm.column("q_max"))
    comparison = compare_gains(
        case.system,
        q,
        objectives=BOTH if objective == "both" else (objective,),
        points=points if map else None,
        seed=case.seed,
        progress=progress,
        **how,
    )

    def figures() -> dict[Path, Any]:
        from ves_gym.report.damping import damping_figures

        folder = out or Path("out/pped")
        return {folder / f"pped_{k}": v for k, v in damping_figures(comparison).items()}

    return Answer(text=comparison, plain=comparison.to_dict(), figures=figures)
