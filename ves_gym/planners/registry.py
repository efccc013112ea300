"""Planners by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.planners.bad_path import BadPath
from ves_gym.planners.damp import DampRelease
from ves_gym.planners.direct import Direct
from ves_gym.planners.hotspot import HotSpot
from ves_gym.planners.objective import parse_weights
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
    """A planner by name; unknown names are an error that lists the known ones.

    Args:
        name: of the registry, with weights of disturbance measures after a colon where the
            planner takes them: `refined:acceleration_peak=0.03+tip=0.1`.
    """
    plain, colon, text = name.partition(":") if isinstance(name, str) else (name, "", "")
    if plain not in PLANNERS:
        raise ParameterError(
            f"planner must be one of {', '.join(PLANNERS)}, got {plain!r}"
            f"{did_you_mean(plain, PLANNERS)}"
        )
    return weighted(PLANNERS[plain], parse_weights(text)) if colon else PLANNERS[plain]


def weighted(planner: Planner, weights: Mapping[str, float]) -> Planner:
    """Return a planner that also minimises disturbance measures.

    Args:
        planner: one that takes weights, such as `refined`.
        weights: by the names of `planners.objective.WEIGHTS`.

    Raises:
        ParameterError: it takes none, or a weight that is none.
    """
    if not isinstance(planner, Direct | Refined):
        able = ", ".join(k for k, p in PLANNERS.items() if isinstance(p, Direct | Refined))
        raise ParameterError(f"weights are for planners {able}, got {planner.name}")
    return planner.weighted(weights)
