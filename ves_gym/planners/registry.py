"""Planners by name, each imported on first use."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Mapping
from importlib import import_module
from typing import Any, TypeVar, cast

from ves_gym._util.own import CALLED, own_object, require_free, require_interface
from ves_gym._util.params import ParameterError, require_one_of
from ves_gym.planners.bounds import parse_bounds
from ves_gym.planners.query import Planner

P = TypeVar("P", bound=Planner | type[Planner])

# name -> "module:class" below this package, and its settings
_HOMES: dict[str, tuple[str, dict[str, Any]]] = {
    "straight": ("shaping:Straight", {}),
    "smooth-jerk": ("shaping:SmoothJerk", {}),
    "shaped-zv": ("shaping:Shaped", {"kind": "zv"}),
    "shaped-zvd": ("shaping:Shaped", {"kind": "zvd"}),
    "bad-path": ("hotspot:BadPath", {}),
    "hotspot-q": ("hotspot:HotSpot", {"band_limited": False}),
    "hotspot-qt": ("hotspot:HotSpot", {"band_limited": True}),
    "reaction-null": ("reaction_null:ReactionNull", {}),
    "ompl-q": ("ompl_search:Ompl", {"objective": "q"}),
    "ompl-qt": ("ompl_search:Ompl", {"objective": "qt"}),
    "ompl-time": ("ompl_search:Ompl", {"objective": "time"}),
    "calm": ("calm:Calm", {}),
    "direct": ("direct:Direct", {}),
    "damp": ("direct:DampRelease", {}),
    "refined": ("refine:Refined", {}),
    # what is best known comes from it
    "refined-long": ("refine:Refined", {"free": 32, "starts": 24, "name": "refined-long"}),
    "robust": ("robust:Robust", {}),
    "robust-worst": ("robust:Robust", {"objective": "worst", "name": "robust-worst"}),
}
DEFAULT = "calm"


class _Planners(UserDict[str, Any]):
    """Planners by name, those of `_HOMES` made on first use."""

    def __getitem__(self, name: str) -> Planner:
        planner = self.data[name]
        if isinstance(planner, tuple):
            home, settings = planner
            module, kind = home.split(":")
            cls = getattr(import_module(f"ves_gym.planners.{module}"), kind)
            planner = self.data[name] = cls(**settings)
        return cast(Planner, planner)


PLANNERS = _Planners(_HOMES)


def register_planner(planner: P) -> P:
    """File a planner under its name; a name already taken is an error.

    Args:
        planner: a `Planner`, or a class of planners that needs no arguments (so that this
            function also decorates one).
    """
    instance: Any = planner() if isinstance(planner, type) else planner
    require_interface("planner", instance, ("name", "summary"), find=("query", "seed"))
    taken = type(PLANNERS[instance.name]) if instance.name in PLANNERS else None
    require_free(instance.name, "planner", type(instance), taken)
    PLANNERS[instance.name] = instance
    return planner


def get_planner(name: str) -> Planner:
    """A planner by name; unknown names are an error that lists the known ones.

    Args:
        name: of the registry, with bounds on disturbance measures after a colon where the
            planner takes them: `calm:acceleration_peak=0.5+tip_peak=0.1`.
    """
    plain, colon, text = name.partition(":") if isinstance(name, str) else (name, "", "")
    require_one_of("planner", plain, PLANNERS)
    return bounded(PLANNERS[plain], parse_bounds(text)) if colon else PLANNERS[plain]


def own_planner(text: str) -> Planner:
    """Return the planner that a word of the command line names.

    Args:
        text: what `get_planner` takes, the name of an installed package's entry point, or
            `module:Class`. The module is imported: no word of a file comes here. The planner
            has its name from then on, in processes begun later, too.

    Raises:
        ParameterError: no such planner, or what is there is none.
    """
    planner = own_object(text, PLANNERS, "planners")
    if isinstance(planner, str):
        return get_planner(planner)
    if type(PLANNERS.data.get(str(getattr(planner, "name", "")))) is not type(planner):
        register_planner(planner)  # which the module may have done itself
    CALLED.append((own_planner, text))
    return get_planner(planner.name)


def bounded(planner: Planner, bounds: Mapping[str, float]) -> Planner:
    """Return a planner that keeps bounds on measures, see `planners.bounds`."""
    if not hasattr(planner, "bounded"):
        raise ParameterError(f"bounds are for planner calm, got {planner.name}")
    return cast(Planner, planner.bounded(bounds))
