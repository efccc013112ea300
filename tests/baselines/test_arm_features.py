"""Inputs that the arm's kinematics give: right, alone in their row, and in the file."""

import itertools

import gymnasium as gym
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.arm_features import arm_features
from ves_gym.baselines.policy import Network, Policy, load_policy, save_policy
from ves_gym.baselines.ppo import flat
from ves_gym.baselines.resolved import carried
from ves_gym.envs.pose_reach import goal_pose
from ves_gym.mechanics.kinematics import joint_positions, tool_frame, tool_twists
from ves_gym.mechanics.spatial import matvec, rotation, twist


def moving(id, n=12):
    """Environments in the middle of random motions, and what is observed."""
    env = gym.make_vec(id, num_envs=n, threads=1)
    observation, _ = env.reset(seed=5)
    draw = np.random.default_rng(0)
    for _ in range(40):
        observation, *_ = env.step(draw.uniform(-1, 1, (n, 3)))
    return env, flat(observation)


@pytest.mark.parametrize("id", ["ves/PumaReach-v0", "ves/PumaReachGoal-v0"])
def test_they_are_the_joint_motion_that_is_missing(id):
    """Against differences of the tool's place: no Jacobian, no cofactors."""
    env, rows = moving(id)
    features = arm_features(env.task, env.goal)
    s, arm = env.batch.scene, env.task.system.arm
    near, far, taken, sines, cosines, tool = np.split(
        features(rows), np.arange(3, features.size, 3), axis=1
    )
    q, turn = s.q, np.swapaxes(rotation(s.y_seen), -1, -2)
    place = joint_positions(arm, q)[:, -1]
    step = 1e-6 * np.eye(3)
    J = np.stack([(joint_positions(arm, q + k)[:, -1] - place) / 1e-6 for k in step], axis=-1)
    for i in range(len(q)):
        # least squares with damping: rows of the damping below those of the Jacobian
        A = np.concatenate([J[i], 0.05 * np.eye(3)])
        wanted = turn[i] @ (s.goal[i, :3] - s.tool_seen[i])
        left = np.linalg.lstsq(A, np.concatenate([wanted, np.zeros(3)]), rcond=None)[0]
        np.testing.assert_allclose(far[i], np.clip(left, -2, 2), atol=2e-4)
        np.testing.assert_allclose(near[i], np.clip(left, -0.25, 0.25) * 4, atol=1e-3)
        y, ahead = s.y_seen[i], s.y_seen[i] + 1e-6 * s.yd_seen[i]
        gone = ahead[:3] + rotation(ahead) @ place[i] - y[:3] - rotation(y) @ place[i]
        carried = turn[i] @ gone / 1e-6
        rates = np.linalg.lstsq(A, np.concatenate([carried, np.zeros(3)]), rcond=None)[0]
        np.testing.assert_allclose(taken[i], np.clip(2 * rates, -1, 1), atol=2e-4)
    np.testing.assert_allclose(tool, place, atol=1e-5)
    np.testing.assert_allclose(np.arctan2(sines, cosines), q, atol=1e-5)


