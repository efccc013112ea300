"""The vector environment: n single ones in lockstep, bit for bit."""

import copy
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from multiprocessing import active_children
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from tests.envs.walks import IDS, SHORT, actions, flat, part, same, walk
from ves_gym._util.params import ParameterError
from ves_gym.envs.batch import ActionError
from ves_gym.envs.vector import AsyncVectorEnv, EnvWorkerDied

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


def row(value, i):
    """What a batch of outcomes says of environment i."""
    if isinstance(value, dict):
        return {k: row(v, i) for k, v in value.items()}
    return value[i]


# ------------------------------------------------------------------- batch equals single


@each_id
def test_batch_equals_single(name):
    """Environment i after reset(seed) is the single one after reset(seed, index i)."""
    n = 3
    env = vector(name, n)
    observation, info = env.reset(seed=6)
    ids = env.episode_id
    moves = actions(env, STEPS, 0)
    outcomes = [env.step(a) for a in moves]
    for i in range(n):
        alone = gym.make(name)
        first, told = alone.reset(seed=6, options={"index": i})
        assert same(row(observation, i), first)
        assert same(ids[i], alone.unwrapped.episode_id)
        assert same(row(info, i), told)
        for (obs, reward, *flags, info_n), a in zip(outcomes, moves, strict=True):
            o, r, terminated, truncated, info_1 = alone.step(a[i])
            assert same(row(obs, i), o)
            assert same(float(reward[i]), r)
            assert [bool(f[i]) for f in flags] == [terminated, truncated]
            for term, value in part(info_1, "reward").items():
                assert same(info_n[f"reward/{term}"][i], value)
            if terminated or truncated:
                break


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


@both
def test_backend_mujoco_is_a_batch_of_singles_too(name):
    env = vector(name, 3, backend="mujoco")
    alone = gym.make(name, backend="mujoco")
    first = env.reset(seed=2)[0]
    assert same(first[2], alone.reset(seed=2, options={"index": 2})[0])
    for a in actions(env, STEPS, 1):
        assert same(env.step(a)[0][2], alone.step(a[2])[0])


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


@each_id
def test_autoreset_of_every_task(name):
    """To the end of an episode and into the next, as Gymnasium's loop."""
    ours, theirs = vector(name, 2, **SHORT), singles(name, 2, **SHORT)
    agree(ours.reset(seed=[5, 6]), theirs.reset(seed=[5, 6]))
    ends = 0
    for a in actions(ours, ours.unwrapped.task.steps + 5, 3):
        outcome = ours.step(a)
        agree(outcome, theirs.step(a))
        ends += int((outcome[2] | outcome[3]).sum())
    assert ends >= 2


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


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_autoreset_modes_go_by_their_names(mode):
    assert vector(IDEAL, 1, autoreset_mode=mode).autoreset_mode is AutoresetMode(mode)
    with pytest.raises(ValueError, match="NEXT_STEP"):
        vector(IDEAL, 1, autoreset_mode="NEXT_STEP")


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


def test_a_partial_reset_may_bring_seeds():
    env = vector(IDEAL, 3)
    env.reset(seed=1)
    mask = np.array([True, False, True])
    before = env.snapshot()[0]
    observation, _info = env.reset(seed=[7, 8, None], options={"reset_mask": mask})
    assert env.episode_id.tolist() == [[7, 0, 0], [1, 1, 0], [1, 2, 1]]
    assert same(observation[0], gym.make(IDEAL).reset(seed=7)[0])
    assert same(env.snapshot()[0][1][0].q[1], before[1][0].q[1])


@pytest.mark.parametrize(
    "mask", [np.array([True]), np.ones(3), [1, 0, 1], None, np.ones((3, 1), bool), "all"]
)
def test_a_bad_mask_is_refused(mask):
    env = vector(IDEAL, 3)
    env.reset(seed=0)
    before = env.snapshot()
    with pytest.raises(gym.error.Error, match="reset_mask must be 3 truth values"):
        env.reset(seed=1, options={"reset_mask": mask})
    assert same(env.snapshot(), before)


def test_the_first_reset_is_for_everyone():
    env = vector(IDEAL, 2)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(np.zeros((2, 3)))
    with pytest.raises(gym.error.ResetNeeded, match="every environment"):
        env.reset(options={"reset_mask": np.array([True, False])})


# -------------------------------------------------------------------- what is refused


@each_id
def test_bad_actions_are_refused_and_change_nothing(name):
    env = vector(name, 3)
    env.reset(seed=0)
    walk(env, 3, 0)
    before = env.snapshot()
    good = np.zeros(env.action_space.shape)
    wrong = good.copy()
    wrong[2, 1] = np.nan
    for action in (wrong, good[:2], good[:, :-1], good[0], 0.0, None, "x", good > 1):
        with pytest.raises(ActionError, match="finite numbers of shape"):
            env.step(action)
        assert same(env.snapshot(), before)
    with pytest.raises(ActionError, match=r"nan at \[2, 1\]"):
        env.step(wrong)


