"""Queries, the registry, what every planner promises; tool poses as goals."""

import dataclasses
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ves_gym as vg
from tests.arms import pose_error, seven_joint_arm, six_joint_arm, tool_pose
from tests.reach import SPEED_LIMITS
from ves_gym._util.params import ParameterError, content_hash, from_plain, to_plain
from ves_gym.mechanics.kinematics import ToolPose, joint_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED, FREE_FLOATING
from ves_gym.planners.case import load_case
from ves_gym.planners.direct import Direct
from ves_gym.planners.obstacles import Sphere, Surroundings, collisions
from ves_gym.planners.prediction import FINE, BaseState, predict
from ves_gym.planners.query import Query, first_violation, solve
from ves_gym.planners.registry import PLANNERS, get_planner
from ves_gym.planners.suites import reach100
from ves_gym.planners.tool_goal import choose_goals, solve_to_tool
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

ROOT = Path(__file__).parents[2]
ENDS = {"start": (0.4, -0.6, 0.9), "goal": (0.9, 0.2, 0.1)}


def query(**options):
    return Query(**{"system": BENT, **ENDS, "duration": 2.0, **options})


# ------------------------------------------------------------------------- registry


def test_planners_by_name():
    assert {"straight", "bad-path", "hotspot-q", "hotspot-qt", "direct"} <= set(PLANNERS)
    for name, planner in PLANNERS.items():
        assert get_planner(name) is planner
        assert planner.name == name
        assert planner.summary
        assert "\n" not in planner.summary


@pytest.mark.parametrize("name", ["bent-thesis", "", "Straight", None])
def test_an_unknown_planner_is_an_error_that_lists_the_known(name):
    with pytest.raises(ParameterError) as caught:
        get_planner(name)
    for planner in PLANNERS:
        assert planner in str(caught.value)
    assert repr(name) in str(caught.value)


# -------------------------------------------------------------------------- queries


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, "Query.duration must be > 0 s, got 0.0"),
        ({"duration": np.nan}, "Query.duration must be > 0 s"),
        ({"duration": "2"}, "Query.duration must be > 0 s"),
        ({"start": (3.0, 0.0, 0.0)}, "start: joint 1 must be within -160.0 to 160.0 deg"),
        ({"goal": (0.0, 0.0, -2.4)}, "goal: joint 3 must be within"),
        ({"goal": (0.0, 0.0)}, r"goal must have shape \(3,\), got shape \(2,\)"),
        ({"goal": (0.0, 0.0, np.nan)}, "goal must be finite"),
        ({"start": "abc"}, "start must be numbers"),
        ({"v_max": (1.0, 1.0)}, r"v_max must have shape \(3,\)"),
        ({"v_max": (1.0, 0.0, 1.0)}, r"v_max must be > 0 rad/s"),
        ({"v_max": (1.0, -1.0, 1.0)}, r"v_max must be > 0 rad/s"),
        ({"v_max": 1.0}, "v_max must have shape"),
        ({"a_max": (1.0, 1.0)}, r"a_max must have shape \(3,\)"),
        ({"a_max": (1.0, 0.0, 1.0)}, r"a_max must be > 0 rad/s\^2"),
        (
            {"surroundings": "room.toml"},
            "surroundings must be Surroundings or None, got 'room.toml'",
        ),
        ({"start_rate": (1.0, 1.0)}, r"start_rate must have shape \(3,\)"),
        ({"start_acceleration": (1.0, 1.0, np.inf)}, "start_acceleration must be finite"),
        ({"base": (0.1,) * 6}, "base must be BaseState or None"),
    ],
)
def test_a_query_nobody_can_answer_is_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        query(**options)


def test_a_motion_continues_what_the_joints_do():
    moving = query(start_rate=(0.3, -0.2, 0.1), start_acceleration=(0.5, 0.0, -1.0))
    for motion in (moving.straight, solve(Direct(), moving).motion):
        begin, end = (k[0] for k in motion.at([0.0])[1:]), motion.at([2.0])
        for got, expected in zip(begin, (moving.start, *moving.start_motion), strict=True):
            np.testing.assert_allclose(got, expected, atol=1e-9)
        np.testing.assert_allclose(end.q[0], moving.goal, atol=1e-12)
        np.testing.assert_allclose([end.v, end.a], 0.0, atol=1e-9)
        assert first_violation(moving, motion) is None
        assert from_plain(Motion, to_plain(motion)) == motion
    at_rest = query()
    assert first_violation(moving, at_rest.straight) is not None
    assert "do not move at the start" in first_violation(at_rest, moving.straight)


def test_a_plan_against_a_moving_base_is_kept_with_it(tmp_path):
    base = BaseState(y=(0.05, 0.0, 0.0, 0.0, 0.0, 0.0))
    plan = solve(Direct(), query(base=base, start_rate=(0.1, 0.0, 0.0)))
    plan.case.save(tmp_path / "case.toml")
    kept = load_case(tmp_path / "case.toml")
    assert kept == plan.case
    assert plan.predicted == predict(BENT, kept.motion, kept.servo, base=base, parts=FINE)


