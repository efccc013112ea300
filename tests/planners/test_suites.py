"""The benchmark's questions are fixed, seeded and inside the limits."""

import dataclasses

import numpy as np
import pytest

from tests.arms import planar_arm, seven_joint_arm, six_joint_arm
from tests.reach import REACH_RANGE, SPEED_LIMITS
from ves_gym._util.params import ParameterError, content_hash
from ves_gym.mechanics.arm_library import PUMA_560, arm_names, get_arm
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED
from ves_gym.mechanics.vehicle import BENT_THESIS, STRAIGHT_HORIZONTAL_THESIS
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.query import first_violation
from ves_gym.planners.registry import PLANNERS
from ves_gym.planners.suites import (
    ARM_SUITES,
    REACH_DURATIONS,
    REACH_OBSTACLES,
    SUITES,
    get_suite,
    reach100,
    reach_durations,
    reach_obstacles,
    reach_range,
    transfer,
)
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)


@pytest.fixture(scope="module")
def full():
    return get_suite("reach100", system=System(), vehicle="bent-thesis")


def ends(suite):
    return [(q.name, q.start, q.goal) for _, q in suite.queries]


def test_the_questions_never_change(full):
    """A hundred per duration; whoever changes them publishes another suite."""
    assert full.name == "reach100" and set(full.planners) <= set(PLANNERS)
    asked = [(v, q.duration) for v, q in full.queries]
    assert asked == [("bent-thesis", d) for d in REACH_DURATIONS for _ in range(100)]
    rounded = [(n, np.round(a, 9).tolist(), np.round(b, 9).tolist()) for n, a, b in ends(full)]
    assert content_hash(rounded)[:16] == "fe5fba37b63bce24"


def test_every_straight_line_keeps_the_speed_limits(full):
    arm = BENT.arm
    for _, q in full.queries:
        start, goal = q.ends
        peak = np.abs(goal - start) * QUINTIC_PEAK_SPEED / q.duration
        assert (peak <= SPEED_LIMITS).all()
        assert (np.abs([start, goal]) <= REACH_RANGE).all()
        arm.require_within_limits(start)
        arm.require_within_limits(goal)
        assert q.v_max == SPEED_LIMITS
    np.testing.assert_allclose(np.rad2deg(SPEED_LIMITS), [82, 54, 122])


ARMS = [*map(get_arm, arm_names()), planar_arm(), six_joint_arm(), seven_joint_arm()]


@pytest.mark.parametrize(
    "arm",
    [
        pytest.param(k, marks=pytest.mark.slow if k.name == "canadarm2" else (), id=k.name)
        for k in ARMS
    ],
)
def test_reach100_asks_any_arm(arm):
    """From its own limits, and with its own servo gains where it has some.

    Prefixes, determinism and speed as for the PUMA; nearly every straight line is feasible.
    """
    packaged = arm.name in arm_names()
    drive = "motor" if packaged else "prescribed"
    system = System(vehicle=BENT_THESIS, arm=arm, drive=drive)
    suite = reach100(system, "bent-thesis", 3)
    queries = [q for _, q in suite.queries]
    assert ends(suite) == ends(reach100(system, "bent-thesis", 3))
    longer = reach100(system, "bent-thesis", 5, durations=(queries[0].duration,))
    assert ends(longer)[:3] == ends(suite)[:3]
    assert [q.duration for q in queries[::3]] == list(reach_durations(arm))
    middle = (arm.column("q_min") + arm.column("q_max")) / 2
    for q in queries:
        start, goal = q.ends
        assert (np.abs([start - middle, goal - middle]) <= reach_range(arm)).all()
        peak = np.abs(goal - start) * QUINTIC_PEAK_SPEED / q.duration
        assert (peak <= arm.column("v_max")).all()
    if packaged:
        assert all(len(q.servo.kp) == arm.n for q in queries)
        slow = [q for q in queries if q.duration >= 2 * reach_durations(arm)[0]]
        assert np.mean([first_violation(q, q.straight) is None for q in slow]) > 0.7


def test_the_box_of_reach100_is_cut_to_whole_multiples_of_60_degrees():
    np.testing.assert_array_equal(reach_range(PUMA_560), REACH_RANGE)
    assert reach_durations(PUMA_560) == REACH_DURATIONS
    assert reach_obstacles(PUMA_560) == REACH_OBSTACLES
    link = PUMA_560.links[0]
    limits = ((-6.2, 6.2), (0.0, np.pi), (-0.8, 0.8), (0.1, 0.2))  # rad
    links = tuple(dataclasses.replace(link, q_min=a, q_max=b) for a, b in limits)
    arm = dataclasses.replace(PUMA_560, links=links)
    np.testing.assert_allclose(np.rad2deg(reach_range(arm)), [180, 60, 30, 1.875])
    queries = reach100(
        System(vehicle=BENT_THESIS, arm=arm, drive="prescribed"), "bent-thesis", 20
    ).queries
    second = np.rad2deg([q.start[1] for _, q in queries])
    assert second.min() >= 30.0 and second.max() <= 150.0


