"""Take the energy out of a moving base by an optimal arm motion.

The problem is that of `direct` with the linear term of the base's free response. Against a
moving base it is solved anew about its own solution a few times: with the inertia along the
motion, and with what the servo must give against the base, and how far joints yield to it, as
the linear base says. So torque and speed are within the limits on the moving base, not on one
that stands still.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.query import Query, first_violation, require_time
from ves_gym.planners.sequential import minimise

_POINTS = 6.0  # free control points per second
_LEAST, _MOST = 12, 180  # of them; of all joints' together
_COARSE, _FINE = 1e-2, 1e-3  # relative decrease of E_mean that ends an optimisation
_ITERATIONS = 40
_MORE = 2  # rounds after the last, while what the servo gives is still changing at a limit


class DampRelease:
    """Least E_mean of a moving base over smooth motions that end at rest."""

    name = "damp"
    summary = "takes the energy out of a moving base by a smooth motion inside all limits"

    def __init__(self, free: int | None = None, rounds: int = 3) -> None:
        if free is not None and free < 1:
            raise ParameterError(f"free must be >= 1 or None, got {free}")
        if rounds < 1:
            raise ParameterError(f"rounds must be >= 1, got {rounds}")
        self.free, self.rounds = free, rounds

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Minimise from the straight line, each round about the last solution; deterministic.

        The goal may be the start.
        """
        require_time(query)
        free = self.free
        if free is None:
            most = max(_LEAST, _MOST // query.system.arm.n)
            free = int(np.clip(_POINTS * query.duration, _LEAST, most))
        problem = MotionProblem(query, free)
        x, motion = problem.straight, query.straight
        energies, iterations, evaluations = [], 0, 0
        for k in range(self.rounds + _MORE):
            problem.follow(motion)
            last = k + 1 >= self.rounds
            minimum = minimise(problem, x, _ITERATIONS, _FINE if last else _COARSE)
            x, motion = minimum.x, problem.motion(minimum.x)
            energies.append(minimum.energy)
            iterations += minimum.iterations
            evaluations += minimum.evaluations
            if last and first_violation(query, motion) is None:
                break
        info = minimum.info() | {"iterations": iterations, "evaluations": evaluations}
        return motion, info | {"rounds": energies}
