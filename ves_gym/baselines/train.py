"""`train`: one training run with Stable-Baselines3, and how it survives being killed.

A run's folder holds `curve.jsonl` (one line per evaluation), the best and the last policy in
the safe format, and `checkpoint.safetensors`: everything the run needs to go on, taken where
no rollout is half collected. After SIGKILL at any moment a resumed run ends with the same
weights, to the last bit, as one that was left alone (same machine, same versions, CPU).
"""

from __future__ import annotations

import inspect
import itertools
import json
import random
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, content_hash, write_text
from ves_gym._util.process_pool import WorkerDied, Workers, note
from ves_gym._util.statistics import STATISTICS, bootstrap, rate
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.checkpoint import load_state, save_state
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.controllers import Zero
from ves_gym.baselines.evaluate import Evaluation, evaluate, make_vector, ratio
from ves_gym.baselines.policy import Policy, from_sb3, save_policy, versions
from ves_gym.envs.task import Task

CHECKPOINT, CURVE = "checkpoint.safetensors", "curve.jsonl"
SCHEMA = "ves-checkpoint/1"
PACKAGES = ("torch", "stable_baselines3", "safetensors")  # what training needs
TRAINING = 1_000_000  # seed of the training episodes, plus the run's own
VALIDATION = 2_000_000  # first seed of the episodes that a run is judged by as it learns
_ATTRIBUTES = (  # of the model, beside its parameters
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "_current_progress_remaining",
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
)

Progress = Callable[[float, str], None]


