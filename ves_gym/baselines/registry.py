"""The built-in controllers by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from ves_gym._util.params import require_one_of
from ves_gym.baselines.controllers import FOLLOW, Controller
from ves_gym.envs.registration import IDS
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS

_SEED = object()  # stands for the seed among the arguments of a class


class ControllerEntry(NamedTuple):
    """A controller of the package; its module is loaded where it is made."""

    tasks: tuple[str, ...]  # that it plays, through their own control or one that it asks for
    summary: str
    where: str  # module of this folder and class
    arguments: tuple[Any, ...] = ()  # of the class

    def make(self, seed: int) -> Controller:
        """Return the controller."""
        module, _, name = self.where.partition(":")
        cls = getattr(import_module(f"ves_gym.baselines.{module}"), name)
        controller: Controller = cls(*(seed if k is _SEED else k for k in self.arguments))
        return controller


_ALL, _REST, _DAMP = tuple(IDS), ("PumaRestToRest",), ("PumaDamp", "BeamLQR")
_PLACES = ("PumaReach", "PumaReachGoal", "PumaTrack")
_LED = (*_PLACES, "MacroMicro", "FreeFlyerReach", "PayloadTransfer", "DualArmReach",
        "BerthingContact")  # fmt: skip
_HOLD, _FOLLOW, _RESOLVED = "controllers:Hold", "controllers:Follow", "resolved:Resolved"
_ROWS: dict[str, tuple[Any, ...]] = {
    "zero": (_ALL, "acts with zeros", "controllers:Zero"),
    "random": (_ALL, "draws uniform actions", "controllers:Random", (_SEED,)),
    "hold": (_ALL[1:], "holds the joints by the control's own gains", _HOLD),
    "high": (_DAMP, "holds the joints by high gains", _HOLD, ("high", HIGH_GAINS)),
    "pped": (_DAMP, "holds the joints by gains that damp the base", _HOLD,
             ("pped", PPED_GAINS)),
    "straight": (_REST, "follows the straight line between the ends", _FOLLOW,
                 ("straight", "straight", _SEED)),
    "hotspot": (_REST, "follows a plan through hot spots of the coupling", _FOLLOW,
                ("hotspot", "hotspot-qt", _SEED)),
    "direct": (_REST, "follows a plan of least energy to the base", _FOLLOW,
               ("direct", "direct", _SEED)),
    "refined": (_REST, "follows a plan of least energy, torques considered", _FOLLOW,
                ("refined", "refined", _SEED)),
    "robust": (_REST, "follows a plan made for a spread of machines", _FOLLOW,
               ("robust", "robust", _SEED)),
    "adaptive": (_REST, "identifies payload and friction on the way, and plans anew",
                 "adaptive:Adaptive", (_SEED,)),
    "oracle": (_REST, "follows a plan for the machine as drawn, which it knows: a bound",
               "adaptive:Oracle", (_SEED,)),
    "mppi": (_REST, "samples futures on a model as it moves (MPPI)", "mppi:Mppi", (_SEED,)),
    "lqr": (_DAMP[1:], "applies the exact optimum (LQR)", "controllers:Optimal"),
    "lqi": (_DAMP, "regulates base and joints, with an observer (LQI)",
            "regulator:Regulator"),
    "tuned": (_DAMP[:1], "holds the joints by gains tuned to the episode's displacement",
              "damping:TunedGains", (_SEED,)),
    "receding": (_DAMP[:1], "plans a damping motion anew every quarter of a second",
                 "damping:Receding", (_SEED,)),
    "resolved": (_LED, "leads the tool in space, the base's motion taken back", _RESOLVED),
    "resolved-gentle": (_LED, "does what resolved does, more softly", _RESOLVED,
                        ("resolved-gentle", 16.0)),
    "braced": (_LED, "does what resolved does, braced against the base", _RESOLVED,
               ("braced", FOLLOW, True)),
    "compensating": (("DualArmReach",), "moves the other arms so that the base rests",
                     "compensating:Compensating"),
    "closing": (_PLACES, "closes in on a place, a function of the observation",
                "closing:Closing"),
    "closing-pose": (("PoseReach",), "closes in on a pose, a function of the observation",
                     "closing:ClosingPose"),
    "resolved-pose": (("PoseReach",), "leads the tool to a pose in space",
                      "resolved:ResolvedPose"),
    "servicer": (("ServicerCapture",), "meets the fixture, then stops the tumble",
                 "servicer:Servicer"),
}  # fmt: skip
CONTROLLERS = {name: ControllerEntry(*row) for name, row in _ROWS.items()}

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
    require_one_of("controller", name, CONTROLLERS)
    return CONTROLLERS[name].make(seed)
