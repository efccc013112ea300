"""Simulator steps against bare batch physics of the same model."""

from __future__ import annotations

from dataclasses import asdict

from mujoco.batch import Batch

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

PERIODS = 20
RUNS = 7


def simulator_against_batch(n: int, runs: int = RUNS) -> Pair:
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

    return side_by_side(ours, reference, runs)


def steps_per_second(n: int, pair: Pair) -> float:
    """Physics steps per second of all simulations together."""
    return n * PERIODS * System().substeps / pair.ours


def report(small: bool = False) -> dict[str, object]:
    """Print and return the ratios; `small`: just enough to see that they can be had."""
    out: dict[str, object] = {}
    for n in (1,) if small else (1, 256):
        pair = simulator_against_batch(n, 1 if small else RUNS)
        out[f"n{n}"] = asdict(pair)
        print(
            f"Simulator n = {n:<4} {pair.ratio:5.2f} of bare batch physics"
            f" ({pair.low:.2f}-{pair.high:.2f}), {steps_per_second(n, pair):,.0f} steps/s"
        )
    return out


if __name__ == "__main__":
    report()
