"""The built-in controllers by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.controllers import FOLLOW, Controller
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS

_SEED = object()  # stands for the seed among the arguments of a class


def _of(where: str, *arguments: Any) -> Callable[[int], Controller]:
    """Return a maker that loads planners and engines only where its controller is asked for.

    Args:
        where: module of this folder and class, such as damping:TunedGains.
        arguments: of the class.
    """
    module, _, name = where.partition(":")

    def make(seed: int) -> Controller:
        cls = getattr(import_module(f"ves_gym.baselines.{module}"), name)
        made: Controller = cls(*(seed if k is _SEED else k for k in arguments))
        return made

    return make


def _planned(planner: str, name: str = "") -> Callable[[int], Controller]:
    return _of("controllers:Follow", name or planner, planner, _SEED)


CONTROLLERS: dict[str, Callable[[int], Controller]] = {  # name -> from a seed
    "zero": _of("controllers:Zero"),
    "random": _of("controllers:Random", _SEED),
    "hold": _of("controllers:Hold"),
    "high": _of("controllers:Hold", "high", HIGH_GAINS),
    "pped": _of("controllers:Hold", "pped", PPED_GAINS),
    "straight": _planned("straight"),
    "hotspot": _planned("hotspot-qt", "hotspot"),
    "direct": _planned("direct"),
    "refined": _planned("refined"),
    "robust": _planned("robust"),
    "adaptive": _of("adaptive:Adaptive", _SEED),
    "mppi": _of("mppi:Mppi", _SEED),
    "ilqr": _of("ilqr:Ilqr"),
    "lqr": _of("controllers:Optimal"),
    "lqi": _of("regulator:Regulator"),
    "tuned": _of("damping:TunedGains", _SEED),
    "receding": _of("damping:Receding", _SEED),
    "resolved": _of("resolved:Resolved"),
    "resolved-gentle": _of("resolved:Resolved", "resolved-gentle", 16.0),
    "compensating": _of("compensating:Compensating"),
    "closing": _of("closing:Closing"),
    "closing-pose": _of("closing:ClosingPose"),
    "braced": _of("resolved:Resolved", "braced", FOLLOW, True),
    "resolved-pose": _of("resolved:ResolvedPose"),
    "servicer": _of("servicer:Servicer"),
}

# Of each task: what solves it, 95 % of the episodes and more
# (tests/envs/test_success.py). It reads the true state and knows the nominal machine.
REFERENCES = {
    "PumaRestToRest": "direct",
    "PumaReach": "resolved",
    "PumaReachGoal": "resolved",
    "PumaTrack": "resolved",
    "PumaDamp": "lqi",
    "BeamLQR": "lqr",
    "FreeFlyerReach": "resolved",
    "DualArmReach": "compensating",
    "MacroMicro": "resolved",
    "PoseReach": "resolved-pose",
    "PayloadTransfer": "resolved",
    "ServicerCapture": "servicer",
    "BerthingContact": "resolved",
}


def get_controller(name: str, seed: int = 0) -> Controller:
    """Return a built-in controller.

    Args:
        name: one of `CONTROLLERS`.
        seed: of controllers that draw or plan.

    Raises:
        ParameterError: unknown name.
    """
    if name not in CONTROLLERS:
        raise ParameterError(
            f"controller must be one of {', '.join(CONTROLLERS)}, got {name!r}"
            f"{did_you_mean(name, CONTROLLERS)}"
        )
    return CONTROLLERS[name](seed)
