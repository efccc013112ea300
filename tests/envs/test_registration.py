"""Every id, by every way there is to make it."""

import hashlib
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from tests.envs.walks import IDS, flat, same, walk
from ves_gym.envs.env import VesEnv
from ves_gym.envs.registration import register
from ves_gym.envs.vector import VesVectorEnv

ROOT = Path(__file__).parents[2]
STEPS = 5


def digest(name: str) -> str:
    """What the first steps of an environment look like, as a hash."""
    env = gym.make(name)
    env.reset(seed=3)
    seen = [np.append(flat(out[0]).astype(float), out[1]) for out in walk(env, STEPS, 0)]
    return hashlib.sha256(np.array(seen).tobytes()).hexdigest()


def fresh(code: str, *arguments: str) -> str:
    """What a new Python process prints; warnings are errors, and nothing else may appear."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_there_are_ids():
    assert {"ves/PumaRestToRest-v0", "ves/PumaRestToRestEmulated-v0"} <= set(IDS)


@pytest.mark.parametrize("name", IDS)
def test_make(name):
    env = gym.make(name)
    assert type(env.unwrapped) is VesEnv
    assert env.spec.id == name
    again = gym.make(f"ves_gym:{name}")
    assert same(env.reset(seed=1), again.reset(seed=1))
    assert same(walk(env, STEPS, 0), walk(again, STEPS, 0))


@pytest.mark.parametrize("name", IDS)
def test_make_vec(name):
    native = gym.make_vec(name, num_envs=2)
    sync = gym.make_vec(name, num_envs=2, vectorization_mode="sync")
    assert type(native.unwrapped) is VesVectorEnv
    assert type(sync) is gym.vector.SyncVectorEnv
    assert native.single_observation_space == sync.single_observation_space
    assert native.single_action_space == sync.single_action_space
    assert native.observation_space == sync.observation_space
    assert native.action_space == sync.action_space
    assert native.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"]
    native.close(), sync.close()


@pytest.mark.parametrize(
    "name", [IDS[0], *(pytest.param(name, marks=pytest.mark.slow) for name in IDS[1:])]
)
def test_async_in_spawned_workers(name):
    """The workers have not imported the package; the specification names its modules."""
    workers = gym.make_vec(
        name, num_envs=2, vectorization_mode="async", vector_kwargs={"context": "spawn"}
    )
    sync = gym.make_vec(name, num_envs=2, vectorization_mode="sync")
    try:
        first, expected = workers.reset(seed=[4, 5])[0], sync.reset(seed=[4, 5])[0]
        np.testing.assert_array_equal(flat(first), flat(expected))
        for ours, theirs in zip(walk(workers, STEPS, 0), walk(sync, STEPS, 0), strict=True):
            np.testing.assert_array_equal(flat(ours[0]), flat(theirs[0]))
            np.testing.assert_array_equal(ours[1], theirs[1])
    finally:
        workers.close(), sync.close()


def test_every_id_in_a_spawned_worker():
    """The same seed gives the same steps in another process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(digest, IDS) == [digest(name) for name in IDS]


def test_module_and_id_need_no_import_and_print_nothing():
    """`ves_gym:ves/...` in a new process: the same steps, and no output but what we print."""
    code = (
        "import sys, json\n"
        "import gymnasium as gym\n"
        "for name in json.loads(sys.argv[1]):\n"
        "    env = gym.make(f'ves_gym:{name}')\n"
        "    env.action_space.seed(0)\n"
        "    print(env.reset(seed=3)[0] is not None, end='')\n"
        "    env.step(env.action_space.sample()), env.close()\n"
    )
    assert fresh(code, json.dumps(IDS)) == "True" * len(IDS)


@pytest.mark.parametrize("name", IDS)
def test_specification_survives_json(name):
    env = gym.make(name, vehicle="decoupled") if "Puma" in name else gym.make(name)
    read = EnvSpec.from_json(env.spec.to_json())
    again = gym.make(read)
    assert again.spec == env.spec
    assert again.unwrapped.task == env.unwrapped.task
    assert same(env.reset(seed=2), again.reset(seed=2))
    assert same(walk(env, STEPS, 1), walk(again, STEPS, 1))


def test_registering_twice_changes_nothing():
    before = dict(gym.registry)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        register()
        importlib.reload(sys.modules["ves_gym.envs"])
    assert list(gym.registry) == list(before)
    assert all(gym.registry[name] is spec for name, spec in before.items())


def test_a_registration_of_the_user_stays():
    code = (
        "import gymnasium as gym\n"
        "gym.register('ves/PumaRestToRest-v0', entry_point='mine:Env')\n"
        "import ves_gym\n"
        "print(gym.spec('ves/PumaRestToRest-v0').entry_point)\n"
    )
    assert fresh(code) == "mine:Env\n"


def test_unknown_ids_and_settings_are_refused_by_name():
    with pytest.raises(gym.error.Error, match="PumaRestToRest"):
        gym.make("ves/PumaRestToRset-v0")
    expected = (
        r"unexpected keyword argument 'durations'; known: .*duration.*you mean \"duration\""
    )
    for make in (gym.make, gym.make_vec):
        with pytest.raises(TypeError, match=expected):
            make(IDS[0], durations=1.0)
    with pytest.raises(TypeError, match=r"'back_end'; known: .*\bbackend.*mean \"backend\""):
        gym.make(IDS[0], back_end="kernel")
    with pytest.raises(Exception, match="task must be one of rest_to_rest"):
        gym.make(IDS[0], task="dance")
