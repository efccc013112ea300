"""The compiled kernel against MuJoCo: ratios of physics, of the Simulator, and compile time."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from dataclasses import asdict

import numpy as np

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.engine.backends.mujoco import MujocoBackend
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.engine.kernel.sensitivity import rollout_gradients
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

PERIODS = 20
RUNS = 15


def bare_physics(n: int, threads: int, runs: int = RUNS) -> Pair:
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

    pieces = ours.pieces(ours._u, 1, system.substeps)

    def kernel() -> None:
        for _ in range(PERIODS):
            ours._run(pieces, system.substeps)

    def mujoco() -> None:
        for _ in range(PERIODS):
            theirs.batch.step(nstep=system.substeps)

    return side_by_side(kernel, mujoco, runs)


def simulator(n: int, system: System | None = None, runs: int = RUNS) -> Pair:
    """PERIODS calls of `Simulator.step` with the arm held."""
    system = system or System()

    def run(backend: str):
        sim = Simulator(system, n, backend=backend, warn_at=None)
        hold = sim.servo_command(0 * sim.state.q, 0 * sim.state.v)

        def go() -> None:
            for _ in range(PERIODS):
                sim.step(hold)

        return go

    return side_by_side(run("kernel"), run("mujoco"), runs)


def emulated(n: int, runs: int = RUNS) -> Pair:
    """The same in the laboratory, whose own arithmetic is NumPy with MuJoCo."""
    return simulator(n, System(mode="emulated"), runs)


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


def sensitivities(p: int, n: int = 64, steps: int = 800, runs: int = RUNS) -> float:
    """Rollouts that one with the derivatives along p parameters costs, n runs of some steps."""
    system = System()
    sim = Simulator(system, n)
    hold = sim.servo_command(0 * sim.state.q, 0 * sim.state.v)
    hold = np.tile(hold[:, None], (1, steps + 1, 1))
    known, _ = parameters(system)
    names = known[:: len(known) // p][:p]
    pair = side_by_side(
        lambda: rollout_gradients(system, hold, wrt=names),
        lambda: rollout_gradients(system, hold),
        runs,
    )
    return 1 / pair.ratio


def steps_per_second(n: int, seconds: float) -> float:
    """Physics steps per second of all simulations together."""
    return n * PERIODS * System().substeps / seconds


def report(small: bool = False) -> dict[str, object]:
    """Print and return the figures; `small`: just enough to see that they can be had."""
    out: dict[str, object] = {}
    runs, many = (1, 2) if small else (RUNS, 256)
    for n, threads in ((many, 1), (many, 2)):
        pair = bare_physics(n, threads, runs)
        out[f"n{n}_threads{threads}"] = asdict(pair)
        print(
            f"kernel n = {n:<4}   {pair.ratio:5.1f} x bare batch physics of MuJoCo,"
            f" {threads} thread(s) ({pair.low:.1f}-{pair.high:.1f}),"
            f" {steps_per_second(n, pair.ours):,.0f} steps/s"
        )
    for n in (1, many):
        pair = simulator(n, runs=runs)
        out[f"simulator_n{n}"] = asdict(pair)
        print(
            f"kernel n = {n:<4}   {pair.ratio:5.1f} x MuJoCo under Simulator.step"
            f" ({pair.low:.1f}-{pair.high:.1f}), {steps_per_second(n, pair.ours):,.0f} steps/s"
        )
    pair = emulated(many, runs)
    out[f"emulated_n{many}"] = asdict(pair)
    print(
        f"kernel n = {many:<4}   {pair.ratio:5.1f} x MuJoCo under Simulator.step, emulated"
        f" ({pair.low:.1f}-{pair.high:.1f})"
    )
    first = first_simulator(1 if small else 3)
    out["first"] = first
    print(
        f"kernel, first     {first['cold']:.2f} s compiled,"
        f" {first['cached']:.3f} s from the cache"
    )
    size = {"n": 2, "steps": 2, "runs": 1} if small else {}
    cost = {p: sensitivities(p, **size) for p in ((1,) if small else (1, 2, 4, 8, 16))}
    out["sensitivities"] = cost
    words = ", ".join(f"{value:.1f} rollouts for p = {p}" for p, value in cost.items())
    print(f"kernel, derivatives along p parameters: {words}")
    return out


if __name__ == "__main__":
    report()
