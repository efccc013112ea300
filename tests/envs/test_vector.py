"""The vector environment: n single ones in lockstep, bit for bit."""

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from tests.envs.walks import IDS, SHORT, actions, flat, same, walk

ROOT = Path(__file__).parents[2]
STEPS = 12
IDEAL = "ves/PumaRestToRest-v0"
EMULATED = "ves/PumaRestToRestEmulated-v0"
each_id = pytest.mark.parametrize("name", IDS)
both = pytest.mark.parametrize("name", [IDEAL, EMULATED])
each_mode = pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])


def vector(name, n, **settings):
    return gym.make_vec(name, num_envs=n, **settings)


def singles(name, n, mode=AutoresetMode.NEXT_STEP, **settings):
    """Gymnasium's own loop over single environments."""
    return SyncVectorEnv([lambda: gym.make(name, **settings)] * n, autoreset_mode=mode)


# ------------------------------------------------------------------- batch equals single


@both
def test_size_and_threads_do_not_matter(name):
    """Eight lanes a block: 1, 3, 8 and 17 environments, 160 on one and on two threads."""
    expected = None
    moves = np.random.default_rng(0).uniform(-1, 1, (STEPS, 160, 3))
    for n, threads in ((160, 1), (160, 2), (17, 1), (8, 1), (3, 1), (1, 1)):
        env = vector(name, n, threads=threads)
        first, info = env.reset(seed=9)
        rows = [first, *(env.step(a[:n])[0] for a in moves)]
        seen = np.stack(rows)
        rewards = env.step(moves[0, :n])[1]
        if expected is None:
            expected = seen, rewards, info
        assert same(seen, expected[0][:, :n].copy()), (n, threads)
        assert same(rewards, expected[1][:n].copy()), (n, threads)
        assert all(same(info[k], expected[2][k][:n].copy()) for k in info)


# --------------------------------------------------------------- against SyncVectorEnv


