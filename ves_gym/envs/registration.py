"""Ids of the environments, registered by `import ves_gym` and `gym.make("ves_gym:ves/...")`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium as gym

from ves_gym.envs.deadline import UNLIMITED, Deadline, with_deadline

ENTRY_POINT = "ves_gym.envs.env:VesEnv"


class Registered(NamedTuple):
    """What is filed of a task: its id in space, and in the laboratory that emulates it."""

    task: str
    steps: int  # control periods of an episode: no task's module is loaded to tell them
    settings: dict[str, Any] = {}  # besides the task's own defaults
    # What the laboratory's id changes; None of tasks that no laboratory has. There the
    # platform's lag and errors come on top: what the reference controllers still reach in 95 of
    # 100 episodes, and doing nothing in none (tests/envs/test_success.py).
    emulated: dict[str, Any] | None = {}


IDS: dict[str, Registered] = {
    "PumaRestToRest": Registered(  # its jerk is part of the question: no method chooses another
        "rest_to_rest", 160, {"control": {"kind": "guided"}}, {"rest": math.radians(8.0)}
    ),
    "PumaReach": Registered("reach", 320),
    "PumaReachGoal": Registered("reach_goal", 320, {"goal": True}),
    "PumaTrack": Registered("track", 480),
    "MacroMicro": Registered("seam", 480),
    "PumaDamp": Registered("damp", 640, emulated={"saving": 0.72}),
    "FreeFlyerReach": Registered("free_flyer", 400, emulated={"rest": math.radians(10.0)}),
    "BeamLQR": Registered(  # starts three times as large: the errors of a laboratory are not
        "lqr", 320, emulated={"slack": 0.2, "shift": 3e-3, "tilt": 9e-4, "bend": 3e-2}
    ),
    "PoseReach": Registered("pose_reach", 400),
    "PayloadTransfer": Registered(  # m/s: there the payload's weight is taken for a force
        "payload_transfer", 800, emulated={"rest": 0.08}
    ),
    # its platform emulates a satellite's body, neither wheels nor jets, and a stand holds what
    # is grasped until then, so that nothing tumbles
    "ServicerCapture": Registered("servicer_capture", 600, emulated=None),
}


def register() -> None:
    """File every id with Gymnasium; ids that are there already stay."""
    for name, entry in IDS.items():
        variants = {f"ves/{name}-v0": entry.settings}
        if entry.emulated is not None:
            machine = {"mode": "emulated", "laboratory": "lab", **entry.emulated}
            variants[f"ves/{name}Emulated-v0"] = {**entry.settings, **machine}
        for id, settings in variants.items():
            if id not in gym.registry:
                gym.register(
                    id,
                    entry_point=ENTRY_POINT,
                    vector_entry_point="ves_gym.envs.vector:VesVectorEnv",
                    max_episode_steps=Deadline(entry.steps),
                    additional_wrappers=(UNLIMITED,),
                    kwargs={"task": entry.task, **settings},
                    # `VesEnv` asks for a reset itself, and Gymnasium's passive checker breaks
                    # the first step after a refused seed (tests/envs/test_contract.py)
                    order_enforce=False,
                    disable_env_checker=True,
                )
                gym.registry[id] = with_deadline(gym.registry[id], entry.steps)
