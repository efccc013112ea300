"""A recorded run as one HTML file that plays it: arm, beam or platform, and energy."""

from __future__ import annotations

import os

from ves_gym._util.params import write_text
from ves_gym.planners.scenes import log_scene
from ves_gym.report.pages import escaped, page, part
from ves_gym.system.energy import system_of
from ves_gym.system.runlog import RunLog

_SCRIPTS = "dom drawing scene platform player player_page"  # in this order


def can_play(log: RunLog) -> bool:
    """Return True if the page shows all that moves: one rigid arm, and no payload."""
    arm = system_of(log).arm
    return not arm.bends and len(arm.roots) == 1 and log.p is None


def write_player(log: RunLog, path: str | os.PathLike[str], name: str) -> None:
    """Write a page that plays a run, completely or not at all."""
    text = page(
        "report/player.html",
        title=f"ves-gym view: {name}",
        scripts=[f"report/{script}.js" for script in _SCRIPTS.split()],
        data={"scenes": [log_scene(name, log)]},
        machine=escaped(repr(system_of(log)).strip("<>").removeprefix("System: ")),
        name=escaped(name),
        scene_controls=part("report/scene_controls.html"),
    )
    write_text(path, text)
