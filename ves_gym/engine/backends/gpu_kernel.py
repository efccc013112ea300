"""The compiled equations on a GPU, one simulation a thread. Optional: `ves-gym[gpu]`.

The same graph, and so the same answers, as the kernel's (`engine.kernel.scalar`): every system
that it simulates, in double precision, or in single. Without a GPU it runs on Warp's CPU
device, one simulation after the other.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, Mask
from ves_gym.engine.backends.base import BackendWarning
from ves_gym.engine.backends.compiled import CompiledBackend
from ves_gym.engine.backends.kernel import stepper
from ves_gym.engine.kernel.warp_code import launch, load_warp
from ves_gym.system.system import System


class DeviceSimulations:
    """States and parameters of n simulations in the memory of a device.

    Args:
        nx: rows of state.
        n: number of simulations.
        real: float64 or float32.
        device: of Warp, None for its current one: the first GPU, or the CPU.
    """

    def __init__(self, nx: int, n: int, real: str, device: Any = None) -> None:
        self.wp = wp = load_warp()
        self.device = wp.get_device(device)
        self.number = getattr(wp, real)
        self.x = self.array(np.zeros((nx, n)))  # changed in place
        self.p = self.array(np.zeros((1, 1)))  # (np, n), or (np, 1) for all alike
        self.fault = wp.zeros(n, dtype=wp.int32, device=self.device)
        self.everyone = wp.full(n, 1, dtype=wp.int32, device=self.device)
        self.nothing = wp.zeros((0, n), dtype=self.number, device=self.device)

    def array(self, values: Array) -> Any:
        """Numbers on the device, in the precision of the simulations."""
        return self.wp.array(values, dtype=self.number, device=self.device)

    def set_parameters(self, p: Array, alike: bool = True) -> None:
        """Set the parameters.

        Args:
            p: (np, n).
            alike: one column stands for all where all are alike.
        """
        self.p = self.array(p[:, :1] if alike and (p == p[:, :1]).all() else p)


class GpuKernelBackend(CompiledBackend):
    """`Backend` on a GPU; see `Backend` for what each method does.

    NumPy arrays go in and come out, so every call copies them. `envs.device` leaves them
    where they are.
    """

    name = "gpu-kernel"
    real = "float64"
    state_names = ("_u", "_start", "_ticks")

    def __init__(self, system: System, n: int, threads: int, device: Any = None) -> None:
        super().__init__(system, n)
        self.simulations = DeviceSimulations(self._nx, n, self.real, device)
        self._system = system
        if device is None and not self.simulations.device.is_cuda:
            warnings.warn(
                f"backend {self.name} finds no GPU and runs on Warp's CPU device, one"
                " simulation after the other: backend kernel is faster there",
                BackendWarning,
                stacklevel=4,
            )
        self._p = np.tile(self.rows.values[:, None], (1, n))
        self._loaded = False  # the device has these parameters
        self._u = np.zeros((n, self._nu))
        self._start, self._ticks = np.zeros(n), np.zeros(n, np.int64)

    # ---------------------------------------------------------------- device

    @property
    def parameters(self) -> Array:
        """(np, n) of the simulations, as `names` says."""
        return self._p

    def _states(self) -> Array:
        return np.array(self.simulations.x.numpy().T, np.float64)

    def _put(self, ids: Index, columns: slice, values: Array) -> None:
        x = self._states()
        x[ids, columns] = values
        self.simulations.x.assign(np.ascontiguousarray(x.T).astype(self.real))

    def advance(
        self, u: Any, steps: int, ids: Index | None = None, record: bool = False
    ) -> Any:
        """Take physics steps, all of them in one launch.

        Args:
            u: ((nodes nu), n) on the device; see `scalar.advance_text`.
            steps: how many.
            ids: simulations that move, None for all.
            record: return what is observed.

        Returns:
            ((steps + 1) ny, n) on the device, or without rows.
        """
        sims, wp = self.simulations, self.simulations.wp
        active, out = sims.everyone, sims.nothing
        if ids is not None:
            flags = np.zeros(self.n, np.int32)
            flags[ids] = 1
            active = wp.array(flags, dtype=wp.int32, device=sims.device)
        if record:
            shape = ((steps + 1) * self._ny, self.n)
            out = wp.empty(shape, dtype=sims.number, device=sims.device)
        kernel = stepper(self._system).gpu_steps(self.real, record)
        parts = [sims.x, u, sims.p, out, active, sims.fault, steps, self.dt]
        launch(kernel, self.n, parts, sims.device)
        return out

    def _run(self, nodes: Array, steps: int, ids: Index | None, record: bool = False) -> Array:
        """Advance; nodes (n, k, nu) of the commands. Outputs (n, steps + 1, ny), or none."""
        if not self._loaded:
            self.simulations.set_parameters(self._p)
            self._loaded = True
        u = self.simulations.array(np.moveaxis(nodes, 0, 2).reshape(-1, self.n))
        outputs = self.advance(u, steps, ids, record).numpy()
        self._ticks[slice(None) if ids is None else ids] += steps
        return np.array(np.moveaxis(outputs.reshape(-1, self._ny, self.n), 2, 0), np.float64)

    # --------------------------------------------------------------- backend

    def write(self, ids: Index, time: Array, z: Array, zd: Array) -> None:
        self._put(ids, slice(None), self.states_of(ids, z, zd))
        fault = self.simulations.fault.numpy().copy()
        fault[ids] = 0
        self.simulations.fault.assign(fault)
        self._u[ids] = 0.0  # no acceleration of a platform either
        self._start[ids], self._ticks[ids] = time, 0

    def _set_parameter(self, at: int, ids: Index, values: Array) -> None:
        self._p[at, ids] = values
        self._loaded = False

    def _parameters(self) -> Array:
        return self._p.T.copy()

    def _row(self, i: int) -> Array:
        return self._p[:, i]

    def assign(self, ids: Index, systems: Sequence[System]) -> None:
        super().assign(ids, systems)
        self._loaded = False

    def step_sequence(self, commands: Array, ids: Index | None) -> None:
        nodes = np.concatenate([np.zeros((*commands.shape[:2], 6)), commands], axis=-1)
        self._run(nodes, commands.shape[1] - 1, ids)
        self._u = nodes[:, -1].copy()

    def step_on_platform(self, commands: Array, base: Array, ids: Index | None) -> Array:
        nodes = np.concatenate([base, commands], axis=-1)
        outputs = self._run(nodes, commands.shape[1] - 1, ids, record=True)
        self._u = nodes[:, -1].copy()
        return np.ascontiguousarray(outputs[..., -6:])

    def evaluate(self, command: Array) -> tuple[Array, Array]:
        self._u[:, 6:] = command
        outputs = self._run(self._u[:, None], 0, None, record=True)
        return self._accelerations(outputs[:, 0])

    def faults(self) -> Mask:
        bad: Mask = self.simulations.fault.numpy() != 0
        return bad

    def get_state(self) -> dict[str, Array]:
        fault = self.simulations.fault.numpy().copy()
        return super().get_state() | {"x": self._states(), "fault": fault}

    def set_state(self, state: Mapping[str, Array]) -> None:
        super().set_state(state)
        self._put(np.arange(self.n), slice(None), state["x"])
        self.simulations.fault.assign(state["fault"])


class GpuKernelSingleBackend(GpuKernelBackend):
    """The same in single precision."""

    name = "gpu-kernel-float32"
    real = "float32"


KINDS = {"float64": GpuKernelBackend, "float32": GpuKernelSingleBackend}
