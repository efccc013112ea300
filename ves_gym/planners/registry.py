"""Planners by name."""

from __future__ import annotations

from ves_gym.core.params import ParameterError
from ves_gym.planners.direct import Direct
from ves_gym.planners.hotspot import BadPath, HotSpot
from ves_gym.planners.query import Planner
from ves_gym.planners.straight import Straight

PLANNERS: dict[str, Planner] = {
    planner.name: planner
    for planner in (
        Straight(),
        BadPath(),
        HotSpot(band_limited=False),
        HotSpot(band_limited=True),
        Direct(),
    )
}


def get_planner(name: str) -> Planner:
    """A planner by name; unknown names are an error that lists the known ones."""
    if name not in PLANNERS:
        raise ParameterError(f"planner must be one of {', '.join(PLANNERS)}, got {name!r}")
    return PLANNERS[name]
