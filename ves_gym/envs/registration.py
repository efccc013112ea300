"""Ids of the environments, registered by `import ves_gym` and `gym.make("ves_gym:ves/...")`.

Gymnasium wraps whatever is registered with `max_episode_steps` in a `TimeLimit`, which counts
steps of its own. Here the deadline is part of the task: it depends on `duration`, most tasks
are `terminated` by it, and a snapshot holds how far off it is. A second count would truncate
where the task terminates, at the default's step where `duration` is longer, and early after
`restore`. So the registered number is a `Deadline`: libraries read it, `TimeLimit` never
reaches it, and `gym.make` takes that wrapper off again, for it hides `compute_reward` and
`snapshot`. A limit that a caller gives is a plain int and acts as everywhere.
"""

from __future__ import annotations

import copy
import math
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, WrapperSpec

ENTRY_POINT = "ves_gym.envs.env:VesEnv"


class Registered(NamedTuple):
    """Entry of a task: its id in space, and in the laboratory that emulates it."""

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
    "DualArmReach": Registered("dual_arm_reach", 400, emulated={"rest": math.radians(10.0)}),
    # its platform emulates a satellite's body, neither wheels nor jets, and a stand holds what
    # is grasped until then, so that nothing tumbles
    "ServicerCapture": Registered("servicer_capture", 600, emulated=None),
    "BerthingContact": Registered("berthing_contact", 800, emulated=None),
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


# ---------------------------------------------------------------------- deadlines


class Deadline(int):
    """Number of steps after which an environment ends its episodes by itself."""

    __slots__ = ()

    def __le__(self, other: object) -> bool:
        """Return False: `steps >= deadline`, as `TimeLimit` asks, is for the task to say."""
        return False


def without_time_limit(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """Return an environment without the `TimeLimit` that `gym.make` adds for a `Deadline`."""
    if not isinstance(env, gym.wrappers.TimeLimit) or env.spec is None:
        return env
    return env.env if isinstance(env.spec.max_episode_steps, Deadline) else env


# Additional wrappers come after `TimeLimit`, the only place where it can be taken off.
UNLIMITED = WrapperSpec(
    "without_time_limit", f"{without_time_limit.__module__}:without_time_limit", {}
)


class DeadlineSpec(EnvSpec):
    """Specification of environments that end their episodes by themselves.

    JSON does not distinguish a `Deadline` from a limit of the caller's. It is written as null,
    and what is made from it has its deadline all the same.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; the registered deadline does not replace that of the settings."""
        both = isinstance(value, Deadline) and isinstance(self.__dict__.get(name), Deadline)
        if not both:
            super().__setattr__(name, value)

    def __deepcopy__(self, memo: dict[int, Any]) -> DeadlineSpec:
        """Return a copy without `UNLIMITED`: `make_vec` copies, and refuses any wrapper."""
        out = copy.copy(self)
        out.__dict__.update(copy.deepcopy(self.__dict__, memo))
        out.additional_wrappers = tuple(k for k in self.additional_wrappers if k != UNLIMITED)
        return out

    def to_json(self) -> str:
        """Return the specification as JSON, without a `Deadline`."""
        plain = copy.deepcopy(self)
        if isinstance(plain.max_episode_steps, Deadline):
            plain.max_episode_steps = None
        return super(DeadlineSpec, plain).to_json()


def with_deadline(spec: EnvSpec, steps: int) -> DeadlineSpec:
    """Return a specification with the deadline of the settings in it.

    Args:
        spec: of an environment that ends its episodes by itself.
        steps: control periods of an episode.

    Returns:
        A copy whose `max_episode_steps` is the `Deadline`, or the limit in `spec.kwargs`.
    """
    out = DeadlineSpec(spec.id)
    out.__dict__.update(copy.copy(spec.__dict__))
    out.kwargs = dict(spec.kwargs)
    limit = out.kwargs.get("max_episode_steps")
    if isinstance(limit, Deadline):  # `make_vec` hands on what was registered
        del out.kwargs["max_episode_steps"]
        limit = None
    out.__dict__["max_episode_steps"] = Deadline(steps) if limit is None else limit
    return out
