"""`DeviceVectorEnv`: n episodes in the memory of a GPU, from action to reward without the host.

Needs torch and Warp (`ves-gym[gpu]`). State, observation and reward are Warp arrays that torch
sees without a copy; physics, reference, observation and reward run as kernels made of the very
graphs that the CPU compiles (`envs/compiled.py`), captured as one CUDA graph on a GPU.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.kernel.scalar import REALS
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task, require_keywords
from ves_gym.envs.compiled import Shape
from ves_gym.envs.device_rows import DeviceRows
from ves_gym.envs.episode import outcome
from ves_gym.envs.spaces import observation_space, require_seed
from ves_gym.envs.task import Task

_STARTS = 65_536  # beginnings of episodes that are drawn beforehand


class DeviceVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """n episodes of an ideal task on a device; arrays in and out are torch tensors there.

    Every episode that ends begins anew in the same step (autoreset mode SameStep): what it
    ended with is in `info["final_obs"]`, rows of others are what they are anyway.

    Beginnings are drawn on the host when the environment is seeded, those of the first
    `starts` episodes of every simulation, the same as `VesVectorEnv`'s, and stay on the
    device; after them simulation i takes the beginnings of i + 1, and so on.

    Args:
        num_envs: how many.
        task: name, "package.module:Class" or `Task`.
        precision: float64 or float32, of everything but observations (float32).
        device: of torch, "cuda:0" or "cpu"; None: the first GPU, or the CPU without one.
        starts: episodes per simulation with beginnings of their own; None: enough for
            65,536 beginnings in all.
        settings: see `build_task`.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        task: str | Task = "rest_to_rest",
        *,
        precision: str = "float64",
        device: str | None = None,
        starts: int | None = None,
        **settings: Any,
    ) -> None:
        require("DeviceVectorEnv", "torch", "warp")
        require_keywords(type(self), task, settings)
        if precision not in REALS:
            raise ParameterError(f"precision must be {' or '.join(REALS)}, got {precision!r}")
        for name, value in (
            ("num_envs", num_envs),
            ("starts", 1 if starts is None else starts),
        ):
            complete = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
            if not complete or value < 1:
                raise ParameterError(f"{name} must be a whole number >= 1, got {value!r}")
        self.task, self.num_envs = build_task(task, **settings), num_envs
        self._batch = Batch(self.task, num_envs)  # draws beginnings, and names the rows
        self.shape = _shape(self._batch)
        self.starts = max(1, -(-_STARTS // num_envs)) if starts is None else starts
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (self._batch.width,), np.float32)
        self.single_observation_space = observation_space(self.task)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.rows = DeviceRows(self._batch, self.shape, precision, device)
        self.device = self.rows.torch_device
        self._tables: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin the first episodes of a seed, or those after the present ones.

        Args:
            seed: root of the simulations' sequences of episodes, as `VesVectorEnv`'s; None: the
                present one, at the first reset a random one.
            options: none are known.
        """
        if options:
            raise ParameterError(f"DeviceVectorEnv.reset has no options, got {options!r}")
        torch = self.rows.torch
        if seed is None and self._tables is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if seed is not None:
            require_seed(seed)
            self._tables = self._draw(seed)
            self._number = torch.full((self.num_envs,), -1, device=self.device)
            self._row = torch.zeros_like(self._number)  # of the tables
        everyone = torch.arange(self.num_envs, device=self.device)
        observation = torch.empty((self.num_envs, self._batch.observations), device=self.device)
        self._begin(everyone, observation)
        return observation, {}

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """One control period.

        Args:
            actions: (n, width) on the device; beyond [-1, 1] they are clipped.

        Returns:
            observation (n, observations), reward (n,), terminated (n,), truncated (n,), info
            with `success`, the reward's terms and, where episodes ended, `final_obs`,
            `_final_obs`, `energy/E_mean`, `_energy/E_mean`.
        """
        if self._tables is None:
            raise gym.error.ResetNeeded("call reset before step")
        rows, task, outputs = self.rows, self.task, self.shape.outputs
        with rows.on_stream():
            if self.shape.table_values:
                rows.look_up(self._tables["table_values"], self._row)
            rows.move(actions)
            latest = rows.outputs_now
            ended = (latest[outputs["last"]] + latest[outputs["failed"]])[0] > 0
            ids = ended.nonzero()[:, 0]  # the one number that the host waits for: how many
            info: dict[str, Any] = {}
            if len(ids):
                info |= rows.close_episodes(ids, ended)
                latest = rows.outputs_now
            last, failed, success = (
                latest[outputs[k]][0] > 0 for k in ("last", "failed", "solved")
            )
            terminated, truncated = outcome(task, last, failed)
            reward = latest[outputs["reward"]][0].clone()
            for name in self.shape.terms:
                info[f"reward/{name}"] = latest[outputs[f"reward/{name}"]][0].clone()
            info["success"] = success
            observation = latest[outputs["observation"]].T.float().contiguous()
            rows.turn()
            if len(ids):
                info["final_obs"], info["_final_obs"] = observation.clone(), ended
                self._begin(ids, observation)
        return observation, reward, terminated, truncated, info

    def _begin(self, ids: Any, observation: Any) -> None:
        """Start the next episode of simulations (k,), and write their observations."""
        self._number[ids] += 1
        number = self._number[ids]
        shifted = (ids + number // self.starts) % self.num_envs
        at = (number % self.starts) * self.num_envs + shifted
        self._row[ids] = at
        rows = {k: self._tables[k][at].T for k in ("x", "carry", "goal")}
        self.rows.begin(ids, rows)
        observation[ids] = self._tables["observation"][at].float()

    def _draw(self, seed: int) -> dict[str, Any]:
        """Tables (starts n, ...) of the beginnings: state, carry, goal, observation."""
        batch, everyone = self._batch, np.arange(self.num_envs)
        batch.seed(everyone, seed, everyone)
        parts: dict[str, list[Array]] = {}
        for _ in range(self.starts):
            batch.reset(everyone)
            for name, values in self.rows.beginnings(batch).items():
                parts.setdefault(name, []).append(values)
        return {k: self.rows.tensor(np.concatenate(v)) for k, v in parts.items()}


def _shape(batch: Batch) -> Shape:
    """The rows of a task that a device can run.

    Raises:
        ParameterError: it cannot, and why.
    """
    task, what = batch.task, f"DeviceVectorEnv of task {batch.task.kind}"
    if task.system.mode != "ideal":
        raise ParameterError(
            f"{what} needs mode ideal, got {task.system.mode}: the laboratory runs on the CPU,"
            " use VesVectorEnv"
        )
    if task.randomize:
        raise ParameterError(f"{what} has no randomised effects yet: use VesVectorEnv")
    if batch.sim.joint_delays is not None:
        raise ParameterError(f"{what} has no delays of the joints: use VesVectorEnv")
    shape = batch.shape
    if shape is None:
        raise ParameterError(
            f"{what} needs a task and a control that compile (`Task.compiled`), and the kernel:"
            " use VesVectorEnv"
        )
    return shape
