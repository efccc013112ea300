"""Write a planner and see where it stands: the lazy one, which only moves more gently."""

import numpy as np

from ves_gym.mechanics.motion import Motion
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import PLANNERS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import energies
from ves_gym.system.system import System


class Gentle:
    """The straight line with the start and end of its time law drawn out."""

    name = "gentle"
    summary = "straight joint line, degree-nine time law"

    def find(self, query, seed):
        u = np.linspace(0, 1, 400)[:, None]
        law = u**5 * (126 - 420 * u + 540 * u**2 - 315 * u**3 + 70 * u**4)
        start, goal = query.ends
        return Motion.fit(start + law * (goal - start), query.duration), {}


query = Query(
    system=System(),
    start=tuple(np.deg2rad([0, -45, 90])),
    goal=tuple(np.deg2rad([80, 40, -40])),
    duration=4.0,
)
plans = [
    solve(planner, query) for planner in (PLANNERS["straight"], Gentle(), PLANNERS["direct"])
]
run = play_motions(query.system, [plan.motion for plan in plans], servo=query.servo)
results = energies(query.system, run.t, run.q, run.y, run.yd, duration=query.duration)
for plan, result in zip(plans, results, strict=True):
    print(
        f"{plan.planner:10} E_mean {1e3 * result.E_mean:8.3f} mJ,"
        f" predicted {1e3 * plan.predicted.E_mean:8.3f} mJ"
    )
