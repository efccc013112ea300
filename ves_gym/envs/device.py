"""`DeviceVectorEnv`: n episodes in the memory of a GPU, from action to reward without the host.

Needs torch and Warp (`ves-gym[gpu]`). State, observation and reward are Warp arrays that torch
sees without a copy; physics, reference, observation and reward run as kernels made of the very
graphs that the CPU compiles (`envs/compiled.py`), captured as one CUDA graph on a GPU.
"""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, integer
from ves_gym.engine.backends.gpu_kernel import KINDS
from ves_gym.engine.backends.kernel import stepper
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.maps import scene_function, system_function, torque_function
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.engine.kernel.scalar import REALS
from ves_gym.engine.kernel.warp_code import launch, launch_graph
from ves_gym.envs import compiled
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task, require_keywords
from ves_gym.envs.compiled import Shape, width
from ves_gym.envs.signals import observation_space, require_seed
from ves_gym.envs.tail import by_doubling
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
        task: registered name, class or `Task`.
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
            integer(value, name, 1)
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
        rows, outputs = self.rows, self.shape.outputs
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
            terminated = last | failed
            truncated = last & ~last
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
    if task.interacts or task.base_control is not None or task.system.contact is not None:
        raise ParameterError(
            f"{what} has no payloads, contact, wheels or jets: use VesVectorEnv"
        )
    if batch.sim.joint_delays is not None:
        raise ParameterError(f"{what} has no delays of the joints: use VesVectorEnv")
    if batch.sim.gravity_gradient is not None:
        raise ParameterError(f"{what} has no gravity gradient: use VesVectorEnv")
    shape = batch.shape
    if shape is None:
        raise ParameterError(
            f"{what} needs a task and a control that compile (`Task.compiled`), and the kernel:"
            " use VesVectorEnv"
        )
    return shape


