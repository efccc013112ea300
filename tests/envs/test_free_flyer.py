"""The task free_flyer: a point in space, on a satellite that nothing holds."""

import gymnasium as gym
import numpy as np

from tests.envs.runs import EMULATED, controlled, unscaled
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.build import build_task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.spatial import matvec, rotation, twist

# ------------------------------------------------------------------------- contract


def test_observation_shows_the_target_as_the_base_sees_it():
    env = VesVectorEnv(4, "free_flyer", **EMULATED)
    env.reset(seed=0)
    for _ in range(60):
        observation = env.step(np.full((4, 3), 0.5))[0]
    seen, s = unscaled(env.task, observation), env.batch.scene
    # base and tool in space, then the target from the tool: back to the target
    tool = matvec(rotation(s.y_seen), joint_positions(env.task.system.arm, s.q)[:, -1])
    there = s.y_seen[:, :3] + tool + matvec(rotation(s.y_seen), seen["to_target"])
    np.testing.assert_allclose(there, s.goal, atol=1e-6)
    np.testing.assert_allclose(seen["base_pose"], s.y_seen, atol=1e-7)


# ------------------------------------------------------------------------- episodes


def test_targets_are_away_and_within_reach():
    """By forward kinematics of joint angles in the box; 0.3 m from the start or more."""
    task = build_task("free_flyer")
    begin = task.start(np.random.default_rng(0).random((500, task.draws)))
    tool = joint_positions(task.system.arm, begin.q)[:, -1]
    way = np.linalg.norm(begin.goal - tool, axis=1)
    assert (way >= 0.3).mean() > 0.99
    out = np.abs(np.rad2deg(begin.q) - [0, 30, -90]).max(axis=0)
    np.testing.assert_allclose(out, [75, 35, 30], rtol=0.03)
    shoulder = np.linalg.norm(begin.goal[:, :2], axis=1), begin.goal[:, 2] - 0.9
    assert np.hypot(*shoulder).max() < 0.8  # the arm stretched out: 0.88 m


def test_options_choose_start_and_target():
    env = gym.make("ves/FreeFlyerReach-v0").unwrapped
    q, target = [0.2, 0.5, -1.5], [0.6, 0.2, 0.8]
    env.reset(seed=0, options={"q": q, "target": target})
    s = env.batch.scene
    np.testing.assert_array_equal(s.q[0], q)
    np.testing.assert_array_equal(s.goal[0], target)
    np.testing.assert_array_equal(env.task.marker(s), [[target]])


def test_momentum_stays_zero():
    """H_b V + H_bm q' of satellite and arm vanishes, to what rk4 leaves of its parts."""
    env = VesVectorEnv(8, "free_flyer")
    env.reset(seed=0)
    noise = np.random.default_rng(0)
    for _ in range(80):
        env.step(noise.uniform(-1, 1, (8, 3)))
    s, system = env.batch.scene, env.task.system
    H = inertia(system.arm, s.q)
    whole = H[:, :6, :6] + system.base.mass_matrix
    base = matvec(whole, twist(s.y, s.yd))
    joints = matvec(H[:, :6, 6:], s.v)
    size = np.abs(joints).max(axis=0)
    assert (size > 0.1).all()  # kg m/s, kg m^2/s
    assert (np.abs(base + joints).max(axis=0) < 2e-6 * size).all()


def test_resting_costs_the_way():
    env, _, costs, info = controlled(get_controller("zero"), 16, "free_flyer", duration=0.5)
    assert set(costs) == {"distance", "energy", "turn"}
    s = env.batch.scene
    way = np.linalg.norm(s.goal - joint_positions(env.task.system.arm, s.q)[:, -1], axis=1)
    np.testing.assert_allclose(costs["distance"], way / 0.5, rtol=1e-6)
    assert (costs["energy"] + costs["turn"]).max() < 1e-9
    assert not info["success_once"].any()


def test_tumbling_is_a_failure():
    env = gym.make("ves/FreeFlyerReach-v0", tumble=0.01)
    env.reset(seed=0)
    for _ in range(400):
        _, _, terminated, _, info = env.step([1.0, 0, 0])
        if terminated:
            break
    y = env.unwrapped.batch.scene.y[0]
    assert terminated and info["reward/failure"] < -0.5
    assert 0.01 < np.abs(y[3:]).max() < 0.02