def train(
    config: TrainConfig,
    seed: int,
    folder: Path,
    *,
    resume: bool = False,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Train one policy; the rows of its learning curve.

    Args:
        seed: of weights, exploration and training episodes.
        folder: where the run's files go.
        resume: go on from the checkpoint in `folder`, if there is one.
        progress: called with the fraction done and a few words.

    Raises:
        ParameterError: a run is already there and `resume` is not said, or it is another
            configuration's; hyper-parameters that the algorithm does not know.
        MissingPackageError: a package of `PACKAGES` is not installed.
    """
    require("training", *PACKAGES)
    import torch

    folder = Path(folder)
    _require_free(folder, resume)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(".*"):  # left by a write that was killed
        stale.unlink()
    threads, deterministic = (
        torch.get_num_threads(),
        torch.are_deterministic_algorithms_enabled(),
    )
    torch.set_num_threads(1)  # layers this small are slower on more, and sums depend on it
    torch.use_deterministic_algorithms(True)
    try:
        return _Run(config, seed, folder, progress or (lambda done, note: None)).learn()
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(deterministic)


def _require_free(folder: Path, resume: bool) -> None:
    if (folder / CHECKPOINT).exists() and not resume:
        raise ParameterError(f"{folder} holds a run already: resume it, or choose another")


def _versions() -> dict[str, str]:
    return versions("torch", "stable-baselines3", "safetensors")


class _Run:
    """A model, its environment, and what is remembered of the run so far."""

    def __init__(
        self,
        config: TrainConfig,
        seed: int,
        folder: Path,
        progress: Progress,
    ) -> None:
        from ves_gym.baselines.sb3 import Sb3VecEnv

        self.config, self.seed, self.folder, self.progress = config, seed, folder, progress
        self.settings = {
            **({"goal": True} if config.her is not None else {}),
            **config.settings,
        }
        env = make_vector(
            config.env, config.n_envs, AutoresetMode.SAME_STEP, threads=1, **self.settings
        )
        self.venv = Sb3VecEnv(
            env,
            hold=config.hold,
            reward_scale=config.reward_scale,
            endless=config.endless,
            smooth=config.smooth,
        )
        self.model = _model(config, seed, self.venv)
        self.venv.seed(TRAINING + seed)
        self.zero = self._evaluate(Zero())  # what every evaluation is compared with
        self.rows: list[dict[str, Any]] = []
        self.best: Policy | None = None
        self.returns: list[float] = []  # of the training episodes since the last row
        self.solved = 0
        self.earlier = 0.0  # s, before the run was last resumed
        self.stepping = 0.0  # s of them in the environment
        self.saved = -1  # steps at the last checkpoint
        self.identity = {  # what a checkpoint must agree with
            "schema": SCHEMA,
            "config": {**config.to_dict(), "seeds": [seed]},
            "task": content_hash(env.task),
        }
        self.references = {"task": env.task}
        if (folder / CHECKPOINT).exists():
            self._restore(self._read(folder / CHECKPOINT))
        self.begin = time.perf_counter()

    # ------------------------------------------------------------------ training

    def learn(self) -> list[dict[str, Any]]:
        """Train to the end."""
        total = self.config.total_timesteps
        remaining = total - self.model.num_timesteps
        if remaining > 0:
            self.model.learn(
                remaining,
                callback=_callback(self),
                log_interval=None,
                reset_num_timesteps=False,
            )
        self.between_rollouts(last=True)
        return self.rows

    def between_rollouts(self, last: bool = False) -> None:
        """Evaluate and save where it is time to; nothing is half collected now."""
        steps, total = self.model.num_timesteps, self.config.total_timesteps
        every = self.config.eval_every or max(1, total // 20)
        done = self.rows[-1]["steps"] if self.rows else -1
        new = (last and steps > done) or steps // every > done // every
        if new:
            self._judge(steps)
        often = self.config.checkpoint_every or every
        due = steps // often > self.saved // often
        if steps > self.saved and (new or last or due):
            self._save(steps)
        note = f"{steps:,} steps"
        if self.rows:
            note += f", return {self.rows[-1]['return']:.3f}"
        self.progress(min(1.0, steps / total), note)

    def episode(self, info: dict[str, Any]) -> None:
        """An episode of training has ended."""
        self.returns.append(info["episode"]["r"])
        self.solved += info["is_success"]

    def _evaluate(self, controller: Any) -> Evaluation:
        return evaluate(
            controller,
            self.config.env,
            episodes=self.config.eval_episodes,
            seed=VALIDATION,
            threads=1,
            **self.settings,
        )

    def _policy(self, steps: int) -> Policy:
        about = {
            "env": self.config.env,
            "settings": self.settings,
            "algorithm": self.config.label,
            "seed": self.seed,
            "steps": steps,
            "versions": _versions(),
        }
        return from_sb3(self.model, about, self.config.label, self.config.hold)

    def _judge(self, steps: int) -> None:
        """A row of the curve, and the policies' files."""
        policy = self._policy(steps)
        evaluation = self._evaluate(policy)
        mean = bootstrap(evaluation.values("return"), STATISTICS["mean"])
        seconds, stepping = self._time()
        row: dict[str, Any] = {
            "steps": steps,
            "return": mean.value,
            "return_low": mean.low,
            "return_high": mean.high,
        }
        for name in ("success", "success_once"):
            row[name] = rate(np.concatenate(evaluation.values(name)) > 0).value
        for name in ("E_mean", "E_peak", "E_int"):
            row[name] = _finite(np.median(np.concatenate(evaluation.values(name))))
            row[f"{name}_ratio"] = self._ratio(evaluation, name)
        row["train_episodes"] = len(self.returns)
        row["train_return"] = float(np.mean(self.returns)) if self.returns else None
        row["train_success"] = self.solved / len(self.returns) if self.returns else None
        logged = self.model.logger.name_to_value
        row["train"] = {
            k.removeprefix("train/"): _finite(v) for k, v in logged.items() if "train/" in k
        }
        row["seconds"], row["seconds_stepping"] = round(seconds, 3), round(stepping, 3)
        self.returns, self.solved = [], 0
        if self.best is None or mean.value > max(r["return"] for r in self.rows):
            self.best = policy
        self.rows.append(row)
        self._write(policy)

    def _ratio(self, evaluation: Evaluation, measure: str) -> float | None:
        try:
            return _finite(ratio(evaluation, self.zero, measure).value)
        except ParameterError:  # a base that nothing moves
            return None

    def _write(self, last: Policy) -> None:
        assert self.best is not None
        save_policy(self.best, self.folder / "best.json")
        save_policy(last, self.folder / "last.json")
        lines = [json.dumps(row, allow_nan=False) + "\n" for row in self.rows]
        write_text(self.folder / CURVE, "".join(lines))

    def _time(self) -> tuple[float, float]:
        """Seconds of training so far, and those of them in the environment."""
        return (
            self.earlier + time.perf_counter() - self.begin,
            self.stepping + self.venv.stepping,
        )

    # ---------------------------------------------------------------- checkpoint

    def _save(self, steps: int) -> None:
        import torch

        model: Any = self.model
        seconds, stepping = self._time()
        self.saved = steps
        state = {
            **self.identity,
            "versions": _versions(),
            "rows": self.rows,
            "best": self.best,
            "returns": self.returns,
            "solved": self.solved,
            "seconds": seconds,
            "stepping": stepping,
            "parameters": model.get_parameters(),
            "variables": _variables(model),
            "attributes": {k: getattr(model, k) for k in _ATTRIBUTES if hasattr(model, k)},
            "buffer": _buffer(model),
            "environment": self.venv.env.snapshot(),
            "random": (
                random.getstate(),
                np.random.get_state(),  # noqa: NPY002
                torch.get_rng_state(),
                model.action_space.np_random.bit_generator.state,
            ),
        }
        save_state(self.folder / CHECKPOINT, state, self.references)

    def _read(self, path: Path) -> dict[str, Any]:
        state: dict[str, Any] = load_state(path, self.references)
        for name, value in self.identity.items():
            if state.get(name) != value:
                raise ParameterError(
                    f"{path} is of another run: its {name} is {state.get(name)}, this one's"
                    f" {value}"
                )
        if state["versions"] != _versions():
            warnings.warn(
                f"{path} was made by {state['versions']}, this is {_versions()}: the run goes"
                " on, but not as it would have",
                stacklevel=4,
            )
        return state

    def _restore(self, state: dict[str, Any]) -> None:
        import torch

        model: Any = self.model
        self.rows, self.best = state["rows"], state["best"]
        self.returns, self.solved = state["returns"], state["solved"]
        self.earlier, self.stepping = state["seconds"], state["stepping"]
        model.set_parameters(state["parameters"], device="cpu")
        for name, value in state["variables"].items():
            getattr(model, name).data.copy_(value)
        for name, value in state["attributes"].items():
            setattr(model, name, value)
        self.saved = model.num_timesteps
        if state["buffer"] is not None:
            _refill(model.replay_buffer, state["buffer"])
        self.venv.env.restore(state["environment"])
        python, numpy, torch_state, actions = state["random"]
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002
        torch.set_rng_state(torch_state)
        model.action_space.np_random.bit_generator.state = actions
        if self.rows:  # the files may be of a later moment than the checkpoint
            self._write(self._policy(self.saved))


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
    if config.relative:
        _lean(model, venv.env.task, config.relative)
    return model


def _lean(model: Any, task: Task, length: float) -> None:
    """Begin with first layers that look at the way to the target, in lengths [m].

    Otherwise a network must learn first how much the last centimetres matter and, where it is
    given two places, that their difference alone does.
    """
    import torch

    space = model.observation_space
    parts: dict[str, int]
    if isinstance(space, spaces.Dict):
        parts = {name: spaces.flatdim(box) for name, box in space.spaces.items()}
    else:
        parts = {field.name: field.size for field in task.parts()}
    ends = np.cumsum([0, *parts.values()]).tolist()
    at = {name: slice(*ab) for name, ab in zip(parts, itertools.pairwise(ends), strict=True)}
    extractor = model.policy.mlp_extractor
    with torch.no_grad():
        for net in (extractor.policy_net, extractor.value_net):
            W = net[0].weight
            if "achieved_goal" in at:
                extra = torch.randn(len(W), parts["achieved_goal"]) * W.std() / length
                W[:, at["achieved_goal"]] -= extra
                W[:, at["desired_goal"]] += extra
            elif "to_target" in at:
                scale = next(f.scale for f in task.fields() if f.name == "to_target")
                W[:, at["to_target"]] *= torch.as_tensor(scale / length, dtype=W.dtype)
            else:
                raise ParameterError(
                    f"TrainConfig.relative needs a task with a target, got {task.kind}"
                )


def _callback(run: _Run) -> Any:
    from stable_baselines3.common.callbacks import BaseCallback

    class Callback(BaseCallback):
        def _on_rollout_start(self) -> None:
            run.between_rollouts()

        def _on_step(self) -> bool:
            ended = self.locals["dones"]
            if ended.any():
                for i in np.flatnonzero(ended).tolist():
                    run.episode(self.locals["infos"][i])
            return True

    return Callback()


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


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


# --------------------------------------------------------------------- several seeds


def train_seeds(
    config: TrainConfig,
    seeds: Sequence[int],
    folder: Path,
    *,
    workers: int = 1,
    resume: bool = False,
    progress: Callable[[int, float, str], None] | None = None,
) -> dict[int, list[dict[str, Any]]]:
    """Train a policy per seed in folder/seed-N; the curves by seed.

    Args:
        workers: processes; each trains one seed at a time. A run whose process is killed
            goes on in another, from its checkpoint.
        progress: called with the seed, the fraction done and a few words.
    """
    require("training", *PACKAGES)
    report = progress or (lambda seed, done, note: None)
    folder = Path(folder)
    for seed in seeds:  # before the first is trained for an hour
        _require_free(folder / f"seed-{seed}", resume)
    if min(workers, len(seeds)) == 1:
        return {
            seed: train(
                config,
                seed,
                folder / f"seed-{seed}",
                resume=resume,
                progress=lambda done, note, seed=seed: report(seed, done, note),  # type: ignore[misc]
            )
            for seed in seeds
        }
    with Workers(min(workers, len(seeds))) as pool:
        jobs = {
            seed: pool.submit(_job, config, seed, folder / f"seed-{seed}", on_note=report)
            for seed in seeds
        }
        try:
            return {seed: job.result() for seed, job in jobs.items()}
        except WorkerDied as error:
            raise ChildProcessError(
                f"a training run was lost: {error}; resume to go on from its checkpoint"
            ) from None


def _job(config: TrainConfig, seed: int, folder: Path) -> list[dict[str, Any]]:
    """A seed's run in a worker; if its process was killed, from its checkpoint."""
    return train(
        config,
        seed,
        folder,
        resume=True,  # that the folder may be used was asked before
        progress=lambda done, words: note(seed, done, words),
    )