def test_a_limit_broken_by_little_is_not_said_to_be_kept():
    """Straight quintic, speed limit 1e-4 below its peak."""
    fast = query()
    peak = np.abs(fast.straight.at(np.linspace(0, fast.duration, 2001)).v).max(axis=0)
    limited = dataclasses.replace(fast, v_max=tuple((peak + 1) * (1, 1, 1)))
    assert first_violation(limited, fast.straight) is None
    joint = int(peak.argmax())
    limit = peak + 1
    limit[joint] = peak[joint] / (1 + 1e-4)
    reason = first_violation(dataclasses.replace(fast, v_max=tuple(limit)), fast.straight)
    assert reason == f"velocity of joint {joint + 1} reaches 1.0001 of its limit"


def test_feasible_means_the_ends_the_time_and_the_limits():
    q = query(v_max=SPEED_LIMITS)
    start, goal = q.ends
    assert first_violation(q, q.straight) is None
    assert first_violation(q, q.straight.retimed(2.1)) is not None
    assert first_violation(q, Motion.straight(start + 0.01, goal, 2.0)) is not None
    assert first_violation(q, Motion.straight(start, goal + 0.01, 2.0)) is not None
    assert (
        first_violation(q, Motion.through([start, [0.5, 2.5, 0.5], goal], 2.0)) is not None
    )  # position
    fast = query(duration=0.55, v_max=SPEED_LIMITS)
    assert first_violation(fast, fast.straight) is not None  # speed
    assert first_violation(query(duration=0.8), query(duration=0.8).straight) is None
    violent = query(duration=0.25)
    assert first_violation(violent, violent.straight) is not None  # torque
    prescribed = query(duration=0.25, system=System(vehicle=BENT_THESIS, drive="prescribed"))
    assert first_violation(prescribed, prescribed.straight) is None


# ------------------------------------------------------------------ every planner


# one of each kind; of the two left out only the numbers are other ones
MORE = ("smooth-jerk", "shaped-zvd", "hotspot-q", "ompl-q", "ompl-time", "robust")
METHODS = [
    pytest.param(name, marks=pytest.mark.slow) if name in MORE else name
    for name in sorted(set(PLANNERS) - {"refined-long", "robust-worst"})
]


@pytest.fixture(params=METHODS)
def planner(request):
    return get_planner(request.param)


def test_the_same_question_has_the_same_answer(planner):
    first, again = (solve(planner, query(v_max=SPEED_LIMITS), seed=3) for _ in range(2))
    assert again.found == first.found
    assert again.info == first.info
    assert json.loads(json.dumps(first.info, allow_nan=False)) == first.info
    with pytest.raises(ParameterError, match="seed must be a whole number >= 0, got -1"):
        solve(planner, query(), seed=-1)


@pytest.mark.slow
def test_the_same_answer_in_another_process():
    """Bitwise, whatever was planned before."""
    code = f"""
from ves_gym._util.params import content_hash
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import PLANNERS
system = System(vehicle=BENT_THESIS)
query = Query(system=system, start={ENDS["start"]}, goal={ENDS["goal"]}, duration=2.0,
              v_max=tuple(system.arm.column("v_max").tolist()))
for planner in reversed(list(PLANNERS.values())):
    print(planner.name, content_hash(solve(planner, query, 3).motion))
"""
    env = {**os.environ, "PYTHONHASHSEED": "7"}
    process = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=env,
        capture_output=True,
        text=True,
        check=True,
    )
    q = query(v_max=SPEED_LIMITS)
    hashes = {name: content_hash(solve(p, q, 3).motion) for name, p in PLANNERS.items()}
    assert dict(text.split() for text in process.stdout.splitlines()) == hashes


@pytest.mark.parametrize(
    ("vehicle", "make"),
    [
        (FREE_FLOATING, None),
        (BENT_THESIS, seven_joint_arm),
        pytest.param(BENT_THESIS, six_joint_arm, marks=pytest.mark.slow),
        pytest.param(FREE_FLOATING, seven_joint_arm, marks=pytest.mark.slow),
        pytest.param(DECOUPLED, None, marks=pytest.mark.slow),
    ],
)
def test_every_planner_answers_on_every_vehicle_and_arm(planner, vehicle, make):
    """Or says why not, in a sentence."""
    q = query(system=System(vehicle=vehicle))
    if make is not None:
        system = System(arm=make(), vehicle=vehicle, drive="prescribed")
        ((_, q),) = reach100(system, "bent-thesis", 1, durations=(4.0,)).queries
        q = dataclasses.replace(q, system=system)
    plan, n = solve(planner, q), q.system.arm.n
    if why := cannot(planner, vehicle, n):
        assert plan.found is None and "\n" not in plan.failure
        assert plan.failure.startswith(why)
        return
    assert (plan.motion.n, plan.motion.duration) == (n, q.duration)
    np.testing.assert_allclose([plan.motion.start, plan.motion.goal], q.ends, rtol=1e-12)
    assert np.isfinite(list(plan.predicted.to_dict().values())).all()
    if make is not None and planner.name != "bad-path":  # one by one, too fast on the whole
        assert plan.feasible, plan.failure


