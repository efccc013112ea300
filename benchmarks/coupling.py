"""Q(q) of many configurations against a Python loop over Pinocchio's CRBA."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from benchmarks.timing import Pair, side_by_side
from ves_gym.engine.mjcf import TO_Y, pinocchio_model
from ves_gym.planners.coupling import coupling_matrix
from ves_gym.system.system import System

COUNT = 20_000


def coupling_against_loop(count: int = COUNT) -> Pair:
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

    return side_by_side(lambda: coupling_matrix(system, q), loop, runs=5)


if __name__ == "__main__":
    print(coupling_against_loop())
