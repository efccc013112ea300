"""Questions of reach100, asked by duration, and one that a pillar stands in the way of."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.planners.obstacles import Box, Surroundings
from ves_gym.planners.query import Query
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System

# Of the PUMA: joint speeds [rad/s], and +- of each joint [rad].
SPEED_LIMITS = tuple(np.deg2rad([82.0, 54.0, 122.0]).tolist())
REACH_RANGE = np.deg2rad([120.0, 60.0, 120.0])

# from one side to the other past a pillar that the straight line runs into
ACROSS = Query(
    system=System(vehicle=BENT_THESIS),
    start=(-1.0, 0.1, 0.2),
    goal=(1.0, 0.1, 0.2),
    duration=4.0,
    v_max=SPEED_LIMITS,
    surroundings=Surroundings(obstacles=(Box(centre=(0.75, 0.0, 0.7), size=(0.2, 0.2, 0.8)),)),
)


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
