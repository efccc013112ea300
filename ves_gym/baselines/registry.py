"""The built-in controllers by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.closing import Closing, ClosingPose, Homing
from ves_gym.baselines.controllers import Controller, Follow, Hold, Optimal, Random, Zero
from ves_gym.baselines.mppi import Mppi
from ves_gym.baselines.regulator import Regulator
from ves_gym.baselines.resolved import Resolved
from ves_gym.baselines.resolved_pose import ResolvedPose
from ves_gym.baselines.servicer import Servicer
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS


def _late(where: str) -> Callable[[int], Controller]:
    """Return a maker that loads planners and engines only where its controller is asked for.

    Args:
        where: module of this folder and class, such as damping:TunedGains.
    """
    module, _, name = where.partition(":")

    def make(seed: int) -> Controller:
        controller: Controller = getattr(import_module(f"ves_gym.baselines.{module}"), name)(
            seed
        )
        return controller

    return make


CONTROLLERS: dict[str, Callable[[int], Controller]] = {  # name -> from a seed
    "zero": lambda seed: Zero(),
    "random": Random,
    "hold": lambda seed: Hold(),
    "high": lambda seed: Hold("high", HIGH_GAINS),
    "pped": lambda seed: Hold("pped", PPED_GAINS),
    "straight": lambda seed: Follow("straight", "straight", seed),
    "hotspot": lambda seed: Follow("hotspot", "hotspot-qt", seed),
    "direct": lambda seed: Follow("direct", "direct", seed),
    "refined": lambda seed: Follow("refined", "refined", seed),
    "robust": lambda seed: Follow("robust", "robust", seed),
    "adaptive": _late("adaptive:Adaptive"),
    "mppi": Mppi,
    "ilqr": _late("ilqr:Ilqr"),
    "lqr": lambda seed: Optimal(),
    "lqi": lambda seed: Regulator(),
    "tuned": _late("damping:TunedGains"),
    "receding": _late("damping:Receding"),
    "resolved": lambda seed: Resolved(),
    "resolved-gentle": lambda seed: Resolved("resolved-gentle", 16.0),
    "homing": lambda seed: Homing(),
    "closing": lambda seed: Closing(),
    "closing-pose": lambda seed: ClosingPose(),
    "braced": lambda seed: Resolved("braced", braced=True),
    "resolved-pose": lambda seed: ResolvedPose(),
    "servicer": lambda seed: Servicer(),
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
    "MacroMicro": "resolved",
    "PoseReach": "resolved-pose",
    "PayloadTransfer": "resolved",
    "ServicerCapture": "servicer",
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
