"""The vector environment as Stable-Baselines3 sees it."""

import re
import textwrap
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import ves_gym as vg
from tests.envs.walks import IDS
from ves_gym._util.params import ParameterError

pytest.importorskip("stable_baselines3")
import stable_baselines3
from stable_baselines3.common.env_checker import check_env

from ves_gym.baselines.sb3 import Sb3VecEnv, from_sb3

SHORT = {"duration": 0.5, "tail": 0.5}  # 40 steps


def vector(id="ves/PumaRestToRest-v0", n=3, mode="SameStep", **settings):
    return gym.make_vec(id, num_envs=n, autoreset_mode=mode, threads=1, **settings)


def actions(rng, venv):
    return rng.uniform(-1, 1, (venv.num_envs, *venv.action_space.shape)).astype(np.float32)


def test_gives_what_the_environment_gives():
    venv, env = Sb3VecEnv(vector(**SHORT)), vector(**SHORT)
    assert venv.seed(5) == [5, 6, 7]
    first = venv.reset()
    np.testing.assert_array_equal(first, env.reset(seed=[5, 6, 7])[0])

    rng, total = np.random.default_rng(0), np.zeros(3)
    for step in range(1, 81):
        action = actions(rng, venv)
        observation, reward, done, infos = venv.step(action)
        expected = env.step(action)
        np.testing.assert_array_equal(observation, expected[0])
        np.testing.assert_array_equal(reward, expected[1].astype(np.float32))
        assert reward.dtype == np.float32
        total += expected[1]
        assert done.all() == (step % 40 == 0)
        for i, info in enumerate(infos):
            if not done[i]:
                assert info == {}
                continue
            np.testing.assert_array_equal(
                info["terminal_observation"], expected[4]["final_obs"][i]
            )
            assert info["TimeLimit.truncated"] is False  # the deadline is part of the task
            assert info["episode"]["r"] == pytest.approx(total[i], rel=1e-12)
            assert info["episode"]["l"] == 40 and info["episode"]["t"] > 0
            final = expected[4]["final_info"]
            assert info["is_success"] == final["success"][i]
            assert info["energy/E_mean"] == final["energy/E_mean"][i]
        total[done] = 0


def test_goals_are_a_dictionary_and_rewards_can_be_asked_again():
    hold = 5
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


def test_the_library_says_which_adapter_a_vector_needs():
    with pytest.raises(ValueError, match=r"baselines.sb3.Sb3VecEnv\(env\)"):
        stable_baselines3.PPO("MlpPolicy", vector(**SHORT))


def test_an_action_is_held_and_rewards_add_up():
    """Torque throws the arm against its limits, at different times within a held action."""
    settings = {"control": "torque", "duration": 0.5, "tail": 0.5}
    venv, env = Sb3VecEnv(vector(n=4, **settings), hold=8), vector(n=4, **settings)
    venv.seed(3)
    np.testing.assert_array_equal(venv.reset(), env.reset(seed=[3, 4, 5, 6])[0])
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


FEW = ("ves/PumaReachGoal-v0", "ves/PumaDampEmulated-v0")


@pytest.mark.parametrize(
    "id", [*FEW, *(pytest.param(k, marks=pytest.mark.slow) for k in IDS if k not in FEW)]
)
def test_check_env_has_nothing_to_say(id):
    """Stable-Baselines3's own check, warnings being errors; and goals only where they are."""
    env = gym.make(id)
    assert hasattr(env.unwrapped, "compute_reward") == ("Goal" in id)
    check_env(env)
    check_env(env.unwrapped)


# ----------------------------------------------------------------------- policies


@pytest.mark.parametrize("algorithm", ["PPO", "SAC", "SAC with goals"])
def test_acts_like_the_torch_network(algorithm):
    """Tolerance: rounding of torch's float32; ours is float64."""
    id = "ves/PumaReachGoal-v0" if "goals" in algorithm else "ves/PumaRestToRest-v0"
    env = gym.make_vec(id, num_envs=4, threads=1, duration=0.5)
    kind = "MultiInputPolicy" if env.goal else "MlpPolicy"
    options = {"buffer_size": 100} if "SAC" in algorithm else {"n_steps": 40, "batch_size": 80}
    cls = getattr(stable_baselines3, algorithm[:3])
    model = cls(kind, Sb3VecEnv(env), device="cpu", seed=1, **options)
    if algorithm == "PPO":  # its last layer starts next to zero
        model.policy.action_net.weight.data.mul_(50)
    policy = from_sb3(model)
    assert policy.network.hold == 1

    observation, _ = env.reset(seed=3)
    largest = 0.0
    for _ in range(40):
        expected, _ = model.predict(observation, deterministic=True)
        got = policy.act(env, observation)
        largest = max(largest, np.abs(got).max())
        np.testing.assert_allclose(got, expected, atol=1e-6)
        observation = env.step(got)[0]
    assert largest > 0.01


def test_the_recipe_of_the_page_makes_a_policy(tmp_path, monkeypatch):
    """docs/extending.md, but for the number of decisions; a zip is read as it says."""
    page = (Path(__file__).parents[2] / "docs" / "extending.md").read_text("utf-8")
    block = re.search(r"\n\n(    import gymnasium.*?)\n\n\S", page, re.DOTALL)[1]
    short = textwrap.dedent(block).replace("300_000", "6_500")
    assert short.count("6_500") == 1
    read = re.search(r"`(from_sb3\(SAC\.load.*?\))`", page)[1]
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(short, names)
    policy = vg.load_policy("mine.json")
    assert policy.network.hold == 4
    names["model"].save("model.zip")
    again = eval(read, names)
    assert again.network == policy.network
    np.testing.assert_array_equal(again.weights[0][0], policy.weights[0][0])
