"""A base that leaves its linear range says so, in a run, a plan and an environment."""

import gymnasium as gym
import numpy as np
import pytest

import ves_gym as vg
from ves_gym.mechanics.linear_range import linear_range, range_sentence
from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.run_summary import summarise

GOAL = np.array([1.2, -0.6, 0.9])  # rad


def test_bounds_are_a_tenth_of_a_radian_and_a_hundredth_of_the_length():
    np.testing.assert_allclose(linear_range(vg.get_vehicle("bent")), [0.16] * 3 + [0.1] * 3)
    np.testing.assert_array_equal(linear_range(vg.get_vehicle("servicer")), np.inf)
    assert linear_range(vg.get_vehicle("decoupled")).tolist() == [np.inf] * 3 + [0.1] * 3


@pytest.mark.parametrize(("at", "told"), [(0.159, False), (0.161, True), (-0.17, True)])
def test_both_sides_of_the_bound(at, told):
    y = np.zeros((3, 6))
    y[1, 2] = at
    sentence = range_sentence(vg.get_vehicle("bent"), y)
    assert (sentence is not None) == told
    assert (
        not told or "times the range in which its model is linear (0.16 m, 0.1 rad)" in sentence
    )


@pytest.mark.parametrize(("duration", "told"), [(2.0, False), (0.3, True)])
def test_a_run_and_a_plan_say_so(duration, told):
    system = vg.System(vehicle=vg.get_vehicle("straight-vertical"))
    motion = Motion.straight(np.zeros(3), GOAL, duration)
    log = vg.simulate(motion, system, settle=3.0)
    said = summarise(log, motion, settle=3.0).warnings
    assert any("model is linear" in k for k in said) == told
    plan = vg.plan(
        motion.start,
        GOAL,
        duration=duration,
        v_max=[99.0] * 3,
        planner="straight",
        system=system,
    )
    assert any("model is linear" in k for k in plan.notes) == told


@pytest.mark.parametrize("compiled", [True, False])
def test_an_environment_tells_it_in_its_info(compiled):
    env = gym.make("ves/PumaReach-v0", disable_env_checker=True).unwrapped
    env.reset(seed=0)
    if not compiled:
        _ = env.batch.scene
        env.batch._compiled = None
    still = np.zeros(env.action_space.shape, np.float32)
    assert "base/range" not in env.step(still)[4]
    env.batch.sim.reset(y=[0.0, 0.0, 0.0, 0.0, 0.3, 0.0])
    assert env.step(still)[4]["base/range"] > 1
    env.close()
