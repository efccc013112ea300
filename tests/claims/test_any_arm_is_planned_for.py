"""Claim: seven joints are planned for as three are: little energy, in little time.

A PUMA 560 with a second forearm (`tests/arms.py`), reach100 at 2 s, motor drive. Median
energy of `refined` over the straight line's, simulated on the full nonlinear system; planning
time is processor time of one core. The fast tests take the first queries, the slow ones
twenty.

Promised and missed: a quarter of the straight line's energy on a satellite, between given
joint angles. A free base has no energy after a motion; during it E_mean is the kinetic energy
that the path gives it. The least found is the same within 2 % without limits of speed and
torque (four queries at 2 s, four at 4 s), and fifteen starts with detours of up to 1.5 rad
find at most 0.3 % less than the straight line as a start (six queries at 4 s). Where only the
goal's tool pose is asked for, the joint left over brings the median to 0.29, and to 0.22 for
its position alone.

Missed: the PUMA with a second forearm on a satellite at 2 and 4 s: promised 0.25 of the
straight line, measured 0.56 and 0.40, where fifteen starts agree within 0.3 %; with only
the tool pose asked for: promised 0.25, measured 0.29.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.arms import SEVEN_GAINS, seven_joint_arm, tool_pose
from ves_gym.mechanics.vehicle import BENT_THESIS, get_vehicle
from ves_gym.planners.coupling_map import coupling_map
from ves_gym.planners.query import solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.planners.tool_goal import solve_to_tool
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

MISS = pytest.mark.xfail(
    reason="miss: 0.56 at 2 s; within 2 % of it without limits of speed and torque",
    strict=True,
)
MISS_OF_POSE = pytest.mark.xfail(
    reason="miss: 0.29, by the one joint that a pose leaves; 0.22 for the position alone"
)
PROMISED = [("bent-thesis", 0.25), pytest.param("free-floating", 0.25, marks=MISS)]


def measured(vehicle, count):
    """Ratios of simulated E_mean."""
    system = System(vehicle=BENT_THESIS, arm=seven_joint_arm(), drive="prescribed")
    ratios = []
    for _, query in reach100(system, vehicle, count, durations=(2.0,)).queries:
        motors = system.replace(drive="motor", vehicle=get_vehicle(vehicle))
        query = replace(query, system=motors, servo=SEVEN_GAINS)
        plan = solve(get_planner("refined"), query)
        assert plan.feasible, plan.failure
        run = play_motions(motors, [plan.motion, query.straight], servo=SEVEN_GAINS)
        ours, straight = run.energies()
        ratios.append(ours.E_mean / straight.E_mean)
    return np.array(ratios)


@pytest.mark.slow
def test_seven_joints_leave_a_third_of_the_straight_lines_energy_on_either_of_two_queries():
    ratios = measured("bent-thesis", 2)
    assert (ratios <= 1 / 3).all()


@pytest.mark.slow
@pytest.mark.parametrize(("vehicle", "promised"), PROMISED)
def test_seven_joints(vehicle, promised):
    ratios = measured(vehicle, 20)
    print(f"{vehicle}: {np.median(ratios):.3f}")
    assert (ratios < 0.9).all()
    assert np.median(ratios) <= promised


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "turn", "promised"),
    [
        ("bent-thesis", True, 0.10),
        ("free-floating", False, 0.25),
        pytest.param("free-floating", True, 0.25, marks=MISS_OF_POSE),
    ],
)
def test_seven_joints_to_the_same_tool_pose(vehicle, turn, promised):
    """Predicted; over the straight line to the joint angles that the pose was read from."""
    system, ratios = System(vehicle=BENT_THESIS, arm=seven_joint_arm(), drive="prescribed"), []
    for _, query in reach100(system, vehicle, 10, durations=(2.0,)).queries:
        pose = tool_pose(system.arm, query.goal)
        pose = pose if turn else replace(pose, angles=None)
        plan = solve_to_tool(get_planner("refined"), query, pose, tries=1)
        assert plan.feasible, plan.failure
        straight = solve(get_planner("straight"), query)
        ratios.append(plan.predicted.E_mean / straight.predicted.E_mean)
    print(f"{vehicle}, turn {turn}: {np.median(ratios):.3f}")
    assert np.median(ratios) <= promised


@pytest.mark.parametrize(
    ("others", "duration"),
    [("given", 2.0), ("least", None), pytest.param("most", 2.0, marks=pytest.mark.slow)],
)
def test_a_map_of_two_of_seven_joints_has_lines(others, duration):
    section = coupling_map(
        System(vehicle=BENT_THESIS, arm=seven_joint_arm()),
        (1, 3),
        np.zeros(7),
        duration=duration,
        others=others,
    )
    lines = section.lines()
    assert len(lines) and all(np.isfinite(line).all() for line in lines)
