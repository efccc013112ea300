"""Planners by name."""

from __future__ import annotations

from typing import Any, TypeVar

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.planners.bad_path import BadPath
from ves_gym.planners.damp import DampRelease
from ves_gym.planners.direct import Direct
from ves_gym.planners.hotspot import HotSpot
from ves_gym.planners.ompl_search import OBJECTIVES, Ompl
from ves_gym.planners.query import Planner
from ves_gym.planners.reaction_null import ReactionNull
from ves_gym.planners.refine import Refined
from ves_gym.planners.robust import Robust
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
    DampRelease(),
    Refined(),
    Refined(free=32, starts=24, name="refined-long"),  # what is best known comes from it
    Robust(),
    Robust(objective="worst", name="robust-worst"),
]
P = TypeVar("P", bound=Planner | type[Planner])
PLANNERS: dict[str, Planner] = {planner.name: planner for planner in _ALL}


def register_planner(planner: P) -> P:
    """File a planner under its name; a name already taken is an error.

    Args:
        planner: a `Planner`, or a class of planners that needs no arguments (so that this
            function also decorates one).

    Returns:
        The planner or class.

    Raises:
        ParameterError: the name is taken, or something of a `Planner` is missing.
    """
    instance: Any = planner() if isinstance(planner, type) else planner
    for part in ("name", "summary", "find"):
        value = getattr(instance, part, None)
        if not (callable(value) if part == "find" else isinstance(value, str)):
            raise ParameterError(
                "a planner needs name, summary and find(query, seed),"
                f" got {instance!r} without {part}"
            )
    if instance.name in PLANNERS:
        raise ParameterError(
            f"planner {instance.name!r} is already registered by"
            f" {type(PLANNERS[instance.name]).__name__}"
        )
    PLANNERS[instance.name] = instance
    return planner


def get_planner(name: str) -> Planner:
    """A planner by name; unknown names are an error that lists the known ones."""
    if name not in PLANNERS:
        raise ParameterError(
            f"planner must be one of {', '.join(PLANNERS)}, got {name!r}"
            f"{did_you_mean(name, PLANNERS)}"
        )
    return PLANNERS[name]
