"""How specifications tell the length of episodes that an environment ends by itself.

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
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, WrapperSpec


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

    JSON does not tell a `Deadline` from a limit of the caller's; it is written as null, and
    what is made from it has its deadline all the same.
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
    """Return a specification that tells the deadline of the settings in it.

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
