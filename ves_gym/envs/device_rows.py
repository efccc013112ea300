"""Rows of n episodes in the memory of a device, and the kernels of a control period."""

from __future__ import annotations

import contextlib
from functools import cached_property
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.engine.backends.gpu_kernel import KINDS
from ves_gym.engine.backends.kernel import stepper
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.maps import inertia_function
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.engine.kernel.scene import scene_function, torque_function
from ves_gym.engine.kernel.warp_code import launch, launch_graph
from ves_gym.envs import compiled
from ves_gym.envs.batch import Batch
from ves_gym.envs.compiled import Shape, width
from ves_gym.envs.tail import by_doubling


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
            servo = control.servo_for(self.system.arm)
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
        x, goal, reference, tau, outputs = (
            rows[k] for k in ("x", "goal", "reference", "tau", "outputs")
        )
        z, zd = x[:size], x[shape.coordinates : shape.coordinates + size]
        nothing, everyone = self.simulations.nothing, self.simulations.everyone

        def run(name: str, *arrays: Any) -> Any:
            kernel = functions[name].gpu(self.real)
            return launch_graph(kernel, list(arrays), self.device, record=True)

        def run_map(function: CompiledFunction, shared: int, *arrays: Any) -> Any:
            kernel = function.gpu(self.real, (shared,))
            return launch_graph(kernel, list(arrays), self.device, record=True)

        out = [run("move", z, zd, before, goal, rows["action"], reference)]
        if shape.feedforward:
            ref = reference[shape.reference["ref"]]
            out.append(
                run_map(torque_function(space), 1, ref, rows["described"], rows["extra"])
            )
        started = before[shape.carry["tau"]]
        out.append(
            run("follow", started, reference, rows["extra"], rows["nodes"], tau, rows["gains"])
        )
        system = self.system.actual
        state = [x, rows["nodes"], self.simulations.p, nothing, everyone]
        inputs = [*state, self.simulations.fault, system.substeps, 1, system.physics_dt]
        advance = stepper(system).gpu_steps(self.real, record=False)
        out.append(launch(advance, self.n, inputs, self.device, record=True))
        seen = [z, zd, x[:6], *(x[k] for k in self._modes)]
        out.append(
            run_map(
                scene_function(space), len(seen), *seen, rows["described"], rows["scene_rows"]
            )
        )
        parts = [
            z,
            zd,
            x,
            before,
            reference,
            tau,
            goal,
            rows["inputs"],
            rows["scene_rows"],
            outputs,
            after,
        ]
        out.append(run("close", *parts))
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
        """(told, n) of the last period."""
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
            kept = torch.where(diverged, 0.0, self._tail(ids))
            tail[ids] = kept
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
        kernel = inertia_function(system).gpu("float64", (1,))
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
        matrices = self._space.base.full()
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
