"""Q(q) of many configurations against a Python loop over Pinocchio's CRBA."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pinocchio as pin

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.planners.coupling import coupling_matrix
from ves_gym.system.system import System

COUNT = 20_000


def coupling_against_loop(count: int = COUNT, runs: int = 5) -> Pair:
    """Coupling matrices of `count` configurations, vectorised against one at a time."""
    system = System()
    base = system.base
    model = pinocchio_model(system.arm, base)
    data = model.createData()
    q = np.random.default_rng(0).uniform(-2, 2, (count, system.arm.n))

    def loop() -> None:
        z = np.zeros(model.nq)
        for row in q:
            z[6:] = row
            H = pin.crba(model, data, z)
            Mt = H[np.ix_(TO_Y, TO_Y)] + base.M
            A = np.linalg.solve(Mt, H[TO_Y, 6:])
            A.T @ base.K @ A

    return side_by_side(lambda: coupling_matrix(system, q), loop, runs)


def report(small: bool = False) -> dict[str, object]:
    """Print and return the ratio; `small`: just enough to see that it can be had."""
    count = 2 if small else COUNT
    pair = coupling_against_loop(count, 1 if small else 5)
    print(
        f"Q(q)             {pair.ratio:5.1f} x a loop over pin.crba"
        f" ({pair.low:.1f}-{pair.high:.1f}), {count / pair.ours:,.0f} Q/s"
    )
    return asdict(pair)


if __name__ == "__main__":
    report()
