"""Emulated mode against ideal mode on the same engine and one thread: steps per second."""

from __future__ import annotations

import itertools
from dataclasses import asdict

from benchmarks.timing import Pair, side_by_side
from ves_gym.hardware.leg_servo import FILTERED, leg_clock
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

PERIODS = 20
RUNS = 7
CONTROL_DT, PHYSICS_DT = leg_clock(FILTERED)
SYSTEMS = {
    "pose servo": System(mode="emulated"),
    "pose servo, plain loop": System(
        mode="emulated", emulator=EmulatorSettings(payload_compensation=False)
    ),
    "leg servos": System(
        mode="emulated",
        emulator=EmulatorSettings(platform=FILTERED),
        control_dt=CONTROL_DT,
        physics_dt=PHYSICS_DT,
    ),
}


def emulated_against_ideal(name: str, n: int, backend: str, runs: int = RUNS) -> Pair:
    """PERIODS control periods of n simulations; ratio 1 would be as fast as ideal mode."""
    system = SYSTEMS[name]
    ours = Simulator(system, n, backend=backend, threads=1, warn_at=None)
    ideal = Simulator(system.ideal(), n, backend=backend, threads=1)

    def run(sim: Simulator) -> None:
        hold = sim.servo_command(sim.state.q * 0, sim.state.v * 0)
        for _ in range(PERIODS):
            sim.step(hold)

    return side_by_side(lambda: run(ours), lambda: run(ideal), runs)


def report(small: bool = False) -> dict[str, object]:
    """Print and return the ratios; `small`: just enough to see that they can be had."""
    out: dict[str, object] = {}
    sizes = (1,) if small else (1, 256)
    for backend, n, name in itertools.product(("mujoco", "kernel"), sizes, SYSTEMS):
        pair = emulated_against_ideal(name, n, backend, 1 if small else RUNS)
        out[f"{name}, {backend}, n{n}"] = asdict(pair)
        print(
            f"emulated n = {n:<4} {pair.ratio:5.2f} of ideal mode"
            f" ({pair.low:.2f}-{pair.high:.2f}), {name}, {backend}"
        )
    return out


if __name__ == "__main__":
    report()
