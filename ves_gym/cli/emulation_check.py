"""`ves-gym emulation-check`: is an emulation stable, and how true is it, before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.files import PICTURES
from ves_gym.cli.flags import Answer, Flag, joints
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.simulate import GAINS
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.case import Case

MODE = "emulated"
FLAGS = (
    Flag("--at", "A,B,C", joints, "joint angles [deg] (default 0,0,0)"),
    GAINS,
    Flag("--no-search", help="do not look for the largest bandwidth"),
    *PICTURES,
    *MACHINE,
)


def run(
    case: Case,
    *,
    at: Array | None = None,
    gains: JointServo | None = None,
    no_search: bool = False,
    out: Path | None = None,
    progress: Any = None,
) -> Answer:
    """Judge the emulation; negative if it is unstable."""
    system = case.system
    if system.mode != MODE:
        raise ParameterError(f"emulation-check is about --mode {MODE}, got {system.mode}")
    q = system.arm.home if at is None else at
    servo = case.servo if gains is None else gains
    progress(0.0, "linearising the loop")
    check = vg.check_emulation(system, q, servo=servo, search=not no_search)

    def figures() -> dict[Path, Any]:
        from ves_gym.report.machine_figures import emulation_figures

        folder = out or Path("out/emulation-check")
        drawn = emulation_figures(system, q, servo)
        return {folder / name: figure for name, figure in drawn.items()}

    return Answer(text=check, plain=check.to_dict(), figures=figures, negative=not check.stable)
