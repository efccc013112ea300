"""The compiled kernel against MuJoCo: ratios of physics, of the Simulator, and compile time."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

import numpy as np

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.backends.mujoco import MujocoBackend
from ves_gym.engine.kernel.sensitivity import rollout_gradients
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

PERIODS = 20
RUNS = 15


def bare_physics(n: int, threads: int) -> Pair:
    """PERIODS control periods of n simulations without anything around the engines."""
    system = System()
    ours, theirs = (kind(system, n, threads) for kind in (KernelBackend, MujocoBackend))
    start = np.random.default_rng(0).uniform(-0.1, 0.1, (4, n, 6))
    for engine in (ours, theirs):
        z, zd = (
            np.hstack([0.1 * start[0], start[1, :, :3]]),
            np.hstack([start[2], start[3, :, :3]]),
        )
        engine.write(np.arange(n), np.zeros(n), z, zd)
        engine.set_gains(np.arange(n), np.full((n, 3), 1000.0), np.full((n, 3), 30.0))

    def kernel() -> None:
        for _ in range(PERIODS):
            ours._run(ours._u, system.substeps, ours._nu, 0, None)

    def mujoco() -> None:
        for _ in range(PERIODS):
            theirs.batch.step(nstep=system.substeps)

    return side_by_side(kernel, mujoco, RUNS)


def simulator(n: int, system: System | None = None) -> Pair:
    """PERIODS calls of `Simulator.step` with the arm held."""
    system = system or System()

    def run(backend: str):
        sim = Simulator(system, n, backend=backend, warn_at=None)
        hold = sim.servo_command(0 * sim.state.q, 0 * sim.state.v)

        def go() -> None:
            for _ in range(PERIODS):
                sim.step(hold)

        return go

    return side_by_side(run("kernel"), run("mujoco"), RUNS)


def emulated(n: int) -> Pair:
    """The same in the laboratory, whose own arithmetic is NumPy with either engine."""
    return simulator(n, System(mode="emulated"))


_FIRST = """
import time
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System
begin = time.perf_counter()
Simulator(System(), backend="mujoco")
middle = time.perf_counter()
Simulator(System(), backend="kernel")
print(middle - begin, time.perf_counter() - middle)
"""


def first_simulator(runs: int = 3) -> dict[str, float]:
    """Seconds a new process needs for its first kernel: compiled, and from the cache.

    MuJoCo's model is built before, so that imports the engines share are not counted.
    """
    times: dict[str, list[float]] = {"cold": [], "cached": []}
    for _ in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            for kind in times:
                done = subprocess.run(
                    [sys.executable, "-c", _FIRST],
                    env={**os.environ, "VES_GYM_CACHE": folder},
                    capture_output=True,
                    text=True,
                    check=True,
                )
                times[kind].append(float(done.stdout.split()[1]))
    return {kind: float(np.median(values)) for kind, values in times.items()}


_NAMES = (
    *("K11", "K22", "link2.mass", "D55", "link3.com1", "base.mass", "M33", "kp1"),
    *("K33", "K44", "K55", "K66", "link1.mass", "link2.com1", "kd1", "D11"),
)


def sensitivities(p: int) -> float:
    """Rollouts that one with the derivatives along p parameters costs, 64 runs of 1 s."""
    system = System()
    sim = Simulator(system, 64)
    hold = np.tile(sim.servo_command(0 * sim.state.q, 0 * sim.state.v)[:, None], (1, 801, 1))
    names = _NAMES[:p]
    pair = side_by_side(
        lambda: rollout_gradients(system, hold, wrt=names),
        lambda: rollout_gradients(system, hold),
        RUNS,
    )
    return 1 / pair.ratio


def steps_per_second(n: int, seconds: float) -> float:
    """Physics steps per second of all simulations together."""
    return n * PERIODS * System().substeps / seconds


if __name__ == "__main__":
    for count, threads in ((256, 1), (256, 2), (1, 1)):
        print("bare", count, threads, bare_physics(count, threads))
    for count in (1, 256):
        print("Simulator", count, simulator(count))
    print("emulated", 256, emulated(256))
    print(first_simulator())
    print("sensitivities", [sensitivities(p) for p in (1, 8, 16)])
