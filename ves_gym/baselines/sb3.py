"""Stable-Baselines3: its vector environment, and its policies as ours."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from ves_gym._util.params import Array, Mask, ParameterError
from ves_gym.baselines.action_repeat import ActionRepeat, Endings
from ves_gym.baselines.policy import ACTIVATIONS, Network, Policy


class Sb3VecEnv(VecEnv):
    """A `VesVectorEnv` whose episodes begin anew in the step that ended them.

    A step does no Python work per environment but for those whose episode ended. Their info
    holds `terminal_observation`, `TimeLimit.truncated`, `episode` ({"r", "l", "t"}: return,
    length in control periods, seconds since this object was made), `is_success` and the
    energies (`energy/E_mean` ...); all others' is an empty dictionary, the same object every
    time.

    Args:
        env: its autoreset mode is not used.
        on_endings: called with every episode that ends.
        choices: hold and reward_scale: see `ActionRepeat`.
    """

    def __init__(
        self,
        env: gym.vector.VectorEnv[Any, Any, Any],
        *,
        on_endings: Callable[[Endings], None] = lambda endings: None,
        **choices: Any,
    ) -> None:
        self.decisions, self.on_endings = ActionRepeat(env, **choices), on_endings
        self.env = self.decisions.env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._begin = time.perf_counter()
        self._actions: Any = None
        self._nothing: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]

    def reset(self) -> Any:
        """First observations of the next episodes, seeded if `seed` was called before."""
        options = None
        if any(self._options):
            options = {k: np.stack([o[k] for o in self._options]) for k in self._options[0]}
        seeds = None if self._seeds[0] is None else list(self._seeds)
        observation, _ = self.env.reset(seed=seeds, options=options)
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: Array) -> None:
        """Take the actions; `step_wait` does the work."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, Any, Mask, list[dict[str, Any]]]:
        """Observations, rewards (float32), dones and infos."""
        observation, reward, done, _, info = self.decisions.step(self._actions)
        infos = self._nothing.copy() if done.any() else self._nothing
        for ended in info.get("endings", ()):
            self.on_endings(ended)
            self._annotate(infos, ended)
        return observation, reward, done, infos

    def _annotate(self, infos: list[dict[str, Any]], ended: Endings) -> None:
        """Write the infos of episodes that have just ended."""
        seconds = round(time.perf_counter() - self._begin, 6)
        final = ended.final
        for k, i in enumerate(ended.ids.tolist()):
            infos[i] = {
                "terminal_observation": (
                    {n: v[k] for n, v in final.items()} if self.env.goal else final[k]
                ),
                "TimeLimit.truncated": False,  # deadlines are part of the tasks
                "episode": {
                    "r": float(ended.total[k]),
                    "l": int(ended.steps[k]),
                    "t": seconds,
                },
                "is_success": bool(ended.success[k]),
                **{name: float(v[k]) for name, v in ended.energies.items()},
            }

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method once: `compute_reward` of the task, others of the environment."""
        if method_name == "compute_reward":
            achieved, desired, *_ = args
            worth = self.env.task.goal_reward(np.asarray(achieved), np.asarray(desired))
            result = self.decisions.hold * self.decisions.reward_scale * worth
        else:
            result = getattr(self.env, method_name)(*args, **kwargs)
        return [result for _ in self._get_indices(indices)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The vector environment's attribute, once per index."""
        value = getattr(self.env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set the vector environment's attribute: for all environments or for none."""
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ParameterError(
                f"set_attr acts on all {self.num_envs} environments at once, got indices"
                f" {indices}"
            )
        setattr(self.env, attr_name, value)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Never: there are no single environments to wrap."""
        return [False for _ in self._get_indices(indices)]

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()


# ------------------------------------------------------------------------- policies


def from_sb3(
    model: Any,
    about: Mapping[str, Any] | None = None,
    name: str = "policy",
    hold: int | None = None,
) -> Policy:
    """The actor of a PPO or SAC model whose policy is a plain perceptron.

    Args:
        model: of Stable-Baselines3.
        about: what the policy's file says of its origin.
        name: of the policy.
        hold: control periods that the model was trained to hold its actions for; default
            what its environment says, 1 without one.
    """
    if hold is None:
        decisions = getattr(model.get_env(), "decisions", None)  # of `Sb3VecEnv`, wrapped too
        hold = 1 if decisions is None else int(decisions.hold)
    policy = model.policy
    if hasattr(policy, "mlp_extractor"):  # PPO
        trunk, head, output = policy.mlp_extractor.policy_net, policy.action_net, "clip"
    elif hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):  # SAC
        trunk, head, output = policy.actor.latent_pi, policy.actor.mu, "tanh"
    else:
        raise ParameterError(f"expected a PPO or SAC model, got {type(model).__name__}")
    linear, kinds = _layers([*trunk, head])
    space = policy.observation_space
    inputs = tuple(space.spaces) if isinstance(space, spaces.Dict) else ()
    boxes: Sequence[Any] = [space[k] for k in inputs] if inputs else [space]
    network = Network(
        sizes=(linear[0][0].shape[0], *(W.shape[1] for W, _ in linear)),
        activation=kinds.pop() if kinds else "tanh",
        output=output,
        observation_limit=float(max(np.abs(box.high).max() for box in boxes)),
        inputs=inputs,
        hold=hold,
    )
    return Policy(network, tuple(linear), dict(about or {}), name)


def _layers(modules: Sequence[Any]) -> tuple[list[tuple[Array, Array]], set[str]]:
    """Weights of the linear modules, and the one kind of activation between them."""
    linear, kinds = [], set()
    for module in modules:
        kind = type(module).__name__
        if kind == "Linear":
            W, b = (
                p.detach().cpu().numpy().astype(float) for p in (module.weight, module.bias)
            )
            linear.append((np.ascontiguousarray(W.T), b))
        elif kind.lower() in ACTIVATIONS:
            kinds.add(kind.lower())
        else:
            raise ParameterError(
                f"a policy is made of Linear, Tanh and ReLU modules, got {kind}"
            )
    if len(kinds) > 1:
        raise ParameterError(f"a policy has one kind of activation, got {', '.join(kinds)}")
    return linear, kinds
