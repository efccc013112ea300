"""Direct minimisation of the predicted E_mean over smooth motions (`motion_problem`).

Sequential quadratic programming with the exact derivative of u and Gauss and Newton's second
derivative J^T W J.

Against a moving base (`DampRelease`) the problem is solved anew about its own solution a few
times: with the inertia along the motion, and with what the servo must give against the base,
and how far joints yield to it, as the linear base says. So torque and speed are within the
limits on the moving base, not on one that stands still.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym.mechanics.motion import Motion
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.query import Query, first_violation, require_time
from ves_gym.planners.sequential import against_base, minimise


class Direct:
    """Minimise the predicted E_mean over B-spline motions by sequential programming."""

    name = "direct"
    summary = "minimise predicted E_mean over a smooth motion inside all joint limits"

    def __init__(self, free: int = 12) -> None:
        self.free = free

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Minimise from one start, the straight line; deterministic."""
        require_time(query)
        problem = MotionProblem(query, self.free)
        minimum = against_base(problem, minimise(problem, problem.straight))
        return problem.motion(minimum.x), minimum.info()


_POINTS = 6.0  # free control points per second
_LEAST, _MOST = 12, 180  # of them; of all joints' together
_COARSE, _FINE = 1e-2, 1e-3  # relative decrease of E_mean that ends an optimisation
_ITERATIONS = 40
_ROUNDS = 3
_MORE = 2  # rounds after the last, while what the servo gives is still changing at a limit


class DampRelease:
    """Least E_mean of a moving base over smooth motions that end at rest."""

    name = "damp"
    summary = "takes the energy out of a moving base by a smooth motion inside all limits"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Minimise from the straight line, each round about the last solution; deterministic.

        The goal may be the start.
        """
        require_time(query)
        most = max(_LEAST, _MOST // query.system.arm.n)
        problem = MotionProblem(query, int(np.clip(_POINTS * query.duration, _LEAST, most)))
        x, motion = problem.straight, query.straight
        rounds = []
        for k in range(1, _ROUNDS + _MORE + 1):
            problem.follow(motion)
            tolerance = _COARSE if k < _ROUNDS else _FINE
            rounds.append(minimise(problem, x, _ITERATIONS, tolerance))
            x = rounds[-1].x
            motion = problem.motion(x)
            if k >= _ROUNDS and first_violation(query, motion) is None:
                break
        done = {name: sum(getattr(m, name) for m in rounds)
                for name in ("iterations", "evaluations")}  # fmt: skip
        return motion, rounds[-1].info() | done | {"rounds": [m.energy for m in rounds]}
