"""The vector environment as Stable-Baselines3 sees it."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.walks import IDS
from ves_gym._util.params import ParameterError

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.env_checker import check_env

from ves_gym.baselines.sb3 import Sb3VecEnv

SHORT = {"duration": 0.5, "tail": 0.5}  # 40 steps


def vector(id="ves/PumaRestToRest-v0", n=3, mode="SameStep", **settings):
    return gym.make_vec(id, num_envs=n, autoreset_mode=mode, threads=1, **settings)


def actions(rng, venv):
    return rng.uniform(-1, 1, (venv.num_envs, *venv.action_space.shape)).astype(np.float32)


def test_gives_what_the_environment_gives():
    venv, env = Sb3VecEnv(vector(**SHORT)), vector(**SHORT)
    assert venv.seed(5) == [5, 5, 5]
    first = venv.reset()
    np.testing.assert_array_equal(first, env.reset(seed=5)[0])

    rng, total = np.random.default_rng(0), np.zeros(3)
    for step in range(1, 81):
        action = actions(rng, venv)
        observation, reward, done, infos = venv.step(action)
        wanted = env.step(action)
        np.testing.assert_array_equal(observation, wanted[0])
        np.testing.assert_array_equal(reward, wanted[1].astype(np.float32))
        assert reward.dtype == np.float32
        total += wanted[1]
        assert done.all() == (step % 40 == 0)
        for i, info in enumerate(infos):
            if not done[i]:
                assert info == {}
                continue
            np.testing.assert_array_equal(
                info["terminal_observation"], wanted[4]["final_obs"][i]
            )
            assert info["TimeLimit.truncated"] is False  # the deadline is part of the task
            assert info["episode"]["r"] == pytest.approx(total[i], rel=1e-12)
            assert info["episode"]["l"] == 40 and info["episode"]["t"] > 0
            final = wanted[4]["final_info"]
            assert info["is_success"] == final["success"][i]
            assert info["energy/E_mean"] == final["energy/E_mean"][i]
        total[done] = 0


def test_a_time_limit_that_is_no_part_of_the_task_truncates():
    venv = Sb3VecEnv(vector("ves/PumaDamp-v0", duration=0.5))
    venv.seed(0)
    venv.reset()
    for _ in range(40):
        _, _, done, infos = venv.step(np.zeros((3, *venv.action_space.shape), np.float32))
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)


def test_an_endless_task_is_told_to_be_cut_off_but_for_failures():
    venv = Sb3VecEnv(vector(control="torque", duration=0.5), endless=True)
    venv.reset()
    for _ in range(40):
        done, infos = venv.step(np.zeros((3, 3), np.float32))[2:]
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)
    for _ in range(40):
        done, infos = venv.step(np.ones((3, 3), np.float32))[2:]
        if done.any():
            break
    (info,) = [infos[i] for i in np.flatnonzero(done)[:1]]
    assert info["episode"]["l"] < 40 and not info["TimeLimit.truncated"]


@pytest.mark.parametrize("hold", [1, 5])
def test_goals_are_a_dictionary_and_rewards_can_be_asked_again(hold):
    venv = Sb3VecEnv(vector("ves/PumaReachGoal-v0", duration=0.5), hold=hold, reward_scale=0.5)
    venv.seed(0)
    venv.reset()
    for _ in range(40 // hold):
        observation, reward, done, infos = venv.step(np.zeros((3, 3), np.float32))
    assert set(observation) == {"observation", "achieved_goal", "desired_goal"}
    last = [infos[i]["terminal_observation"] for i in range(3)]
    achieved, desired = (
        np.stack([o[k] for o in last]) for k in ("achieved_goal", "desired_goal")
    )
    (again,) = venv.env_method("compute_reward", achieved, desired, [{}] * 3, indices=[0])
    np.testing.assert_array_equal(again.astype(np.float32), reward)
    assert done.all() and set(reward) == {-0.5 * hold}
    (hit,) = venv.env_method("compute_reward", achieved[:1], achieved[:1], [{}], indices=[0])
    assert hit == 0


def test_options_reach_the_task():
    venv = Sb3VecEnv(vector(**SHORT))
    goals = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1], [0.0, 0.1, 0.0]])
    venv.set_options([{"goal": g} for g in goals])
    venv.reset()
    np.testing.assert_array_equal(venv.env.batch.scene.goal[:, :3], goals)
    venv.reset()
    assert not np.array_equal(venv.env.batch.scene.goal[:, :3], goals)


def test_attributes_are_those_of_the_whole():
    venv = Sb3VecEnv(vector(**SHORT))
    assert venv.get_attr("num_envs", indices=[0, 2]) == [3, 3]
    assert venv.get_attr("render_mode") == [None] * 3
    venv.set_attr("note", "kept")
    assert venv.get_attr("note", 1) == ["kept"] and venv.env.note == "kept"
    assert venv.env_is_wrapped(gym.Wrapper) == [False] * 3
    with pytest.raises(ParameterError, match="all 3 environments"):
        venv.set_attr("note", "lost", indices=[0])
    with pytest.raises(AttributeError):
        venv.get_attr("nothing")


def test_refuses_other_environments():
    with pytest.raises(ParameterError, match="VesVectorEnv, got SyncVectorEnv"):
        Sb3VecEnv(gym.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync"))
    with pytest.raises(ParameterError, match="hold >= 1"):
        Sb3VecEnv(vector(**SHORT), hold=0)


def test_an_action_is_held_and_rewards_add_up():
    """Torque throws the arm against its limits, at different times within a held action."""
    settings = {"control": "torque", "duration": 0.5, "tail": 0.5}
    venv, env = Sb3VecEnv(vector(n=4, **settings), hold=8), vector(n=4, **settings)
    venv.seed(3)
    np.testing.assert_array_equal(venv.reset(), env.reset(seed=3)[0])
    rng = np.random.default_rng(0)
    alive, ends = np.ones(4, bool), []
    for _ in range(5):
        action = np.sign(actions(rng, venv))
        observation, reward, done, infos = venv.step(action)
        total = np.zeros(4)
        for k in range(8):
            seen, gained, terminated, _, info = env.step(action)
            total += np.where(alive, gained, 0.0)
            for i in np.flatnonzero(alive & terminated):
                last = infos[i]["terminal_observation"]
                np.testing.assert_array_equal(last, info["final_obs"][i])
                assert infos[i]["episode"]["l"] == 8 * len(ends) + k + 1
            alive &= ~terminated
        ends.append(done)
        np.testing.assert_array_equal(
            reward[alive | done], total.astype(np.float32)[alive | done]
        )
        np.testing.assert_array_equal(observation[alive], seen[alive])
        if not alive.all():  # the other has begun anew in the middle of the action
            break
    assert not alive.all()


def test_continues_from_a_snapshot():
    venv = Sb3VecEnv(vector(**SHORT))
    venv.seed(1)
    venv.reset()
    rng = np.random.default_rng(0)
    for _ in range(30):
        venv.step(actions(rng, venv))
    kept, rest = venv.env.snapshot(), [actions(rng, venv) for _ in range(30)]
    first = [venv.step(a) for a in rest]
    venv.env.restore(kept)
    for a, (observation, reward, done, infos) in zip(rest, first, strict=True):
        again = venv.step(a)
        np.testing.assert_array_equal(again[0], observation)
        np.testing.assert_array_equal(again[1], reward)
        for i in np.flatnonzero(done):
            assert again[3][i]["episode"]["r"] == infos[i]["episode"]["r"]


@pytest.mark.parametrize("id", IDS)
def test_check_env_has_nothing_to_say(id):
    """Stable-Baselines3's own check, warnings being errors; and goals only where they are."""
    env = gym.make(id)
    assert hasattr(env.unwrapped, "compute_reward") == ("Goal" in id)
    check_env(env)
    check_env(env.unwrapped)
