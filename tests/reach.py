"""Questions of reach100, asked by duration."""

from __future__ import annotations

from typing import Any

from ves_gym.planners.query import Query
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System


def reach(
    duration: float,
    count: int,
    vehicle: str = "bent-thesis",
    system: System | None = None,
    **options: Any,
) -> list[Query]:
    """The first questions of a duration [s]; options are those of `get_suite`."""
    suite = get_suite("reach100", system=system or System(), vehicle=vehicle, **options)
    return [query for _, query in suite.queries if query.duration == duration][:count]
