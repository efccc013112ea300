"""How much more the kernel's steps cost for more joints and for a base with internal modes.

    python -m benchmarks.kernel_sizes

Steps per second of the larger system over those of the smaller, run in turn on one thread:
seven joints over three, twelve internal modes of a finite-element beam over none, and two
UR5e on one base over one arm of as many joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.backends.kernel import KernelBackend
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.servo import own_gains
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.system.system import System

PERIODS = 20
RUNS = 15
DT = 1.25e-5  # s: fast internal modes run away at longer steps; what a step costs is the same
MODES = 12


def stepping(system: System, n: int) -> Callable[[], None]:
    """PERIODS control periods of n simulations on one thread, nothing around the engine."""
    engine, joints = KernelBackend(system, n, 1), system.arm.n
    rows = np.random.default_rng(0).uniform(-0.01, 0.01, (2, n, 6 + joints))
    engine.write(np.arange(n), np.zeros(n), *rows)
    servo = own_gains(system.arm, system.vehicle)
    engine.set_gains(np.arange(n), np.tile(servo.kp, (n, 1)), np.tile(servo.kd, (n, 1)))

    pieces = engine.pieces(engine._u, 1, system.substeps)

    def run() -> None:
        for _ in range(PERIODS):
            engine._run(pieces, system.substeps)

    return run


def joints(arm: str = "iiwa14", n: int = 256) -> Pair:
    """An arm of seven joints beside the PUMA's three, on the same base."""
    base = System(vehicle=get_vehicle("straight-vertical"))
    return side_by_side(stepping(base, n), stepping(base.replace(arm=get_arm(arm)), n), RUNS)


def internal_modes(modes: int = MODES, n: int = 256) -> Pair:
    """A finite-element beam with internal modes beside the same beam without any."""
    beam = get_vehicle("bent")
    assert isinstance(beam, FlexibleBase)
    base = System(physics_dt=DT, control_dt=10 * DT)
    plain, fine = (base.replace(vehicle=replace(beam, modes=k)) for k in (0, modes))
    return side_by_side(stepping(plain, n), stepping(fine, n), RUNS)


def arms(n: int = 256) -> Pair:
    """Two UR5e on a satellite beside one arm with the links of both in a row."""
    ur5e, base = get_arm("ur5e"), get_vehicle("free-floating")
    two = System(arms=[ur5e.at((0.0, y, 0.0)) for y in (0.5, -0.5)], vehicle=base)
    one = System(arm=replace(ur5e, links=2 * ur5e.links), vehicle=base)
    return side_by_side(stepping(one, n), stepping(two, n), RUNS)


def main() -> None:
    """Print the ratios."""
    for what, pair, goal in (
        ("7 joints over 3", joints(), 0.35),
        (f"{MODES} internal modes over none", internal_modes(), 0.3),
        ("two arms over one of as many joints", arms(), 0.8),
    ):
        print(
            f"kernel steps/s, {what}: {1 / pair.ratio:.2f}"
            f" ({1 / pair.high:.2f}-{1 / pair.low:.2f}), goal >= {goal}"
        )


if __name__ == "__main__":
    main()