def test_a_slow_arm_is_asked_for_slow_motions():
    """Ten times as slow, sixteen or eight times as long; a longer one, larger obstacles."""
    links = tuple(
        dataclasses.replace(k, v_max=k.v_max / 10, a=3 * k.a, d=3 * k.d) for k in PUMA_560.links
    )
    arm = dataclasses.replace(PUMA_560, links=links)
    assert reach_durations(arm) == (4.0, 8.0, 16.0, 32.0)
    first, wide = REACH_OBSTACLES.obstacles[0], reach_obstacles(arm).obstacles[0]
    np.testing.assert_allclose(wide.size, 3 * np.array(first.size))
    np.testing.assert_allclose(wide.centre, 3 * np.array(first.centre))


def test_the_thesis_suite():
    suite = get_suite("thesis", system=BENT)
    assert [(v, q.name, q.duration) for v, q in suite.queries] == [
        ("straight-horizontal-thesis", "shoulder-180", 2.0),
        ("bent-thesis", "shoulder-180", 2.0),
        ("bent-thesis", "good-and-bad", 3.0),
    ]
    beams = [STRAIGHT_HORIZONTAL_THESIS, BENT_THESIS, BENT_THESIS]
    assert [q.system.vehicle for _, q in suite.queries] == beams
    shoulder = suite.queries[0][1]
    turn = np.rad2deg(np.subtract(shoulder.goal, shoulder.start))
    np.testing.assert_allclose(turn, [180, 0, 0])
    assert "bad-path" in suite.planners
    assert set(suite.planners) <= set(PLANNERS)
    assert shoulder.v_max is None


@pytest.mark.parametrize("name", ["reach", "", None])
def test_an_unknown_suite_is_an_error_that_lists_the_known(name):
    with pytest.raises(ParameterError) as caught:
        get_suite(name, system=BENT)
    for suite in (*SUITES, repr(name)):
        assert suite in str(caught.value)
    with pytest.raises(ParameterError, match="vehicle must be one of"):
        get_suite("reach100", system=BENT, vehicle="ship")


def test_transfer_asks_of_one_base_and_judges_on_others():
    suite = get_suite("transfer", system=BENT)
    machines = dict.fromkeys(v for v, _ in suite.queries)
    assert list(machines)[:3] == ["as described", "more modes", "stiffness -20 %"]
    known = {suite.described[v].hash for v in machines}
    assert len(known) == 2  # the payload is known in one of them
    judged = {v: q.system.actual for v, q in suite.queries}
    nominal = judged["as described"].base
    assert judged["more modes"].base.m > nominal.m
    soft = judged["stiffness -20 %"].base
    np.testing.assert_allclose(soft.full()[2], 0.8 * nominal.full()[2], rtol=1e-12)
    weak = judged["damping x 0.1"].base
    np.testing.assert_allclose(weak.full()[1], 0.1 * nominal.full()[1], rtol=1e-9, atol=1e-9)
    known_payload = suite.described["payload 5 kg, known"].arm
    assert known_payload.mass == pytest.approx(judged["payload 5 kg"].arm.mass)
    with pytest.raises(ParameterError, match="needs mode ideal"):
        get_suite("transfer", system=System(vehicle=BENT_THESIS, mode="emulated"))


def test_a_transfer_benchmark_plans_once_for_machines_described_alike():
    suite = transfer(BENT, "bent", 1)
    part = tuple((v, q) for v, q in suite.queries if q.duration == 1.0)
    chosen = {"as described", "payload 5 kg", "payload 5 kg, known"}
    suite = dataclasses.replace(suite, queries=tuple(k for k in part if k[0] in chosen))
    rows = run_benchmark(suite, planners=["direct"], workers=1)["rows"]
    of = {(r["planner"], r["vehicle"]): r for r in rows}
    blind, known = of["direct", "payload 5 kg"], of["direct", "payload 5 kg, known"]
    nominal = of["direct", "as described"]
    assert blind["predicted"] == nominal["predicted"]
    assert known["predicted"] != nominal["predicted"]
    assert known["E_mean"] < blind["E_mean"]
    assert known["E_mean"] == pytest.approx(known["predicted"], rel=0.3)


@pytest.mark.parametrize("name", ARM_SUITES)
def test_suites_of_an_arm_are_reach100_asked_of_it(name):
    arm = get_arm(ARM_SUITES[name])
    suite = get_suite(name, system=System())
    assert suite.name == name
    assert suite.planners == get_suite("reach100", system=System()).planners
    asked = reach100(System(arm=arm), "bent", 100)
    assert ends(suite) == ends(asked)
    assert all(q.system.arm is arm for _, q in suite.queries)
    with pytest.raises(ParameterError, match=f"{name} asks {arm.name}, got six"):
        get_suite(name, system=System(arm=dataclasses.replace(six_joint_arm(), name="six")))