class DeviceRows:
    """State, reference, observation and reward of n episodes, (k, n) each.

    The carry exists twice, as it was before the period and as it is after it; they change
    places in every period, so there are two lists of launches.

    Args:
        batch: of the same task and n, on the CPU.
        shape: of its rows.
        real: float64 or float32.
        device: of Warp; None: its current one.
    """

    def __init__(self, batch: Batch, shape: Shape, real: str, device: str | None) -> None:
        import torch

        self.torch, self.shape, self.n, self.real = torch, shape, batch.n, real
        self.system, self.task = batch.system, batch.task
        self.backend = KINDS[real](self.system.actual, batch.n, 0, device)
        self.simulations = self.backend.simulations
        self.wp, self.device = self.simulations.wp, self.simulations.device
        self.torch_device = torch.device(self.wp.device_to_torch(self.device))
        self._space = self.system.ideal()
        joints, control = shape.joints, self.task.control
        if self.system.drive == "motor":
            servo = control.servo_for(self.system)
            kp, kd = (np.tile(k, (self.n, 1)) for k in (servo.kp, servo.kd))
            self.backend.set_gains(np.arange(self.n), kp, kd)
        gained = control.level == "gains"
        self.simulations.set_parameters(self.backend.parameters, alike=not gained)
        first, p = self.backend.names.index("kp1"), self.simulations.p
        sizes = {
            "goal": shape.goal, "action": batch.width, "reference": width(shape.reference),
            "inputs": width(shape.inputs), "outputs": width(shape.outputs), "tau": joints,
            "extra": joints, "nodes": shape.nodes * (6 + joints), "scene_rows": 8,
        }  # fmt: skip
        rows = {name: self._zeros(size) for name, size in sizes.items()}
        rows["gains"] = p[first : first + 2 * joints] if gained else self._zeros(2 * joints)
        rows["x"] = self.simulations.x
        # the engine runs arm and vehicle as they are, energies go by the description
        rows["described"] = self.simulations.array(parameters(self._space)[1][:, None])
        carries = [self._zeros(width(shape.carry)) for _ in range(2)]
        self._programs = [self._program(rows, *k) for k in (carries, carries[::-1])]
        self._arrays = rows, carries  # addresses do not keep memory alive
        self._views = {name: self.view(array) for name, array in rows.items()}
        self._carries = [self.view(k) for k in carries]
        self._fault = self.view(self.simulations.fault)
        self._parity = 0
        self._graphs = self._captured() if self.device.is_cuda else []

    def _zeros(self, size: int) -> Any:
        return self.simulations.array(np.zeros((max(size, 1), self.n)))

    def _program(self, rows: dict[str, Any], before: Any, after: Any) -> list[Any]:
        """Launches of a period, from the carry before it to that after it."""
        shape, space, size = self.shape, self._space, 6 + self.shape.joints
        functions = compiled.functions(shape)
        names = ("x", "goal", "reference", "tau", "outputs")
        x, goal, reference, tau, outputs = (rows[k] for k in names)
        z, zd = x[:size], x[shape.coordinates : shape.coordinates + size]
        both = x[: 2 * shape.coordinates]
        nothing, everyone = self.simulations.nothing, self.simulations.everyone

        def run(function: CompiledFunction, *arrays: Any, shared: int | None = None) -> Any:
            kernel = function.gpu(self.real, () if shared is None else (shared,))
            return launch_graph(kernel, list(arrays), self.device, record=True)

        extra, nodes, described = rows["extra"], rows["nodes"], rows["described"]
        out = [run(functions["move"], z, zd, before, goal, rows["action"], reference)]
        if shape.feedforward:
            ref = reference[shape.reference["ref"]]
            out.append(run(torque_function(space), ref, described, extra, shared=1))
        started = before[shape.carry["tau"]]
        follow = started, reference, extra, nodes, tau, rows["gains"]
        out.append(run(functions["follow"], *follow))
        system = self.system.actual
        state = [x, nodes, self.simulations.p, nothing, everyone]
        inputs = [*state, self.simulations.fault, system.substeps, system.physics_dt]
        advance = stepper(system).gpu_steps(self.real, record=False)
        out.append(launch(advance, self.n, inputs, self.device, record=True))
        observed = [z, zd, x[:6], *(x[k] for k in self._modes), described, rows["scene_rows"]]
        out.append(run(scene_function(space), *observed, shared=len(observed) - 2))
        close = z, zd, both, before, reference, tau, goal, rows["inputs"], rows["scene_rows"]
        out.append(run(functions["close"], *close, outputs, after))
        return out

    @property
    def _modes(self) -> list[slice]:
        """Rows of the state: internal modes of the base as described, and their rates."""
        m = self._space.base.hidden
        first = 6 + self.shape.joints + len(self.system.actual.arm.geared)
        return [slice(k, k + m) for k in (first, self.shape.coordinates + first) if m]

    def _captured(self) -> list[Any]:
        """Both programs as CUDA graphs; the stream of torch's default cannot capture any."""
        graphs, stream = [], self.wp.Stream(self.device)
        with self.wp.ScopedStream(stream):
            for program in self._programs:
                with self.wp.ScopedCapture(stream=stream) as capture:
                    for command in program:
                        command.launch()
                graphs.append(capture.graph)
        self.wp.synchronize_device(self.device)
        return graphs

    def view(self, array: Any) -> Any:
        """A Warp array as a tensor of the same memory."""
        return self.wp.to_torch(array)

    def tensor(self, values: Array) -> Any:
        """Numbers on the device, in the precision of the rows."""
        kind = getattr(self.torch, self.real)
        return self.torch.as_tensor(
            np.ascontiguousarray(values), dtype=kind, device=self.torch_device
        )

    def on_stream(self) -> Any:
        """Warp works on torch's stream, so that neither waits for the other."""
        if not self.device.is_cuda:
            return contextlib.nullcontext()
        stream = self.torch.cuda.current_stream(self.torch_device)
        return self.wp.ScopedStream(self.wp.stream_from_torch(stream), sync_enter=False)

    @property
    def outputs_now(self) -> Any:
        """Return the outputs (k, n) of the last period."""
        return self._views["outputs"]

    def look_up(self, table: Any, rows: Any) -> None:
        """Give the formulas what `Task.lookup` finds for the end of the coming period.

        Args:
            table: (r, periods + 1, k) values of all beginnings.
            rows: (n,) of the present ones.
        """
        steps = self._carries[self._parity][self.shape.carry["steps"]][0].round().long() + 1
        table_values = table[rows, steps.clamp(max=table.shape[1] - 1)]
        self._views["inputs"][self.shape.inputs["table_values"]] = table_values.T

    def move(self, actions: Any) -> None:
        """Run one period."""
        shape = (self.n, self._views["action"].shape[0])
        if tuple(actions.shape) != shape:
            raise ParameterError(f"actions must have shape {shape}, got {tuple(actions.shape)}")
        self._views["action"].copy_(actions.T)
        if self._graphs:
            self.wp.capture_launch(self._graphs[self._parity])
            return
        for command in self._programs[self._parity]:
            command.launch()

    def turn(self) -> None:
        """Take the state after this period for the one before the next."""
        self._parity = 1 - self._parity

    @property
    def after(self) -> Any:
        """(carry, n) as the period leaves it; before `turn`."""
        return self._carries[1 - self._parity]

    def close_episodes(self, ids: Any, ended: Any) -> dict[str, Any]:
        """Reward the energy that the base keeps after episodes (k,); what they took of it."""
        torch, task, shape = self.torch, self.task, self.shape
        tail = torch.zeros(self.n, dtype=torch.float64, device=self.torch_device)
        if task.tail:
            diverged = self.outputs_now[shape.outputs["diverged"]][0, ids] > 0
            finite = torch.where(diverged, 0.0, self._tail(ids))
            tail[ids] = finite
            column = self._views["inputs"][shape.inputs["tail"]]
            column[0] = tail
            self._programs[self._parity][-1].launch()  # the reward again
            column[0] = 0.0
        sums, steps = (self.after[shape.carry[k]][0].double() for k in ("sums", "steps"))
        mean = (sums + tail) / (steps * self.system.control_dt + task.tail)
        return {"energy/E_mean": mean, "_energy/E_mean": ended}

    def _tail(self, ids: Any) -> Any:
        """(k,) time integral of E over the tail [J s] (`tail.by_doubling`)."""
        torch, shape, system = self.torch, self.shape, self._space
        n, size = shape.joints, 6 + shape.joints
        x = self._views["x"][:, ids].double()
        reference = self._views["reference"][:, ids].double()
        q, ref = x[6:size], reference[shape.reference["ref"]][:n]
        away = 0 * q if self.task.control.level == "torque" else q - ref
        rate = x[shape.coordinates : shape.coordinates + size]
        u, ud = (x[k] for k in self._modes) if self._modes else (x[:0], x[:0])
        state = torch.concatenate([x[:6], u, away, rate[:6], ud, rate[6:]]).T
        kp, kd = (reference[shape.reference[k]].T.contiguous() for k in ("kp", "kd"))
        constants = self._constants
        entries = torch.empty((size * size, len(ids)), dtype=q.dtype, device=q.device)
        kernel = system_function("inertia_matrix", system).gpu("float64", (1,))
        arrays = [self.wp.from_torch(k.contiguous()) for k in (q, constants[0], entries)]
        launch_graph(kernel, arrays, self.device)
        M, D, K, eye = constants[1:]
        b = len(M)
        H = torch.zeros((len(ids), b + n, b + n), dtype=q.dtype, device=q.device)
        at = torch.tensor([*range(6), *range(b, b + n)], device=q.device)
        H[:, at[:, None], at] = entries.T.reshape(len(ids), size, size)
        H[:, :b, :b] += M
        locked = system.drive == "prescribed"
        total, _ = by_doubling(
            H, K, D, state, kp, kd, eye, seconds=self.task.tail, locked=locked
        )
        return total

    @cached_property
    def _constants(self) -> list[Any]:
        """Numbers of the arm, M, D, K of the base and an identity, in double precision."""
        matrices = self._space.base.locked().full()
        numbers = parameters(self._space)[1][:, None]
        parts = numbers, *matrices, np.eye(2 * (len(matrices[0]) + self.shape.joints))
        kind, device = self.torch.float64, self.torch_device
        return [self.torch.tensor(k, dtype=kind, device=device) for k in parts]

    # ------------------------------------------------------------------ beginnings

    def beginnings(self, batch: Batch) -> dict[str, Array]:
        """State, carry, goal and observation (n, ...) of a batch that has been reset."""
        s, e, n = batch.scene, batch.episodes, self.n
        state = np.hstack([s.y, s.q]), np.hstack([s.yd, s.v])
        tables = {
            "x": self.backend.states_of(np.arange(n), *state),
            "carry": compiled.carry_rows(self.shape, s, e),
            "goal": s.goal.copy() if self.shape.goal else np.zeros((n, 1)),
            "observation": np.asarray(batch.observe(), float),
        }
        if self.shape.table_values:
            steps = (np.full(n, k) for k in range(self.task.steps + 1))
            table_values = np.stack([self.task.lookup(s.goal, k) for k in steps], axis=1)
            tables["table_values"] = table_values.astype(self.real)
        return tables

    def begin(self, ids: Any, rows: dict[str, Any]) -> None:
        """Put simulations (k,) at the beginnings of episodes, the columns of `rows`."""
        self._views["x"][:, ids], self._views["goal"][:, ids] = rows["x"], rows["goal"]
        self._carries[self._parity][:, ids] = rows["carry"]
        self._fault[ids] = 0
