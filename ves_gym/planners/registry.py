"""Planners by name."""

from __future__ import annotations

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.planners.direct import Direct
from ves_gym.planners.hotspot import BadPath, HotSpot
from ves_gym.planners.ompl_search import OBJECTIVES, Ompl
from ves_gym.planners.query import Planner
from ves_gym.planners.reaction_null import ReactionNull
from ves_gym.planners.refine import Refined
from ves_gym.planners.shaping import SHAPERS, Shaped, SmoothJerk
from ves_gym.planners.straight import Straight

_ALL: list[Planner] = [
    Straight(),
    SmoothJerk(),
    *(Shaped(kind) for kind in SHAPERS),
    BadPath(),
    HotSpot(band_limited=False),
    HotSpot(band_limited=True),
    ReactionNull(),
    *(Ompl(objective=objective) for objective in OBJECTIVES),
    Direct(),
    Refined(),
    Refined(free=32, starts=24, name="refined-long"),  # what is best known comes from it
]
PLANNERS: dict[str, Planner] = {planner.name: planner for planner in _ALL}


def get_planner(name: str) -> Planner:
    """A planner by name; unknown names are an error that lists the known ones."""
    if name not in PLANNERS:
        raise ParameterError(
            f"planner must be one of {', '.join(PLANNERS)}, got {name!r}"
            f"{did_you_mean(name, PLANNERS)}"
        )
    return PLANNERS[name]
