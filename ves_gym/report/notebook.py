"""Progress and the studio in a notebook: a bar that any verb's `progress` takes, and a page."""

from __future__ import annotations

import html
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy.typing as npt

from ves_gym._util.params import ParameterError, write_text
from ves_gym.mechanics.limits import usual_goal
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.query import Plan, Planner, Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.report.studio import low_energy_waypoints, playable, render_studio, studio_data
from ves_gym.report.studio_files import open_item
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

__all__ = ["Studio", "progress_bar"]  # what notebooks import

_DURATIONS = 0.5, 8.0  # s, ends of the page's slider


def progress_bar() -> Callable[..., None]:
    """Show a bar in the notebook's output, and return its callback; without IPython nothing is
    shown.

    The callback goes as `progress` of `evaluate`, `train`, `diagnose` and `render`: of what it
    is called with, the last number is the fraction done, and text is written beside the bar.
    """
    try:
        from IPython.display import HTML, display
    except ImportError:
        return lambda *arguments: None
    handle: Any = display(HTML(_bar(0.0, "")), display_id=True)

    def on_progress(*arguments: Any) -> None:
        done = [float(word) for word in arguments if isinstance(word, (int, float))]
        words = " ".join(word for word in arguments if isinstance(word, str))
        if handle is not None:  # None outside a notebook
            handle.update(HTML(_bar(done[-1] if done else 0.0, words)))

    return on_progress


def _bar(done: float, words: str) -> str:
    percent = round(100 * min(max(done, 0.0), 1.0))
    return f'<progress value="{percent}" max="100"></progress> {percent} % {html.escape(words)}'


class Studio:
    """The studio of an arm on its base: it shows itself in a notebook, or is saved as a page.

    In a notebook the page runs in a frame inside the cell, without server, network or widget
    library; start, goal and path are dragged there. `ves-gym studio` writes the same page.
    """

    def __init__(
        self,
        system: System | None = None,
        *,
        start: npt.ArrayLike | None = None,
        goal: npt.ArrayLike | None = None,
        via: Sequence[npt.ArrayLike] | None = None,
        duration: float = 3.0,
        planner: str | Planner | None = "direct",
        show: Sequence[str | os.PathLike[str] | RunLog | Plan | Motion] = (),
        height: int = 900,
        seed: int = 0,
    ) -> None:
        """Simulate what the page is compared with, plan, and read what it shall show.

        Args:
            system: arm and vehicle; default `System()`. In mode emulated the page draws the
                platform on its legs.
            start, goal: joint angles (n,) [rad] that the page begins with; default rest at
                zero, and a goal within the arm's limits.
            via: way-points (n,) of the drawn path [rad]; None: two that make it calm.
            duration: of the motion [s].
            planner: whose path is shown for comparison; None for none.
            show: files to open, as `ves-gym studio --open` takes them, or logs, plans, motions.
            height: of the frame in a notebook [px].
            seed: of a planner that searches.

        Raises:
            ParameterError: a machine that the page cannot simulate, angles outside the joints'
                range, a duration outside 0.5 to 8 s, or something that it cannot show.
        """
        system = System() if system is None else system
        space, arm = playable(system), system.arm
        low, high = _DURATIONS
        if not low <= duration <= high:
            raise ParameterError(
                f"the studio's duration must be from {low:g} to {high:g} s, got {duration!r}"
            )
        if not (isinstance(height, int) and height >= 100):
            raise ParameterError(f"height must be a whole number of px >= 100, got {height!r}")
        begin = arm.home if start is None else arm.require_within_limits(start, "start")
        if goal is None:
            end = usual_goal(arm, begin, duration)
        else:
            end = arm.require_within_limits(goal, "goal")
        first, last = (tuple(k.tolist()) for k in (begin, end))
        query = Query(system=system, start=first, goal=last, duration=duration)
        plans = []
        if planner is not None:
            method = get_planner(planner) if isinstance(planner, str) else planner
            plans = [solve(method, replace(query, system=space), seed)]
        if via is None:
            near = plans[0].motion if plans and plans[0].found else None
            points = low_energy_waypoints(query, near)
        else:
            points = [arm.require_within_limits(point, "via") for point in via]
        items = [open_item(item, system) for item in show]
        self.height = height
        self.data = studio_data(query, points, items, plans)

    @cached_property
    def page(self) -> str:
        """The text of the page."""
        return render_studio(self.data)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page, an HTML file, completely or not at all."""
        write_text(path, self.page)

    def __repr__(self) -> str:
        return f"<Studio: {self.data['machine']['name']}>"

    def _repr_html_(self) -> str:
        title = html.escape(repr(self).strip("<>"))
        return (
            f'<iframe title="{title}" srcdoc="{html.escape(self.page)}" style="width: 100%;'
            f" height: {self.height}px; box-sizing: border-box; border: 1px solid #8886;"
            ' border-radius: 6px"></iframe>'
        )
