"""Every id, by every way there is to make it."""

import hashlib
import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.walks import IDS, KINDS, flat, walk

ROOT = Path(__file__).parents[2]
STEPS = 5


def digest(name: str) -> str:
    """What the first steps of an environment look like, as a hash."""
    env = gym.make(f"ves_gym:{name}")
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


def test_ids_in_a_spawned_worker():
    """The same seed gives the same steps in another process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(digest, KINDS) == [digest(name) for name in KINDS]


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
