"""Ids of the environments, registered by `import ves_gym` and `gym.make("ves_gym:ves/...")`."""

from __future__ import annotations

import math
import warnings
from typing import Any

import gymnasium as gym

from ves_gym.envs.deadline import UNLIMITED, Deadline, with_deadline

# What the laboratory's ids add, by version. 0: noise and drift of the nominal budget, and a
# gravity estimate that is wrong by up to half a percent, another one in every episode (thesis
# 3.2.2; `build.V0_RANGES`, which would load the laboratory). 1: what a calibration leaves.
_LABORATORY: dict[int, dict[str, Any]] = {
    0: {
        "mode": "emulated",
        "effects": "laboratory",
        "randomize": {"gravity/scale": {"error": [-0.005, 0.005]}},
    },
    1: {"mode": "emulated", "laboratory": "lab"},
}

# What the ids of version 0 stand on: the thesis's condensed beam. Later ones have that of
# `Task`, the same beam by finite elements. As a whole system, so that `system=` replaces it.
_THESIS = {"system": {"vehicle": "bent-thesis", "physics_dt": 2.5e-3}}
# Tasks whose version 1 stands on the finite-element beam; the others have one base in every
# version. With `damped`, energies are measured by the damping that such a beam has.
_FINITE_ELEMENTS: dict[str, Any] = {"damped": True}
_ON_A_BEAM = ("PumaRestToRest", "PumaReach", "PumaReachGoal", "PumaTrack", "PumaDamp")

# What version 1 asks besides, so that doing nothing solves nothing and arriving pays
# (tests/envs/test_success.py): a share of the straight line's energy, at jerks that planners
# and policies both keep; a reward at the target; a share of what the locked arm leaves.
ASKED: dict[str, dict[str, Any]] = {
    "PumaRestToRest": {
        "saving": 0.5,
        "rest": math.radians(5.0),
        "control": {"kind": "guided", "jerk": 400.0},
    },
    "PumaReach": {"arrival": 1.0},
    "PumaDamp": {"saving": 0.65},
    "BeamLQR": {"slack": 0.1},
}
# In the laboratory the platform's lag and errors come on top: what the reference controllers
# still reach there in 95 of 100 episodes, and doing nothing in none.
ASKED_OF_A_MACHINE: dict[str, dict[str, Any]] = {
    "PumaRestToRest": {"rest": math.radians(8.0)},
    "PumaDamp": {"saving": 0.72},
    # starts three times as large: the errors of a laboratory are not
    "BeamLQR": {"slack": 0.2, "shift": 3e-3, "tilt": 9e-4, "bend": 3e-2},
    "FreeFlyerReach": {"rest": math.radians(10.0)},
    "PayloadTransfer": {"rest": 0.08},  # m/s: there the payload's weight is taken for a force
}

ENTRY_POINT = "ves_gym.envs.env:VesEnv"

# name: task, settings
IDS: dict[str, tuple[str, dict[str, Any]]] = {
    "PumaRestToRest": ("rest_to_rest", {}),
    "PumaReach": ("reach", {}),
    "PumaReachGoal": ("reach_goal", {"goal": True}),
    "PumaTrack": ("track", {}),
    "MacroMicro": ("seam", {}),
    "PumaDamp": ("damp", {}),
    "FreeFlyerReach": ("free_flyer", {}),
    "BeamLQR": ("lqr", {}),
    "PoseReach": ("pose_reach", {}),
    "PayloadTransfer": ("payload_transfer", {}),
    "ServicerCapture": ("servicer_capture", {}),
}


# Tasks that no laboratory has: its platform emulates a satellite's body, neither wheels nor
# jets, and a stand holds what is grasped until then, so that nothing tumbles.
IN_SPACE_ONLY = ("ServicerCapture",)

# Control periods of an episode of default settings: no task's module is loaded to tell them.
STEPS = {
    "PumaRestToRest": 160,
    "PumaReach": 320,
    "PumaReachGoal": 320,
    "PumaTrack": 480,
    "MacroMicro": 480,
    "PumaDamp": 640,
    "FreeFlyerReach": 400,
    "BeamLQR": 320,
    "PoseReach": 400,
    "PayloadTransfer": 800,
    "ServicerCapture": 600,
}


def register() -> None:
    """File every id with Gymnasium; ids that are there already stay."""
    # version 0 has a successor and no fault: the leaderboard asks for it
    warnings.filterwarnings("ignore", r".*ves/\w+-v0 is out of date", DeprecationWarning)
    for name, (task, settings) in IDS.items():
        first, second = (_THESIS, _FINITE_ELEMENTS) if name in _ON_A_BEAM else ({}, {})
        second = {**second, **ASKED.get(name, {})}
        variants = {"-v0": first}
        if second:
            variants["-v1"] = second
        if name not in IN_SPACE_ONLY:
            machine = ASKED_OF_A_MACHINE.get(name, {})
            variants["Emulated-v0"] = {**first, **_LABORATORY[0]}
            variants["Emulated-v1"] = {**second, **machine, **_LABORATORY[1]}
        for suffix, added in variants.items():
            id = f"ves/{name}{suffix}"
            if id not in gym.registry:
                gym.register(
                    id,
                    entry_point=ENTRY_POINT,
                    vector_entry_point="ves_gym.envs.vector:VesVectorEnv",
                    max_episode_steps=Deadline(STEPS[name]),
                    additional_wrappers=(UNLIMITED,),
                    kwargs={"task": task, **settings, **added},
                    # `VesEnv` asks for a reset itself, and Gymnasium's passive checker breaks
                    # the first step after a refused seed (tests/envs/test_contract.py)
                    order_enforce=False,
                    disable_env_checker=True,
                )
                gym.registry[id] = with_deadline(gym.registry[id], STEPS[name])