def cannot(planner, vehicle, n):
    """How a planner begins to say that there is nothing on this vehicle for it, or None."""
    if planner.name == "reaction-null" and n <= (3 if vehicle is FREE_FLOATING else 6):
        return f"no reactionless motion: every motion of {n} joints"
    if planner.name.startswith("hotspot") and vehicle is FREE_FLOATING:
        return "no hot spots: they are where joint motion strains the base"
    return None


def test_staying_where_one_is(planner):
    plan = solve(planner, query(goal=ENDS["start"]))
    assert plan.feasible
    assert plan.predicted.E_mean == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(plan.motion.at(np.linspace(0, 2, 50)).q, axis=0).max() < 1e-6


def test_moving_one_joint_only(planner):
    start = ENDS["start"]
    plan = solve(planner, query(goal=(start[0] + 0.5, *start[1:])))
    if why := cannot(planner, BENT_THESIS, 3):
        assert not plan.feasible and plan.failure.startswith(why)
    else:
        assert plan.feasible and plan.predicted.E_mean > 0


# ---------------------------------------------------------------------------- goals of the tool


def to_reach(arm, count=2):
    suite = reach100(
        System(vehicle=BENT_THESIS, arm=arm, drive="prescribed"),
        "bent-thesis",
        count,
        durations=(2.0,),
    )
    return [query for _, query in suite.queries]


@pytest.mark.parametrize(
    ("make", "turn"),
    [
        (six_joint_arm, True),
        (seven_joint_arm, False),
        pytest.param(six_joint_arm, False, marks=pytest.mark.slow),
        pytest.param(seven_joint_arm, True, marks=pytest.mark.slow),
    ],
)
def test_it_costs_no_more_than_the_configuration_it_was_taken_from(make, turn):
    """Planned by `direct` to the pose, and to the joint angles that the pose was read from."""
    arm = make()
    for query in to_reach(arm):
        pose = tool_pose(arm, query.goal)
        pose = pose if turn else replace(pose, angles=None)
        plan = solve_to_tool(get_planner("direct"), query, pose)
        assert plan.feasible
        assert np.abs(pose_error(arm, pose, plan.motion.goal)).max() < 2e-6
        given = solve(get_planner("direct"), query)
        assert plan.predicted.E_mean <= 1.02 * given.predicted.E_mean
        assert plan.info["tool"]["goal"] == list(plan.query.goal)
        if arm.n == 7 or not turn:
            assert plan.predicted.E_mean < 0.85 * given.predicted.E_mean


def test_goals_inside_an_obstacle_are_left_out():
    """A ball at the elbow of one of the postures that reach a place."""
    system = System(vehicle=BENT_THESIS, drive="prescribed")
    asked = Query(system=system, start=(0.0,) * 3, goal=(0.0,) * 3, duration=4.0)
    pose = ToolPose(position=tool_pose(system.arm, (0.8, 0.6, -1.2)).position)
    goals = choose_goals(asked, pose)
    assert len(goals) >= 2
    elbow = tuple(joint_positions(system.arm, goals[0])[2].tolist())
    ball = Surroundings(obstacles=(Sphere(centre=elbow, radius=0.05),))
    checker = collisions(system, ball)
    assert not checker.is_clear(goals[0])
    left = choose_goals(replace(asked, surroundings=ball), pose)
    assert 0 < len(left) < len(goals)
    assert all(checker.is_clear(q) for q in left)
    blocked = Surroundings(obstacles=(Sphere(centre=pose.position, radius=0.2),))
    with pytest.raises(ParameterError, match="clear of the obstacles: no configuration"):
        solve_to_tool(get_planner("direct"), replace(asked, surroundings=blocked), pose)


def test_a_pose_out_of_reach_is_refused_with_how_near_it_is():
    arm = six_joint_arm()
    (query,) = to_reach(arm, 1)
    pose = ToolPose(position=(9.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match=r"\(9\.0, 0\.0, 0\.0\) m must be within reach"):
        solve_to_tool(get_planner("straight"), query, pose)


def test_the_same_from_python():
    """The thesis's arm has two postures for a place."""
    place = tool_pose(System(vehicle=BENT_THESIS).arm, (0.8, 0.3, -0.9)).position
    plan = vg.plan((0.0, 0.0, 0.0), ToolPose(position=place), planner="straight")
    assert plan.feasible
    np.testing.assert_allclose(
        tool_pose(System(vehicle=BENT_THESIS).arm, plan.motion.goal).position, place, atol=2e-6
    )
