"""Specifications tell how long episodes are; the task alone, or a caller's limit, ends them."""

import copy
import json
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from tests.envs.walks import SHORT, episode, same, walk
from ves_gym._util.params import ParameterError
from ves_gym.envs.env import VesEnv
from ves_gym.envs.vector import VesVectorEnv

ID = "ves/PumaRestToRest-v0"


def ends(env, seed=0):
    """(steps, terminated, truncated) of an episode of random actions."""
    env.reset(seed=seed)
    outcomes = episode(env, seed)
    return len(outcomes), *outcomes[-1][2:4]


@pytest.mark.parametrize(
    ("name", "duration"), [(ID, 2.0), (ID, 3.0), ("ves/PumaDamp-v0", 10.0)]
)
def test_the_task_ends_the_episode_as_it_says(name, duration):
    """Also later than by default."""
    env = gym.make(name, duration=duration)
    task = env.unwrapped.task
    env.reset(seed=0)
    for k in range(task.steps):
        *_, terminated, truncated, _ = env.step(np.zeros(3))
        assert (terminated, truncated) == (k == task.steps - 1, False), k
    vector = gym.make_vec(name, num_envs=2, duration=duration)
    vector.reset(seed=0)
    for _ in range(task.steps):
        *_, terminated, truncated, _ = vector.step(np.zeros((2, 3)))
    assert terminated.all() and not truncated.any()


def test_a_restored_episode_has_its_whole_length():
    """A count outside of the environment would end it early."""
    env = gym.make(ID, **SHORT)
    env.reset(seed=0)
    mark = env.unwrapped.snapshot()
    for _ in range(3):
        env.unwrapped.restore(mark)
        assert len(walk(env, 19, 0)) == 19
    *_, terminated, truncated, _ = env.step(np.zeros(3))
    assert (terminated, truncated) == (True, False)


def test_a_limit_of_the_callers_truncates():
    assert ends(gym.make(ID, max_episode_steps=7)) == (7, False, True)
    assert gym.make(ID, max_episode_steps=7).spec.max_episode_steps == 7
    for limit in (-1, 1000):
        assert ends(gym.make(ID, max_episode_steps=limit, **SHORT)) == (20, True, False)
    for bad in (0, -2, 1.5, True, "7"):
        with pytest.raises(ParameterError, match="max_episode_steps must be a whole number"):
            VesVectorEnv(1, max_episode_steps=bad)
    checked = gym.make(ID, disable_env_checker=False)
    assert type(checked) is gym.wrappers.PassiveEnvChecker
    assert VesEnv().spec is None and VesVectorEnv(2).spec is None


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_limit_of_a_vector_is_that_of_singles(mode):
    """Native and Gymnasium's own: the same flags at the same steps."""
    settings = {"num_envs": 2, "max_episode_steps": 7, **SHORT}
    ours = gym.make_vec(ID, autoreset_mode=mode, **settings)
    theirs = gym.make_vec(
        ID, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **settings
    )
    assert type(ours) is VesVectorEnv and type(theirs) is gym.vector.SyncVectorEnv
    assert ours.spec.max_episode_steps == 7
    ours.reset(seed=[1, 2]), theirs.reset(seed=[1, 2])
    truncations = 0
    for _ in range(30):
        flags = []
        for env in (ours, theirs):
            observation, _, terminated, truncated, _ = env.step(np.zeros((2, 3)))
            flags.append((observation, terminated, truncated))
        assert same(*flags)
        truncations += int(flags[0][2].sum())
        if mode is AutoresetMode.DISABLED and flags[0][2].any():
            options = {"reset_mask": flags[0][2]}
            assert same(*(env.reset(options=dict(options))[0] for env in (ours, theirs)))
    assert truncations >= 6
    assert ours.batch.episodes.number.tolist() == [truncations // 2] * 2


@pytest.mark.parametrize("settings", [{}, {"duration": 3.0}])
def test_what_is_made_of_a_specification_ends_alike(settings):
    """Of the registered one, of a made environment's, of their copies and of their JSON."""
    env = gym.make(ID, **settings)
    expected = ends(env)
    assert expected[1:] == (True, False)
    for spec in (env.spec, copy.deepcopy(env.spec), pickle.loads(pickle.dumps(env.spec))):
        again = gym.make(spec)
        assert again.spec == env.spec and ends(again) == expected
    text = env.spec.to_json()
    assert json.loads(text)["max_episode_steps"] is None
    assert ends(gym.make(EnvSpec.from_json(text))) == expected
    registered = EnvSpec.from_json(gym.spec(ID).to_json())
    assert ends(gym.make(registered, **settings)) == expected
    for made, steps in ((SHORT, 20), ({"max_episode_steps": 7}, 7)):
        vector = gym.make_vec(ID, num_envs=2, **made)
        again = gym.make_vec(EnvSpec.from_json(vector.spec.to_json()))
        assert again.num_envs == 2 and again.spec == vector.spec
        again.reset(seed=0)
        flags = [np.any(o[2] | o[3]) for o in walk(again, steps, 0)]
        assert flags[-1]