def test_of_a_pose_they_are_the_joint_angles_that_give_it():
    """In closed form; against `tool_frame`, and a least-squares step."""
    control = {"kind": "joint_velocity"}
    env = gym.make_vec("ves/PoseReach-v0", num_envs=12, threads=1, control=control)
    observation, _ = env.reset(seed=5)
    n, draw = env.task.system.arm.n, np.random.default_rng(0)
    for _ in range(10):
        observation, *_ = env.step(draw.uniform(-0.5, 0.5, (12, n)))
    features = arm_features(env.task)
    s, robot = env.batch.scene, env.task.system.arm
    near, far, taken, _, _, rest = np.split(
        features(observation), np.arange(n, 5 * n + 1, n), 1
    )
    assert features.size == 5 * n + 21
    place, turn = tool_frame(robot, s.q)
    tool, has, asked = np.split(rest, [3, 12], axis=1)
    np.testing.assert_allclose(tool, place, atol=1e-5)
    np.testing.assert_allclose(has.reshape(-1, 3, 3), np.swapaxes(turn, 1, 2), atol=1e-5)
    back = np.swapaxes(rotation(s.y_seen), 1, 2)
    goal, goal_turn = goal_pose(s)
    goal, goal_turn = matvec(back, goal - s.y_seen[:, :3]), back @ goal_turn
    axes = asked.reshape(-1, 3, 3)
    # half a turn has no axis: of what is next to it a share of 1e-5 / (1 + cosine) is missing
    clear = observation[:, features.turn + 3] > -0.98
    wanted = np.swapaxes(goal_turn, 1, 2)
    np.testing.assert_allclose(axes[clear], wanted[clear], atol=1e-3)
    there = clear & (np.abs(far).max(1) < 6.3)
    assert there.sum() == clear.sum() >= 4
    end, end_turn = tool_frame(robot, (s.q + far)[there])
    np.testing.assert_allclose(end, goal[there], atol=1e-3)
    np.testing.assert_allclose(end_turn, goal_turn[there], atol=5e-3)
    np.testing.assert_allclose(near, np.clip(far, -0.25, 0.25) * 4, atol=1e-6)
    J = tool_twists(robot, s.q) * np.array([1, 1, 1, 0.3, 0.3, 0.3])[:, None]
    moved = carried(twist(s.y_seen, s.yd_seen), place) * np.array([1, 1, 1, 0.3, 0.3, 0.3])
    for i in range(len(J)):
        A = np.concatenate([J[i], 0.03 * np.eye(n)])
        rates = np.linalg.lstsq(A, np.concatenate([moved[i], np.zeros(n)]), rcond=None)[0]
        np.testing.assert_allclose(taken[i], np.clip(2 * rates, -1, 1), atol=2e-4)


def test_a_file_says_them_and_a_row_does_not_depend_on_its_neighbours(tmp_path):
    env, rows = moving("ves/PumaReachGoal-v0")
    features = arm_features(env.task, env.goal)
    sizes = (len(features.scales) + features.size, 16, 3)
    draw = np.random.default_rng(0)
    weights = tuple(
        (draw.normal(size=(a, b)).astype(np.float32).astype(float), np.zeros(b))
        for a, b in itertools.pairwise(sizes)
    )
    policy = Policy(Network(sizes=sizes, features=features), weights, {"env": "x"})
    actions = policy(rows)
    for n in (1, 7):
        np.testing.assert_array_equal(policy(rows[:n]), actions[:n])
    again = load_policy(save_policy(policy, tmp_path / "p.json"))
    assert again.network == policy.network and again.network.observations == 28
    np.testing.assert_array_equal(again(rows), actions)


def test_what_does_not_fit_is_refused():
    env, _ = moving("ves/PumaReach-v0", 1)
    features = arm_features(env.task)
    with pytest.raises(ParameterError, match="features are of one observation of 26"):
        Network(sizes=(45, 3), features=features)
    with pytest.raises(ParameterError, match="got 2 of"):
        Network(sizes=(44, 3), features=features, frames=2)
    plain = {"arm": "puma560", "scales": (1.0,) * 20, "base_pose": 3, "base_rate": 9}
    for changes, message in (
        ({"arm": "puma"}, "arm must be one of"),
        ({"target": 18}, "target must be 0 to 17, got 18"),
        ({"turn": 17}, "turn must be -1 to 16"),
        ({"turn": 0}, "need an arm with a spherical wrist, got puma560"),
    ):
        with pytest.raises(ParameterError, match=message):
            type(features)(**{**plain, "joint_angle": 0, "target": 15, **changes})
    track = gym.make_vec("ves/PumaTrack-v0", num_envs=1, threads=1)
    with pytest.raises(ParameterError, match="need target in the observation"):
        arm_features(track.task)
