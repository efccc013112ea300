"""`ves-gym emulation-check`: is an emulation stable, and how true is it, before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import ves_gym.api as vg
from ves_gym._util.optional import lacking
from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.files import FORMAT, NO_FIGURES
from ves_gym.cli.flags import Answer, Flag, joints
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.simulate import GAINS
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo
from ves_gym.mechanics.servo import JointServo
from ves_gym.planners.case import Case

MODE = "emulated"
FLAGS = (
    Flag("--at", "A,B,C", joints, "joint angles [deg] (default 0,0,0)"),
    GAINS,
    Flag("--no-search", help="do not look for the largest bandwidth"),
    NO_FIGURES,
    FORMAT,
    *MACHINE,
)


def run(
    case: Case,
    *,
    at: Array | None = None,
    gains: JointServo | None = None,
    no_search: bool = False,
    no_figures: bool = False,
    format: str = "png",
    out: Path | None = None,
    progress: Any = None,
) -> Answer:
    """Judge the emulation; negative if it is unstable."""
    system, arm = case.system, case.system.arm
    if system.mode != MODE:
        raise ParameterError(f"emulation-check is about --mode {MODE}, got {system.mode}")
    q = np.clip(0.0, arm.column("q_min"), arm.column("q_max")) if at is None else at
    servo = case.servo if gains is None else gains
    progress(0.0, "linearising the loop")
    check = vg.check_emulation(system, q, servo=servo, search=not no_search)
    files: list[Path] = []
    said = [str(check)]
    if not no_figures and (sentence := lacking("drawing", "matplotlib")):
        said.append(f"no pictures: {sentence}")
    elif not no_figures:
        from ves_gym.report.legs import write_leg_figures
        from ves_gym.report.loop import write_loop_figures

        folder = out or Path("out/emulation-check")
        folder.mkdir(parents=True, exist_ok=True)
        files = write_loop_figures(folder, system, q, servo, format)
        platform = system.emulator_settings.platform
        if isinstance(platform, LegServo):
            servos = dict(LEG_SERVOS)
            if platform not in servos.values():
                servos["this one"] = platform
            files += write_leg_figures(folder, servos, format)
    return Answer(
        text="\n".join(said), plain=check.to_dict(), files=files, negative=not check.stable
    )
