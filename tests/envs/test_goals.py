"""Goal variants: what a step returned follows from its goals and its info."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.envs.walks import IDS, SHORT, actions

GOALS = [name for name in IDS if "Goal" in name]
FUNCTIONS = ("compute_reward", "compute_terminated", "compute_truncated")


def begun(name, **settings):
    env = gym.make(name, **{**SHORT, **settings}).unwrapped
    env.reset(seed=0)
    return env


def computed(env, observation, info):
    """What the three functions return of one step, or of many."""
    goals = observation["achieved_goal"], observation["desired_goal"]
    return tuple(getattr(env, name)(*goals, info) for name in FUNCTIONS)


@pytest.mark.parametrize("name", GOALS)
def test_every_step_is_what_goals_and_info_say(name):
    """Gymnasium-Robotics' contract, for a whole episode, one by one and all at once."""
    env = begun(name)
    check_env(gym.make(name).unwrapped, skip_render_check=True)
    rows = []
    for action in actions(env, 100, 0):
        observation, *outcome, info = env.step(action)
        assert computed(env, observation, info) == tuple(outcome)
        rows.append((observation, outcome, info))
        if any(outcome[1:]):
            break
    assert len(rows) == env.task.steps and outcome[1]
    stacked = {k: np.stack([o[k] for o, *_ in rows]) for k in rows[0][0]}
    infos = [info for *_, info in rows]
    for mine, theirs in zip(
        computed(env, stacked, infos), np.array([o for _, o, _ in rows]).T, strict=True
    ):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("name", GOALS)
def test_a_failure_is_in_all_three(name):
    env = begun(name)
    env.step(np.zeros(3, np.float32))
    s = env.batch.sim.state
    env.batch.sim.reset(q=s.q[0], v=3e9, y=s.y[0], ids=[0])
    observation, *outcome, info = env.step(np.zeros(3, np.float32))
    assert info["diverged"] and outcome[1:] == [True, False]
    assert outcome[0] == pytest.approx(1 - env.task.steps)  # as much as reaching nothing
    assert computed(env, observation, info) == tuple(outcome)


def test_only_goal_variants_compute_of_goals():
    plain = gym.make("ves/PumaReach-v0").unwrapped
    assert not any(hasattr(plain, name) for name in FUNCTIONS)


def test_other_goals_have_other_rewards_and_the_same_end():
    env = begun("ves/PumaReachGoal-v0")
    for _ in range(env.task.steps):
        observation, reward, terminated, _, info = env.step(np.zeros(3))
    assert reward == -1 and terminated
    moved = {**observation, "desired_goal": observation["achieved_goal"]}
    assert computed(env, moved, info) == (0.0, True, False)
    assert computed(env, moved, {}) == (0.0, False, False)  # nothing is known of that step


def test_hindsight_replay_takes_rewards_from_the_environment():
    """Of stable-baselines3: goals rewritten in hindsight are met, others are not."""
    her = pytest.importorskip("stable_baselines3.her")
    vec = pytest.importorskip("stable_baselines3.common.vec_env")
    venv = vec.DummyVecEnv([lambda: gym.make("ves/PumaReachGoal-v0", duration=0.25)])
    buffer = her.HerReplayBuffer(
        200, venv.observation_space, venv.action_space, venv, device="cpu", copy_info_dict=True
    )
    venv.seed(0)
    observation = venv.reset()
    for action in actions(venv, 100, 0):
        following, reward, done, infos = venv.step(action[None])
        buffer.add(observation, following, action[None], reward, done, infos)
        observation = following
    batch = buffer.sample(400)
    goals = [batch.next_observations[f"{k}_goal"].numpy() for k in ("achieved", "desired")]
    rewards = venv.envs[0].unwrapped.compute_reward(*goals, {})
    np.testing.assert_array_equal(batch.rewards.numpy()[:, 0], rewards)
    assert set(rewards) == {0.0, -1.0}
