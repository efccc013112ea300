"""The tasks reach and reach_goal: a point in space, on a base that sways."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.runs import EMULATED, Blind, controlled, unscaled
from tests.envs.walks import walk
from ves_gym._util.params import ParameterError
from ves_gym.baselines.resolved import Resolved
from ves_gym.envs.build import build_task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.kinematics import dexterity, joint_positions
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED
from ves_gym.mechanics.tool_pose import joints_for

# ------------------------------------------------------------------------- episodes


def test_targets_are_within_reach_and_in_time():
    """As the docstring says, of 500 drawn episodes; a few make do with the least excess."""
    task = build_task("reach")
    arm = task.system.arm
    begin = task.start(np.random.default_rng(0).random((500, task.draws)))
    q, miss = joints_for(arm, begin.goal[:, :3], begin.q)
    assert miss.max() < 1e-5
    scale = begin.goal[:, 3]
    assert 0.2 * np.median(scale) < scale.min() and scale.max() < 20 * np.median(scale)
    speed = np.abs(q - begin.q) * (2 * QUINTIC_PEAK_SPEED / task.duration)
    in_time = (speed <= arm.column("v_max")).all(axis=1)
    dexterous = dexterity(arm, q) >= task.dexterous
    print(f"in time {in_time.mean():.1%}, dexterous {dexterous.mean():.1%}")
    assert in_time.mean() > 0.95
    assert dexterous.mean() > 0.95


def test_observation_shows_what_is_missing():
    env = VesVectorEnv(4, "reach", **EMULATED)
    env.reset(seed=0)
    for _ in range(30):
        observation = env.step(np.full((4, 3), 0.5))[0]
    seen, scene = unscaled(env.task, observation), env.batch.scene
    gap = scene.goal[:, :3] - scene.tool_seen
    np.testing.assert_allclose(seen["to_target"], gap, atol=1e-6)
    np.testing.assert_allclose(seen["joint_angle"], scene.q, atol=1e-6)
    np.testing.assert_allclose(seen["time_left"][:, 0], 4.0 - scene.time, atol=1e-6)
    np.testing.assert_allclose(10 ** seen["energy_scale"], scene.goal[:, 3:], rtol=1e-5)


# --------------------------------------------------------------------- what is solved


def test_resolved_motion_solves_it_and_needs_to_see_the_base():
    """100 episodes: >= 95 % with the sway taken back; the same plan blind to it, fewer."""
    env, *_, info = controlled(Resolved(), 100, "reach")
    share = info["success"].mean()
    left = np.linalg.norm(env.batch.scene.goal[:, :3] - env.batch.scene.tool, axis=1)
    blind = controlled(Blind(), 100, "reach")[3]["success"].mean()
    print(f"solved {share:.0%}, blind {blind:.0%}; median {1e3 * np.median(left):.2f} mm left")
    assert share >= 0.95
    assert blind <= 0.8


def test_success_is_to_stay():
    """At the target from the start: solved after `hold`, and not while passing by."""
    task = build_task("reach")
    q = np.deg2rad([20.0, 30.0, -70.0])
    target = joint_positions(task.system.arm, q)[-1]
    env = gym.make("ves/PumaReach-v0").unwrapped
    env.reset(seed=0, options={"q": q, "target": target})
    solved = [env.step(np.zeros(3))[4]["success"] for _ in range(60)]
    periods = round(task.hold / task.system.control_dt)
    assert solved == [False] * (periods - 1) + [True] * (60 - periods + 1)
    gone = [env.step([1, 0, 0])[4] for _ in range(60)]
    assert not gone[-1]["success"] and gone[-1]["success_once"]
    env.reset(seed=0, options={"q": q, "target": target})
    assert not env.step(np.zeros(3))[4]["success"]  # counted anew


# -------------------------------------------------------------------------- options


def test_start_and_target_can_be_chosen():
    env = gym.make("ves/PumaReach-v0").unwrapped
    for seed in (0, 1):
        env.reset(seed=seed, options={"q": [0.1, 0.2, -0.9], "target": [0.5, 0.3, 0.9]})
        scene = env.batch.scene
        np.testing.assert_array_equal(scene.q[0], [0.1, 0.2, -0.9])
        np.testing.assert_allclose(scene.goal[0, :3], [0.5, 0.3, 0.9], atol=1e-6)
    vector = VesVectorEnv(2, "reach")
    vector.reset(seed=0, options={"target": [[0.5, 0.3, 0.9], [0.3, -0.4, 1.1]]})
    np.testing.assert_allclose(vector.batch.scene.goal[1, :3], [0.3, -0.4, 1.1], atol=1e-6)


# --------------------------------------------------------------------- goal variant


def test_goal_reward_is_that_of_step_bit_for_bit():
    """Along resolved motions, which cross the tolerance; float32 goals, any leading axes."""
    n, task = 6, "reach_goal"
    env = VesVectorEnv(n, task, goal=True, autoreset_mode="Disabled")
    observation, _ = env.reset(seed=0)
    controller, rows = Resolved(), []
    controller.reset(env, np.arange(n))
    for _ in range(env.task.steps):
        observation, reward, *_ = env.step(controller.act(env, observation))
        rows.append((observation["achieved_goal"], observation["desired_goal"], reward))
    achieved, desired, rewards = map(np.stack, zip(*rows, strict=True))
    assert achieved.dtype == desired.dtype == np.float32
    assert set(np.unique(rewards)) == {-1.0, 0.0}
    single = gym.make("ves/PumaReachGoal-v0").unwrapped
    np.testing.assert_array_equal(single.compute_reward(achieved, desired, {}), rewards)
    for index in ((5, 2), (300, 1), (slice(None), 3)):
        one = single.compute_reward(achieved[index], desired[index], {})
        np.testing.assert_array_equal(one, rewards[index])


def test_goal_variant_hides_nothing_else_of_the_goal():
    """What HER cannot rewrite does not depend on the target."""
    env = gym.make("ves/PumaReachGoal-v0").unwrapped
    seen = []
    for target in ([0.5, 0.3, 0.9], [0.3, -0.4, 1.1]):
        env.reset(seed=0, options={"target": target})
        seen.append([o[0] for o in walk(env, 5, 0)])
    for a, b in zip(*seen, strict=True):
        np.testing.assert_array_equal(a["observation"], b["observation"])
        np.testing.assert_array_equal(a["achieved_goal"], b["achieved_goal"])
        assert not np.array_equal(a["desired_goal"], b["desired_goal"])


def test_goal_variant_ends_at_the_deadline_only():
    env = gym.make("ves/PumaReachGoal-v0", control="pd_target").unwrapped
    env.reset(seed=0)
    outcomes = [env.step([1.0, 1.0, -1.0]) for _ in range(env.task.steps)]
    assert [o[2] for o in outcomes] == [False] * (len(outcomes) - 1) + [True]
    assert outcomes[-1][4]["energy/E_mean"] > 0
    with pytest.raises(ParameterError, match="no goal-conditioned variant"):
        gym.make("ves/PumaReach-v0", goal=True)
