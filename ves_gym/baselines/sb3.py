"""Stable-Baselines3: its vector environment, its learner as `train` runs it, its policies."""

from __future__ import annotations

import inspect
import random
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import stable_baselines3
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from ves_gym._util.params import Array, Mask, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.decisions import Decisions, Endings
from ves_gym.baselines.policy import ACTIVATIONS, Network, Policy
from ves_gym.envs.vector import VesVectorEnv

_ATTRIBUTES = (  # of a model, beside its parameters
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "_current_progress_remaining",
    "_last_obs",
    "_last_episode_starts",
)


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
        choices: hold and reward_scale: see `Decisions`.
    """

    def __init__(
        self,
        env: VesVectorEnv,
        *,
        on_endings: Callable[[Endings], None] = lambda endings: None,
        **choices: Any,
    ) -> None:
        self.decisions, self.on_endings = Decisions(env, **choices), on_endings
        self.env = env
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
        observation, reward, done, endings = self.decisions.step(self._actions)
        infos = self._nothing.copy() if endings else self._nothing
        for ended in endings:
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
                "TimeLimit.truncated": bool(ended.cut_off[k]),
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


# -------------------------------------------------------------------------- learner


class _BetweenRollouts(BaseCallback):
    def __init__(self, between: Callable[[], None]) -> None:
        super().__init__()
        self.between = between

    def _on_rollout_start(self) -> None:
        self.between()

    def _on_step(self) -> bool:
        return True


class Sb3Learner:
    """PPO, SAC or SAC with hindsight replay of Stable-Baselines3, see `train.Learner`."""

    def __init__(
        self,
        config: TrainConfig,
        seed: int,
        env: VesVectorEnv,
        episodes: int,
        on_endings: Callable[[Endings], None],
    ) -> None:
        self.config = config
        venv = Sb3VecEnv(
            env, on_endings=on_endings, hold=config.hold, reward_scale=config.reward_scale
        )
        self.decisions, self.model = venv.decisions, _model(config, seed, venv)
        venv.seed(episodes + seed)

    @property
    def steps(self) -> int:
        """Decisions so far."""
        return int(self.model.num_timesteps)

    def learn(self, total: int, between: Callable[[], None]) -> None:
        """See `train.Learner`."""
        if total > self.steps:
            self.model.learn(
                total - self.steps,
                callback=_BetweenRollouts(between),
                log_interval=None,
                reset_num_timesteps=False,
            )

    @property
    def logged(self) -> dict[str, float]:
        """Figures of the last update."""
        every = self.model.logger.name_to_value
        return {k.removeprefix("train/"): v for k, v in every.items() if "train/" in k}

    def policy(self, about: Mapping[str, Any]) -> Policy:
        """Return the policy as it is now."""
        return from_sb3(self.model, about, self.config.label, self.config.hold)

    def state(self) -> dict[str, Any]:
        """See `train.Learner`. Not Stable-Baselines3's own file, which is a pickle."""
        model = self.model
        return {
            "parameters": model.get_parameters(),
            "variables": {name: getattr(model, name) for name in _variables(model)},
            "attributes": {k: getattr(model, k) for k in _ATTRIBUTES if hasattr(model, k)},
            "buffer": _buffer(model),
            "random": (
                random.getstate(),
                np.random.get_state(),  # noqa: NPY002
                torch.get_rng_state(),
                model.action_space.np_random.bit_generator.state,
            ),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state."""
        model = self.model
        model.set_parameters(state["parameters"], device="cpu")
        for name, value in state["variables"].items():
            getattr(model, name).data.copy_(value)
        for name, value in state["attributes"].items():
            setattr(model, name, value)
        if state["buffer"] is not None:
            buffer = model.replay_buffer
            buffer.pos, buffer.full = state["buffer"]["pos"], state["buffer"]["full"]
            for name, array in _arrays(buffer).items():
                rows = state["buffer"]["arrays"][name]
                array[: len(rows)] = rows
        python, numpy, torch_state, actions = state["random"]
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
        torch.set_rng_state(torch_state)
        model.action_space.np_random.bit_generator.state = actions


def _model(config: TrainConfig, seed: int, venv: Sb3VecEnv) -> Any:
    """A new model of Stable-Baselines3."""
    name, _, replay = config.algorithm.partition("-")
    cls = getattr(stable_baselines3, name)
    settings = dict(config.hyperparameters)
    parameters = [k for k in inspect.signature(cls).parameters if k != "policy_kwargs"]
    unknown = [k for k in settings if k not in parameters]
    if unknown:
        raise ParameterError(
            f"{config.algorithm} has no hyper-parameter {unknown[0]!r}; known:"
            f" {', '.join(parameters)}{did_you_mean(unknown[0], parameters)}"
        )
    rate = settings.pop("learning_rate", 3e-4)
    if replay:
        settings["replay_buffer_class"] = stable_baselines3.HerReplayBuffer
    kwargs: dict[str, Any] = {
        "net_arch": list(config.layers),
        "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[config.activation],
    }
    if name == "PPO":
        kwargs["log_std_init"] = config.log_std
    try:
        model = cls(
            "MultiInputPolicy" if venv.env.goal else "MlpPolicy",
            venv,
            learning_rate=lambda remaining: config.learning_rate(rate, remaining),
            policy_kwargs=kwargs,
            seed=seed,
            device="cpu",
            **settings,
        )
    except (TypeError, AssertionError) as error:
        raise ParameterError(f"{config.algorithm}: {error}") from error
    # the default one makes a folder among the temporary files
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def _variables(model: Any) -> list[str]:
    """Names of tensors that are learned beside the networks: SAC's entropy coefficient."""
    names = model._get_torch_save_params()[1]
    return [name for name in names if getattr(model, name) is not None]


def _buffer(model: Any) -> dict[str, Any] | None:
    """A replay buffer as far as it is filled."""
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return None
    rows = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {k: v[:rows] if v.ndim > 1 else v for k, v in _arrays(buffer).items()}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _arrays(buffer: Any) -> dict[str, Any]:
    """A buffer's arrays of numbers, (transitions, ...) or (environments,), by name."""
    out = {}
    for name, value in vars(buffer).items():
        parts = value if isinstance(value, dict) else {"": value}
        for key, array in parts.items():
            if isinstance(array, np.ndarray) and array.dtype != object:
                out[f"{name}/{key}"] = array
    return out


# ------------------------------------------------------------------------- policies


def from_sb3(
    model: Any, about: Mapping[str, Any] | None = None, name: str = "policy", hold: int = 1
) -> Policy:
    """The actor of a PPO or SAC model whose policy is a plain perceptron.

    Args:
        model: of Stable-Baselines3.
        about: what the policy's file says of its origin.
        name: of the policy.
        hold: control periods that the model was trained to hold its actions for.
    """
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


def read_sb3_zip(path: str | Path, algorithm: str, *, trusted: bool) -> Policy:
    """The actor in a zip saved by Stable-Baselines3.

    Such a file holds pickles: reading it runs whatever code its author put there.

    Args:
        path: of the file.
        algorithm: PPO or SAC.
        trusted: True says that you made it, or would run a program from where it comes.
    """
    if trusted is not True:
        raise ParameterError(
            f"{path}: reading it would run code from the file; pass trusted=True only if you"
            " would run a program from the same source"
        )
    if algorithm not in ("PPO", "SAC"):
        raise ParameterError(f"algorithm must be PPO or SAC, got {algorithm!r}")
    model = getattr(stable_baselines3, algorithm).load(path, device="cpu")
    return from_sb3(model, name=Path(path).stem)
