"""`ves-gym studio`: one HTML page in which a path is drawn and the base's energy follows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ves_gym.cli.flags import Answer, Flag, joints, text
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.simulate import DURATION, GOAL, START
from ves_gym.planners.case import Case
from ves_gym.planners.registry import PLANNERS
from ves_gym.report.notebook import Studio

FLAGS = (
    START,
    GOAL,
    Flag("--via", "A,B,C", joints,
         "way-point of the drawn path [deg], repeatable (default: one calm detour)", many=True),
    DURATION,
    Flag("--planner", "P", text,
         f"whose path is there to compare with: {', '.join(PLANNERS)}, or none (direct)"),
    Flag("--open", "FILE", text,
         "show it in the page, repeatable: a run log or episode (.parquet, .csv), a case,"
         " diagnosis.json", to="show", many=True),
    *MACHINE,
)  # fmt: skip


def run(case: Case, *, planner: str = "direct", out: Path | None = None, **how: Any) -> Answer:
    """Write the page; --out is its folder, or its name if that ends in .html."""
    if case.query is not None:
        how = {name: getattr(case.query, name) for name in ("start", "goal", "duration")} | how
    studio = Studio(
        case.system, planner=None if planner == "none" else planner, seed=case.seed, **how
    )
    path = out or Path("out/studio")
    path = path if path.suffix == ".html" else path / "studio.html"
    studio.save(path)
    size = len(studio.page.encode()) / 1e6
    text = f"{size:.2f} MB; open it in any browser"
    return Answer(text=text, plain=studio.data, files=[path])
