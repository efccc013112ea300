"""Simulator steps against bare batch physics of the same model."""

from __future__ import annotations

import numpy as np
from mujoco.batch import Batch

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

PERIODS = 20


def simulator_against_batch(n: int) -> Pair:
    """PERIODS control periods of n simulations; ratio >= 1 would be no overhead at all."""
    system = System()
    sim = Simulator(system, n, backend="mujoco")
    hold = sim.servo_command(sim.state.q, sim.state.v)
    bare = Batch(compile_model(system), n)

    def ours() -> None:
        for _ in range(PERIODS):
            sim.step(hold)

    def reference() -> None:
        for _ in range(PERIODS):
            bare.step(nstep=system.substeps)

    return side_by_side(ours, reference)


def steps_per_second(n: int, pair: Pair) -> float:
    """Physics steps per second of all simulations together."""
    return n * PERIODS * System().substeps / pair.ours


if __name__ == "__main__":
    np.set_printoptions(precision=3)
    for size in (1, 256):
        print(size, simulator_against_batch(size))
