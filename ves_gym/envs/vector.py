"""`VesVectorEnv`: n episodes in lockstep through Gymnasium's vector interface, no loop."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ves_gym._util.params import Array, Mask, ParameterError, integer
from ves_gym.envs.batch import Batch
from ves_gym.envs.env import Episodic
from ves_gym.envs.registration import Deadline
from ves_gym.envs.signals import require_seed
from ves_gym.envs.task import Task


class _Described(type):
    """Stable-Baselines3 quotes the class of what it refuses: so that says which adapter."""

    def __repr__(cls) -> str:
        name = f"{cls.__module__}.{cls.__qualname__}"
        return f"<class '{name}'; for Stable-Baselines3: ves_gym.baselines.sb3.Sb3VecEnv(env)>"


class VesVectorEnv(  # type: ignore[misc]
    Episodic, gym.vector.VectorEnv[Any, Any, Any], metaclass=_Described
):
    """n episodes of a task.

    Args:
        num_envs: how many.
        task: registered name, class or `Task`.
        autoreset_mode: NextStep (Gymnasium's default), SameStep or Disabled.
        render_mode: None, or "rgb_array": `render` returns a frame of every environment.
        backend, threads: engine and its threads, see `Simulator`.
        goal: observations of a goal-conditioned task as a dictionary.
        dump: folder for run logs of episodes that diverge (`info["dump"]` names the files).
        max_episode_steps: truncate after so many steps, as `TimeLimit` does around a single
            environment; None or -1: nothing but the task's own end.
        reward, cost, privileged: see `VesEnv`; `reward_space` is that of one environment.
        settings: see `build_task`.

    `info` holds arrays with the leading axis num_envs; what exists only at the end of an
    episode has its mask beside it (`energy/E_mean`, `_energy/E_mean`), as in Gymnasium.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "render_fps": 80,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        task: str | Task = "rest_to_rest",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        backend: str = "auto",
        threads: int = 0,
        goal: bool = False,
        dump: str | os.PathLike[str] | None = None,
        max_episode_steps: int | None = None,
        reward: str = "scalar",
        cost: Mapping[str, float] | bool | None = None,
        privileged: bool = False,
        **settings: Any,
    ) -> None:
        self._limit = _step_limit(max_episode_steps)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"render_mode of a vector must be None or rgb_array, got {render_mode!r}"
            )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.num_envs = num_envs
        self.single_action_space: gym.spaces.Box
        form = render_mode, goal, reward, cost, privileged
        self.single_action_space, self.single_observation_space = self._set_up(
            task, settings, *form, backend=backend, threads=threads, dump=dump
        )
        self.metadata = {
            **self.metadata,
            "render_fps": 1 / self.task.system.control_dt,  # real time
            "autoreset_mode": self.autoreset_mode,
        }
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._over = np.zeros(num_envs, bool)
        self._everyone = np.arange(num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin the next episodes.

        Args:
            seed: one root for all, whose simulation i is environment i; or one root per
                environment, each its simulation 0, as if they were single environments.
            options: reset_mask (num_envs,) of those to reset, and what the task lets one
                choose, (num_envs, ...) each.
        """
        options = self.task.check_options(options, extra=("reset_mask",), rows=self.num_envs)
        ids = self._everyone
        if "reset_mask" in options:
            ids = np.flatnonzero(_mask(options.pop("reset_mask"), self.num_envs))
            if not self._ready and len(ids) < self.num_envs:
                raise gym.error.ResetNeeded("the first reset must include every environment")
        self._seed(seed, ids)
        self.batch.reset(ids, {k: v[ids] for k, v in options.items()})
        self._over[ids] = False
        self._ready = True
        return self._observation(), self.with_privileged(self.batch.randomized())

    def _seed(self, seed: Any, ids: Any) -> None:
        if seed is None and not self._ready:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if seed is None:
            return
        if np.ndim(seed) == 0:
            require_seed(seed)
            self._np_random, self._np_random_seed = gym.utils.seeding.np_random(int(seed))
            self.batch.seed(ids, int(seed), ids)
            return
        roots = list(seed)
        if len(roots) != self.num_envs:
            raise gym.error.Error(f"seed must be {self.num_envs} numbers, got {len(roots)}")
        if not self._ready:
            drawn = np.random.SeedSequence().generate_state(self.num_envs).tolist()
            roots = [d if r is None else r for r, d in zip(roots, drawn, strict=True)]
        chosen = [i for i in ids.tolist() if roots[i] is not None]
        for i in chosen:
            require_seed(roots[i])
        self.batch.seed(np.array(chosen, int), np.array([roots[i] for i in chosen], "u8"), 0)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One control period; an `ActionError` leaves every state as it was."""
        if not self._ready:
            raise gym.error.ResetNeeded("call reset before step")
        mode = self.autoreset_mode
        if mode is AutoresetMode.DISABLED and self._over.any():
            first = np.flatnonzero(self._over)[:5].tolist()
            raise gym.error.ResetNeeded(
                f"environments {first} are over: reset them with options={{'reset_mask': ...}}"
            )
        checked = self.batch.check(actions)
        over = self._over if self._over.any() else None
        reward, terminated, truncated, info = self._signals.step(self.batch, checked, over)
        if over is not None:  # their action was only the call for the next episode
            self.batch.reset(np.flatnonzero(over))
            info.update(self.batch.randomized())
        if self._limit is not None:
            late = self.batch.episodes.steps >= self._limit
            truncated |= late if over is None else late & ~over
        ended = terminated | truncated
        self._over = ended
        if mode is AutoresetMode.SAME_STEP and ended.any():
            final, last = self._observation(), dict(self.with_privileged(info))
            info["final_obs"], info["_final_obs"] = final, ended
            info["final_info"], info["_final_info"] = last, ended
            self.batch.reset(np.flatnonzero(ended))
            info.update(self.batch.randomized())
            self._over = np.zeros(self.num_envs, bool)
        return self._observation(), reward, terminated, truncated, self.with_privileged(info)

    @property
    def episode_id(self) -> npt.NDArray[np.uint64]:
        """(n, 3) seed, index and number that the episodes' random numbers come from."""
        return self.batch.episode_ids()

    def _observation(self) -> Any:
        return self._observed(self.batch.observe())

    def fan_out(self, source: VesVectorEnv, index: int = 0) -> Any:
        """Put every environment of this one where one of another is, to step it as a model.

        Between environments of the same settings the copy is exact. One with other settings
        (mode, vehicle, effects, randomize) takes over what can be measured; it needs the same
        task, control, duration and arm (`fan_out`).

        Args:
            source: where the episode runs; it stays as it is.
            index: which of its environments.

        Returns:
            The observations (num_envs, ...) there.

        Raises:
            ParameterError: another kind of task; nothing has changed then.
        """
        fan_out(self.batch, source.batch, index)
        over = source._over[index : index + 1]
        self._over, self._ready = np.repeat(over, self.num_envs), source._ready
        return self._observation()

    def render(self) -> tuple[Any, ...] | None:
        """Frames (height, width, 3) of all environments, or None without a render mode."""
        if self.render_mode is None:
            return None
        return self._pictures().frames(self.batch)

    def close_extras(self, **kwargs: Any) -> None:
        """End the drawing process, where there is one."""
        self._end_pictures()


def _step_limit(limit: Any) -> int | None:
    """Return a limit of the caller's, None where there is none but the task's own."""
    if limit is None or isinstance(limit, Deadline):
        return None
    if isinstance(limit, (int, np.integer)) and limit == -1:
        return None
    return integer(limit, "max_episode_steps", 1)


def _mask(raw_mask: Any, n: int) -> Mask:
    mask = np.asarray(raw_mask)
    if mask.shape != (n,) or mask.dtype != bool:
        raise gym.error.Error(f"reset_mask must be {n} truth values, got {raw_mask!r}")
    return mask


def fan_out(model: Batch, source: Batch, i: int) -> None:
    """Put every simulation of `model` where simulation i of `source` is.

    A model of the same task takes over everything, what was drawn and the random generator
    included: it goes on as the source would. A model of another description
    (mode, vehicle, effects, errors) takes over what a controller can know: joints, reference,
    goal, sums of the episode, and the base as it is *measured*; internal modes are carried
    along by the base, and the sensors and the platform of an emulated model start anew.

    Args:
        model: of any number of simulations; written.
        source: read.
        i: which of its simulations.

    Raises:
        ParameterError: no such simulation, or a model of another kind of task, control,
            duration, control period or number of joints; the model is as it was then.
    """
    if not 0 <= i < source.n:
        raise ParameterError(f"fan_out needs an environment of 0 to {source.n - 1}, got {i}")
    if model.task == source.task:
        task, state, snapshot, _ = source.get_state()
        scene, episodes, drawn = state
        parts = _rows(scene, i, model.n), _rows(episodes, i, model.n), _rows(drawn, i, model.n)
        recorded = None if model.recorder is None else model.recorder.get_state()
        model.set_state((task, parts, snapshot.fanned_out(i, model.n), recorded))
        return
    for name, ours, theirs in (
        ("task", model.task.kind, source.task.kind),
        ("control", model.task.control, source.task.control),
        ("duration", model.task.duration, source.task.duration),
        ("control period", model.dt, source.dt),
        ("joints", model.system.arm.n, source.system.arm.n),
    ):
        if ours != theirs:
            raise ParameterError(
                f"fan_out needs a model of the same {name}, {theirs!r}, got {ours!r}"
            )
    scene, episodes = (_rows(k, i, model.n) for k in (source.scene, source.episodes))
    model.begin_at(scene, episodes)


def _rows(part: Any, i: int, n: int) -> Any:
    """Row i of every array of a dataclass or dictionary, n times."""
    if isinstance(part, dict):
        return {name: _repeated(k, i, n) for name, k in part.items()}
    fields = (f.name for f in dataclasses.fields(part))
    return dataclasses.replace(
        part, **{name: _repeated(getattr(part, name), i, n) for name in fields}
    )


def _repeated(array: Any, i: int, n: int) -> Array:
    return np.repeat(array[i : i + 1], n, axis=0)