def agree(ours, theirs, told=True):
    """Outcomes of a step or reset agree: what Gymnasium's loop tells, ours tells alike."""
    np.testing.assert_array_equal(flat(ours[0]), flat(theirs[0]))
    for a, b in zip(ours[1:-1], theirs[1:-1], strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    info_agrees(ours[-1], theirs[-1])


def info_agrees(ours, theirs, where="info"):
    """Every entry of `theirs` whose mask is set is in `ours`, and equal."""
    for key, value in theirs.items():
        if key.startswith("_"):
            continue
        assert key in ours, f"{where}[{key!r}] is missing"
        if isinstance(value, dict):
            info_agrees(ours[key], value, f"{where}[{key!r}]")
            continue
        for i in np.flatnonzero(theirs[f"_{key}"]):
            np.testing.assert_array_equal(
                ours[key][i], value[i], err_msg=f"{where}[{key!r}][{i}]"
            )
            assert f"_{key}" not in ours or ours[f"_{key}"][i]


@each_mode
@pytest.mark.parametrize("name", [IDEAL, EMULATED])
def test_autoreset_is_gymnasiums(name, mode):
    """Over three short episodes that end at different times."""
    n, seeds = 4, [3, 1, 4, 1]
    ours = vector(name, n, autoreset_mode=mode, **SHORT)
    theirs = singles(name, n, mode, **SHORT)
    assert ours.metadata["autoreset_mode"] is mode
    agree(ours.reset(seed=seeds), theirs.reset(seed=seeds))
    mask = np.array([False, True, False, True])
    moves = actions(ours, 70, 3)
    for k, a in enumerate(moves):
        agree(ours.step(a), theirs.step(a))
        if k == 7:  # from here on the episodes end at different times
            agree(*(e.reset(options={"reset_mask": mask.copy()}) for e in (ours, theirs)))


def test_same_step_keeps_the_last_observation():
    """The observation is the next episode's first; the last one is in `final_obs`."""
    env = vector(IDEAL, 2, autoreset_mode=AutoresetMode.SAME_STEP, **SHORT)
    env.reset(seed=0)
    for a in actions(env, 20, 0):
        observation, _, terminated, _, info = env.step(a)
    assert terminated.all() and info["_final_obs"].all()
    left = slice(24, 25)  # time_left
    np.testing.assert_allclose(info["final_obs"][:, left], 0, atol=1e-6)
    np.testing.assert_allclose(observation[:, left], 1)
    assert {"energy/E_mean", "reward/energy", "success"} <= set(info["final_info"])
    assert "final_obs" not in env.step(a)[4]


def test_disabled_waits_for_a_reset():
    ours = vector(IDEAL, 3, autoreset_mode=AutoresetMode.DISABLED, **SHORT)
    theirs = singles(IDEAL, 3, AutoresetMode.DISABLED, **SHORT)
    agree(ours.reset(seed=[1, 2, 3]), theirs.reset(seed=[1, 2, 3]))
    moves = actions(ours, 25, 1)
    for a in moves[:10]:
        agree(ours.step(a), theirs.step(a))
    mask = np.array([True, False, False])
    agree(*(e.reset(options={"reset_mask": mask.copy()}) for e in (ours, theirs)))
    for a in moves[10:20]:
        agree(ours.step(a), theirs.step(a))
    before = ours.snapshot()
    with pytest.raises(gym.error.ResetNeeded, match=r"environments \[1, 2\] are over"):
        ours.step(moves[20])
    assert same(ours.snapshot(), before)
    agree(*(e.reset(options={"reset_mask": ~mask}) for e in (ours, theirs)))
    for a in moves[20:]:
        agree(ours.step(a), theirs.step(a))


# ------------------------------------------------------------------------ partial resets


@both
def test_a_partial_reset_leaves_the_others_alone(name):
    env, twin = vector(name, 4), vector(name, 4)
    env.reset(seed=1), twin.reset(seed=1)
    walk(env, STEPS, 1), walk(twin, STEPS, 1)
    mask = np.array([False, True, False, False])
    observation, _info = env.reset(options={"reset_mask": mask})
    assert env.episode_id[:, 2].tolist() == [0, 1, 0, 0]
    for ours, theirs in zip(walk(env, STEPS, 2), walk(twin, STEPS, 2), strict=True):
        assert same(ours[0][~mask], theirs[0][~mask])
        assert same(ours[1][~mask], theirs[1][~mask])
    alone = gym.make(name)
    alone.reset(seed=1, options={"index": 1})
    assert same(observation[1], alone.reset()[0])


# ----------------------------------------------------------------------- seeds, copies


def test_seeds_are_an_integer_or_a_list():
    env = vector(IDEAL, 3)
    env.reset(seed=4)
    assert env.episode_id.tolist() == [[4, 0, 0], [4, 1, 0], [4, 2, 0]]
    for seeds in ([7, 8, 7], np.array([7, 8, 7]), (7, 8, 7)):
        observation, _info = env.reset(seed=seeds)
        assert env.episode_id.tolist() == [[7, 0, 0], [8, 0, 0], [7, 0, 0]]
        assert same(observation[0], observation[2])
    for none in (None, [None, None]):  # from the system's entropy, at first; then as it goes on
        ours, theirs = vector(IDEAL, 2), vector(IDEAL, 2)
        assert not same(ours.reset(seed=none)[0], theirs.reset(seed=none)[0])
        before, after = ((ours.reset(seed=none), ours.episode_id)[1] for _ in range(2))
        assert (after - before).tolist() == [[0, 0, 1]] * 2


@both
def test_options_are_given_row_by_row(name):
    q = np.array([[0.1, 0.2, 0.3], [-0.1, -0.2, -0.3]])
    env = vector(name, 2)
    observation, _ = env.reset(seed=0, options={"q": q, "goal": 2 * q})
    np.testing.assert_allclose(observation[:, :3] * np.pi, q, rtol=1e-6)
    alone = gym.make(name)
    for i in range(2):
        first, _ = alone.reset(seed=0, options={"index": i, "q": q[i], "goal": 2 * q[i]})
        assert same(observation[i], first)


@both
@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_continue_identically(name, how):
    """Some of them just over, waiting for their next episode."""
    env, undisturbed = (vector(name, 3, **SHORT) for _ in range(2))
    for e in (env, undisturbed):
        e.reset(seed=0)
        walk(e, 6, 0)
        e.reset(options={"reset_mask": np.array([True, False, False])})
        walk(e, 14, 0)
    before = env.snapshot()
    assert before[2].tolist() == [False, True, True]
    twin = how(env)
    walk(twin, 3, 1)
    assert same(env.snapshot(), before)
    twin = how(env)
    runs = [walk(e, 30, 2) for e in (env, twin, undisturbed)]
    assert same(runs[0], runs[1])
    assert same(runs[0], runs[2])


# ------------------------------------------------------------------------------- memory


_MEMORY = """
import sys
import gymnasium as gym
env = gym.make_vec("ves_gym:" + sys.argv[1], num_envs=4096, duration=0.05)
env.reset(seed=0)
for _ in range(6):  # through the end, where most is needed
    env.step(env.action_space.sample())
for line in open("/proc/self/status"):  # `getrusage` also counts the parent before exec
    if line.startswith("VmHWM"):
        print(int(line.split()[1]) / 1024)
"""


@pytest.mark.parametrize("name", [IDEAL, pytest.param(EMULATED, marks=pytest.mark.slow)])
@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="no /proc")
def test_4096_environments_fit_in_2_GB(name):
    done = subprocess.run(
        [sys.executable, "-c", _MEMORY, name],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    used = float(done.stdout)  # MiB, of the whole process
    print(f"4,096 x {name}: {used:.0f} MiB")
    assert used < 2000