@both
def test_clipped_actions_are_counted_one_by_one(name):
    env = vector(name, 3)
    env.reset(seed=0)
    action = np.zeros((3, 3))
    action[1] = 2.0
    for k in (1, 2, 3):
        assert env.step(action)[4]["clipped"].tolist() == [0, k, 0]


@pytest.mark.parametrize("seed", [-1, 1.5, "x", True, 2**64, [0, 1], [0, 1, -1], [0, "x", 1]])
def test_bad_seeds_are_refused(seed):
    env = vector(IDEAL, 3)
    env.reset(seed=0)
    before = env.snapshot()
    with pytest.raises(gym.error.Error, match="seed must be"):
        env.reset(seed=seed)
    assert same(env.snapshot(), before)


def test_unknown_options_are_refused():
    env = vector(IDEAL, 2)
    with pytest.raises(ParameterError, match="'colour'; known: reset_mask, q, goal"):
        env.reset(options={"colour": 1})
    with pytest.raises(ParameterError, match=r"options\['q'\] must have shape \(2, 3\)"):
        env.reset(options={"q": np.zeros(3)})


@pytest.mark.parametrize("n", [0, -1, 1.5, "x", None, True])
def test_a_bad_number_of_environments_is_refused(n):
    with pytest.raises(ParameterError, match=r"n must be a whole number >= 1"):
        vector(IDEAL, n)


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


def test_snapshots_lead_back():
    env = vector(EMULATED, 3, **SHORT)
    env.reset(seed=0)
    walk(env, 20, 0)
    mark = env.snapshot()
    first = walk(env, 30, 1)
    env.restore(mark)
    assert same(walk(env, 30, 1), first)
    other = vector(EMULATED, 2, **SHORT)
    other.reset(seed=0)
    with pytest.raises(ParameterError, match="snapshot is of"):
        other.restore(mark)


def test_what_is_handed_out_stays_the_callers():
    env = vector(EMULATED, 2, **SHORT)
    kept = [env.reset(seed=0), *walk(env, 19, 0)]
    copies = copy.deepcopy(kept)
    before = env.snapshot()
    walk(env, 5, 1)
    assert same(kept, copies)
    env.restore(before)
    for outcome in kept:
        outcome[0][:] = 7.0
        for value in outcome[-1].values():
            if isinstance(value, np.ndarray):
                value[:] = 1
    assert same(env.snapshot(), before)


def test_close_may_be_called_again():
    env = vector(IDEAL, 2)
    env.reset()
    env.close()
    env.close()


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


# ----------------------------------------------------------------------- worker processes


@pytest.mark.parametrize(
    "when", ["step", *(pytest.param(k, marks=pytest.mark.slow) for k in ("reset", "call"))]
)
def test_a_killed_worker_is_named_and_leaves_no_process(when):
    env = AsyncVectorEnv([lambda: gym.make(f"ves_gym:{IDEAL}")] * 2, context="spawn")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    processes = list(env.processes)
    os.kill(processes[1].pid, signal.SIGKILL)
    work = {
        "step": lambda: env.step(env.action_space.sample()),
        "reset": lambda: env.reset(seed=0),
        "call": lambda: env.get_attr("spec"),
    }[when]
    said = rf"worker 1 \(process {processes[1].pid}\) ended with -9\."
    with pytest.raises(EnvWorkerDied, match=said):
        work()
    assert not any(p.is_alive() for p in processes)
    assert not set(processes) & set(active_children())
    with pytest.raises(gym.error.ClosedEnvironmentError):
        work()
    env.close()


def test_a_worker_killed_while_it_works_is_named():
    """The parent already waits for its answer."""
    env = AsyncVectorEnv([lambda: gym.make(f"ves_gym:{IDEAL}")] * 2, context="spawn")
    env.reset(seed=0)
    processes = list(env.processes)
    os.kill(processes[0].pid, signal.SIGSTOP)
    env.step_async(np.zeros((2, 3), np.float32))
    os.kill(processes[0].pid, signal.SIGKILL)
    begin = time.monotonic()
    with pytest.raises(EnvWorkerDied, match=r"worker 0 .* ended with -9"):
        env.step_wait()
    assert time.monotonic() - begin < 20  # no hang
    assert not any(p.is_alive() for p in processes)


def test_living_workers_are_gymnasiums():
    env = AsyncVectorEnv([lambda: gym.make(f"ves_gym:{IDEAL}")] * 2, context="spawn")
    sync = singles(IDEAL, 2)
    agree(env.reset(seed=[1, 2]), sync.reset(seed=[1, 2]))
    for a in actions(env, 3, 0):
        agree(env.step(a), sync.step(a))
    with (
        pytest.warns(UserWarning),  # Gymnasium's log of it
        pytest.raises(ActionError, match=re.escape("got nan at [1]")),
    ):
        env.step(np.array([[0, 0, 0], [0, np.nan, 0]], np.float32))
    processes = list(env.processes)
    env.close()
    assert not any(p.is_alive() for p in processes)
