"""`Sb3Learner`: a model of Stable-Baselines3 as `train` runs it."""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.decisions import Decisions, Endings
from ves_gym.baselines.policy import Policy, from_sb3
from ves_gym.baselines.sb3 import Sb3VecEnv
from ves_gym.envs.vector import VesVectorEnv

_ATTRIBUTES = (  # of the model, beside its parameters
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "_current_progress_remaining",
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
)


class Sb3Learner:
    """PPO or SAC of Stable-Baselines3, the reference.

    Args:
        config: of the run.
        seed: of weights, exploration and, plus `episodes`, the episodes.
        env: its environment, taken over.
        episodes: seed of the training episodes, less the run's.
        on_endings: told of every episode that ends.
    """

    def __init__(
        self,
        config: TrainConfig,
        seed: int,
        env: VesVectorEnv,
        episodes: int,
        on_endings: Callable[[Endings], None],
    ) -> None:
        self.config = config
        self.venv = Sb3VecEnv(env, on_endings=on_endings, **config.decisions())
        self.model = _model(config, seed, self.venv)
        self.venv.seed(episodes + seed)

    @property
    def steps(self) -> int:
        """Decisions so far."""
        return int(self.model.num_timesteps)

    @property
    def decisions(self) -> Decisions:
        """The environments that decisions are made in."""
        return self.venv.decisions

    def learn(self, total: int, between: Callable[[], None]) -> None:
        """Train up to `total` decisions; `between` is called between rollouts."""
        remaining = total - self.steps
        if remaining > 0:
            self.model.learn(
                remaining,
                callback=_callback(between),
                log_interval=None,
                reset_num_timesteps=False,
            )

    def logged(self) -> dict[str, float]:
        """Figures of the last update."""
        every = self.model.logger.name_to_value
        return {k.removeprefix("train/"): v for k, v in every.items() if "train/" in k}

    def policy(self, about: Mapping[str, Any]) -> Policy:
        """Return the policy as it is now."""
        return from_sb3(self.model, about, self.config.label, self.config.hold)

    def state(self) -> dict[str, Any]:
        """Everything that training depends on from here, but the environment."""
        import torch

        model: Any = self.model
        return {
            "parameters": model.get_parameters(),
            "variables": _variables(model),
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
        import torch

        model: Any = self.model
        model.set_parameters(state["parameters"], device="cpu")
        for name, value in state["variables"].items():
            getattr(model, name).data.copy_(value)
        for name, value in state["attributes"].items():
            setattr(model, name, value)
        if state["buffer"] is not None:
            _refill(model.replay_buffer, state["buffer"])
        python, numpy, torch_state, actions = state["random"]
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
        torch.set_rng_state(torch_state)
        model.action_space.np_random.bit_generator.state = actions


def _callback(between: Callable[[], None]) -> Any:
    from stable_baselines3.common.callbacks import BaseCallback

    class Callback(BaseCallback):
        def _on_rollout_start(self) -> None:
            between()

        def _on_step(self) -> bool:
            return True

    return Callback()


def _model(config: TrainConfig, seed: int, venv: Any) -> Any:
    """A new model of Stable-Baselines3."""
    import stable_baselines3
    import torch
    from stable_baselines3.common.logger import Logger

    cls = getattr(stable_baselines3, config.algorithm)
    settings = dict(config.hyperparameters)
    parameters = [k for k in inspect.signature(cls).parameters if k != "policy_kwargs"]
    unknown = [k for k in settings if k not in parameters]
    if unknown:
        raise ParameterError(
            f"{config.algorithm} has no hyper-parameter {unknown[0]!r}; known:"
            f" {', '.join(parameters)}{did_you_mean(unknown[0], parameters)}"
        )
    rate, end = settings.pop("learning_rate", 3e-4), config.final_rate
    if config.her is not None:
        settings["replay_buffer_class"] = stable_baselines3.HerReplayBuffer
        settings["replay_buffer_kwargs"] = config.her
    kwargs: dict[str, Any] = {
        "net_arch": list(config.layers),
        "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[config.activation],
    }
    if config.algorithm == "PPO":
        kwargs["log_std_init"] = config.log_std
    try:
        model = cls(
            "MultiInputPolicy" if venv.env.goal else "MlpPolicy",
            venv,
            learning_rate=lambda remaining: rate * (end + (1 - end) * max(0.0, remaining)),
            policy_kwargs=kwargs,
            seed=seed,
            device="cpu",
            **settings,
        )
    except (TypeError, AssertionError) as error:
        raise ParameterError(f"{config.algorithm}: {error}") from error
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def _variables(model: Any) -> dict[str, Any]:
    """Tensors that are learned beside the networks: SAC's entropy coefficient."""
    names = model._get_torch_save_params()[1]
    return {name: getattr(model, name) for name in names if getattr(model, name) is not None}


def _buffer(model: Any) -> dict[str, Any] | None:
    """The part of a replay buffer that is filled."""
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    return {
        "pos": buffer.pos,
        "full": buffer.full,
        "rows": {k: v[:filled] for k, v in _stored(buffer).items()},
        "starts": getattr(buffer, "_current_ep_start", None),  # of hindsight replay
    }


def _refill(buffer: Any, state: dict[str, Any]) -> None:
    for name, array in _stored(buffer).items():
        rows = state["rows"][name]
        array[: len(rows)] = rows
    buffer.pos, buffer.full = state["pos"], state["full"]
    if state["starts"] is not None:
        buffer._current_ep_start[:] = state["starts"]


def _stored(buffer: Any) -> dict[str, Any]:
    """Every array of numbers with a row per transition; parts of dictionaries by both names."""
    flat = {}
    for name, value in vars(buffer).items():
        parts = value if isinstance(value, dict) else {"": value}
        for key, array in parts.items():
            rows = isinstance(array, np.ndarray) and array.dtype != object and array.ndim > 1
            if rows and len(array) == buffer.buffer_size:
                flat[f"{name}/{key}"] = array
    return flat
