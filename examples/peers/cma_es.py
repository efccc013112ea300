"""Search without gradients: CMA-ES over four via points a joint, by `pip install cma`.

    ves-gym leaderboard run paths bent-2s cma-es --author peer --import examples/peers/cma_es.py

A black box of 600 predictions of E_mean, twice: what somebody tries who has a simulator and no
derivatives. Speeds beyond the limits cost as much as the straight line's energy.
"""

from typing import Any

import cma
import numpy as np
import numpy.typing as npt

import ves_gym as vg
from ves_gym.planners import predict

Array = npt.NDArray[np.float64]
VIAS = 4  # control points of each joint beside the ends
BUDGET = 600  # predictions of a start
SPREAD = 0.3  # rad, of the first generation


@vg.register_planner
class CmaEs:
    """B-spline control points by covariance matrix adaptation (Hansen 2016)."""

    name = "cma-es"
    summary = "CMA-ES on four via points a joint, 600 predictions"

    def find(self, query: vg.Query, seed: int) -> tuple[vg.Motion, dict[str, Any]]:
        start, goal = query.ends
        law = np.linspace(0, 1, VIAS + 2)[1:-1, None]
        line = start + law * (goal - start)
        straight = predict(query.system, query.straight).E_mean
        times = np.linspace(0, query.duration, 101)
        limit = np.full(len(start), np.inf) if query.v_max is None else np.array(query.v_max)

        def motion(offsets: Array) -> vg.Motion:
            points = [start] * 3 + list(line + offsets.reshape(line.shape)) + [goal] * 3
            return vg.Motion(duration=query.duration, control=tuple(map(tuple, points)))

        def cost(offsets: Array) -> Any:
            path = motion(offsets)
            excess = np.maximum(np.abs(path.at(times).v) / limit - 1, 0).max()
            return predict(query.system, path).E_mean / straight + 10 * excess

        options = {"seed": seed + 1, "maxfevals": BUDGET, "verbose": -9}  # 0 is the clock
        found = cma.fmin(cost, np.zeros(line.size), SPREAD, options)
        return motion(found[0]), {"evaluations": int(found[3])}
