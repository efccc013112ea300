"""An episode that diverges is written down: complete, readable, at no cost to the others."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.display import require_opengl
from tests.envs.test_divergence import derail
from tests.envs.walks import same, walk
from ves_gym.cli.main import main
from ves_gym.system.energy import base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

IDEAL, EMULATED = "ves/PumaRestToRest-v0", "ves/PumaRestToRestEmulated-v0"
each = pytest.mark.parametrize("name", [IDEAL, EMULATED])
ZERO = np.zeros(3, np.float32)


def seen(env):
    """Time, base pose, joint angles and energy of a single environment now."""
    s = env.batch.scene
    return s.time[0], s.y[0].copy(), s.q[0].copy(), s.energy[0]


def end(env, i=0):
    """Let simulation i diverge; what `info` says."""
    derail(env.batch, i)
    return env.step(np.zeros(env.action_space.shape, np.float32))[-1]


@each
def test_the_log_holds_the_episode_up_to_its_last_finite_sample(name, tmp_path):
    folder = str(tmp_path / "new" / "folder")
    env = gym.make(name, dump=folder, vehicle="bent-thesis").unwrapped  # no motion is inside
    env.reset(seed=3)
    env.step(ZERO)
    env.reset()  # another episode is the one to be kept
    kept = [seen(env)]
    for _ in range(20):
        env.step(ZERO)
        kept.append(seen(env))
    info = end(env)
    log = RunLog.load(info["dump"])
    t, y, q, energy = (np.array(k) for k in zip(*kept, strict=True))
    assert len(log) == len(t)
    for recorded, true in ((log.t, t), (log.y, y), (log.q, q)):
        np.testing.assert_array_equal(recorded, true)
    system = System.from_dict(log.meta["system"])
    assert system == env.batch.sim.systems[0]  # with what was drawn for this very episode
    np.testing.assert_allclose(
        base_energy(system, log.q, log.y, log.yd).total, energy, rtol=1e-9
    )
    if name == IDEAL:  # force on the base is what moves it; at rest there is none
        np.testing.assert_allclose(log.w[0], 0, atol=1e-9)
        assert np.linalg.norm(log.w[-5:, :3], axis=1).min() > 0.1 and np.abs(log.tau).max() > 1
    assert log.meta["episode"] == [3, 0, 1] and log.meta["task"] == "rest_to_rest"
    assert log.meta["controller"]["kp"] == [3000.0, 2000.0, 1000.0]
    assert log.meta["initial"]["q"] == q[0].tolist()
    assert f"t = {t[-1]:.4f} s" in log.meta["note"]
    assert (log.wg is not None) == (name == EMULATED)


@each
def test_recording_changes_nothing(name, tmp_path):
    for backend in ("kernel", "mujoco"):
        plain = gym.make_vec(name, num_envs=2, backend=backend)
        kept = gym.make_vec(name, num_envs=2, backend=backend, dump=str(tmp_path))
        assert same(plain.reset(seed=1), kept.reset(seed=1))
        assert same(walk(plain, 30, 0), walk(kept, 30, 0))
        assert plain.batch.recorder is None and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_only_the_one_that_diverged_and_only_then(mode, tmp_path):
    """In a vector; the next episode of that simulation begins a log of its own."""
    env = gym.make_vec(IDEAL, num_envs=3, autoreset_mode=mode, dump=str(tmp_path))
    action = np.zeros((3, 3), np.float32)
    env.reset(seed=0)
    for turn in range(2):
        for _ in range(10):
            assert "dump" not in env.step(action)[-1]
        info = end(env, 1)
        assert info["_dump"].tolist() == [False, True, False]
        assert info["dump"][0] is None and info["dump"][2] is None
        log = RunLog.load(info["dump"][1])
        assert log.t[0] == 0 and log.meta["episode"] == [0, 1, turn]
        waits = mode is AutoresetMode.NEXT_STEP and turn == 1  # one step went by in resetting
        assert len(log) == (10 if waits else 11)
        if mode is AutoresetMode.DISABLED:
            env.reset(options={"reset_mask": np.array([False, True, False])})
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".csv"] * 2 + [".json"] * 2


def test_what_is_over_is_forgotten(tmp_path):
    env = gym.make_vec(IDEAL, num_envs=2, dump=str(tmp_path))
    env.reset(seed=0)
    steps = env.unwrapped.task.steps
    for _ in range(2 * steps + 10):
        env.step(np.zeros((2, 3), np.float32))
    assert len(env.batch.recorder._rows) <= steps + 1


def test_copies_keep_the_beginning(tmp_path):
    """Pickled in the middle of an episode, restored into it, restored from elsewhere."""
    env = gym.make(IDEAL, dump=str(tmp_path)).unwrapped
    env.reset(seed=0)
    walk(env, 10, 0)
    mark = env.snapshot()
    again = pickle.loads(pickle.dumps(env))
    walk(env, 5, 1)
    assert len(RunLog.load(end(again)["dump"])) == 11
    env.restore(mark)
    assert len(RunLog.load(end(env)["dump"])) == 11
    other = gym.make(IDEAL).unwrapped  # nothing was recorded there: known from here on
    other.reset(seed=0)
    walk(other, 10, 0)
    env.restore(other.snapshot())
    walk(env, 5, 1)
    log = RunLog.load(end(env)["dump"])
    assert len(log) == 6 and log.t[0] == pytest.approx(10 * env.batch.dt)


def test_divergence_in_the_first_period_leaves_nothing_to_write(tmp_path):
    env = gym.make(IDEAL, dump=str(tmp_path)).unwrapped
    env.reset(seed=0)
    assert end(env)["dump"] is None
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_refused_at_once(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        gym.make(IDEAL, dump=str(tmp_path / "file"))


def test_view_opens_it(tmp_path, capsys):
    require_opengl()
    env = gym.make(EMULATED, dump=str(tmp_path)).unwrapped
    env.reset(seed=0)
    for _ in range(20):
        env.step(ZERO)
    picture = tmp_path / "dump.gif"
    words = ["--gif", str(picture), "--size", "128x64", "--fps", "5"]
    assert main(["view", end(env)["dump"], *words]) == 0
    assert picture.stat().st_size > 0 and "written" in capsys.readouterr().out
