"""Every planner answers for arms of six and seven joints, or says why not in a sentence."""

import numpy as np
import pytest

from tests.arms import seven_joint_arm, six_joint_arm
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.query import solve
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

# of the two left out only the numbers are other ones
NAMES = [name for name in PLANNERS if name not in ("refined-long", "robust-worst", "robust")]
NO_ANSWER = {  # on this query
    ("reaction-null", 6, "bent-thesis"): "no reactionless motion: every motion of 6 joints"
}


FREE = ("bad-path", "reaction-null", "direct")


@pytest.mark.parametrize(
    "make", [pytest.param(six_joint_arm, marks=pytest.mark.slow), seven_joint_arm]
)
@pytest.mark.parametrize(
    ("name", "vehicle"),
    [(k, "bent-thesis") for k in NAMES] + [(k, "free-floating") for k in FREE],
)
def test_every_planner_answers_or_says_why_not(name, make, vehicle):
    planner = get_planner(name)
    if isinstance(planner, Ompl):
        pytest.importorskip("ompl")
    system = System(arm=make(), vehicle=get_vehicle(vehicle), drive="prescribed")
    ((_, query),) = reach100(system, vehicle, 1, durations=(4.0,)).queries
    plan = solve(planner, query)
    why = NO_ANSWER.get((name, system.arm.n, vehicle))
    if why is not None:
        assert plan.motion is None
        assert plan.failure.startswith(why) and "\n" not in plan.failure
        return
    assert plan.motion.n == system.arm.n
    start, goal = query.ends
    np.testing.assert_allclose(plan.motion.start, start)
    np.testing.assert_allclose(plan.motion.goal, goal)
    if name != "bad-path":  # which moves joints one by one, too fast on the whole
        assert plan.feasible, plan.failure
