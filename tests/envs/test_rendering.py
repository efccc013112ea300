"""Pictures show what is simulated, change nothing of it, and leave nothing behind."""

import gc
import os
import signal
import subprocess
import sys
import time

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from tests.display import require_opengl, virtual_display
from tests.envs.walks import IDS, actions, same, walk
from ves_gym.envs.recording import Renderer
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.rendering import opengl as gl
from ves_gym.rendering.opengl import Probe, RenderError

IDEAL, EMULATED = "ves/PumaRestToRest-v0", "ves/PumaRestToRestEmulated-v0"
PICTURED = (IDEAL, "ves/PumaReachGoal-v0", "ves/ServicerCapture-v0")  # alone, by goals, 3-D
GENTLE = {"kind": "guided", "jerk": 40.0}  # so that actions at random meet no joint limit
ENERGY = (0.32, 0.72, 0.98)  # of the line in the strip
TARGET = (0.98, 0.86, 0.30)
HEIGHT, STRIP = 480, 106  # px


@pytest.fixture(scope="module", autouse=True)
def opengl():
    return require_opengl()


@pytest.fixture
def make():
    """Environments that are closed at the end of the test."""
    made = []

    def build(name=IDEAL, **settings):
        made.append(gym.make(name, **{"render_mode": "rgb_array", **settings}).unwrapped)
        return made[-1]

    yield build
    for env in made:
        env.close()


def pixels(picture, rgb, tolerance=60):
    """(height, width) where a picture has about a colour."""
    away = np.abs(picture.astype(int) - np.round(255 * np.array(rgb))).max(axis=-1)
    return away < tolerance


def drawing_process(env):
    return env._renderer.live._drawer.process


# --------------------------------------------------------------------- what is seen


@pytest.mark.parametrize("name", [IDEAL, EMULATED])
def test_a_picture_shows_an_arm_that_moves_and_its_energy(name, make):
    env = make(name, control=GENTLE)
    env.reset(seed=1)
    first = env.render()
    assert first.shape == (480, 640, 3) and first.dtype == np.uint8
    for _ in range(10):
        walk(env, 10, 0)
        last = env.render()
    for part in (np.s_[: HEIGHT - STRIP, :390], np.s_[: HEIGHT - STRIP, 400:]):
        assert len(np.unique(last[part].reshape(-1, 3), axis=0)) > 50  # a shaded scene
        assert np.abs(last[part].astype(int) - first[part]).max() > 50
    drawn = [pixels(k[HEIGHT - STRIP :], ENERGY).any(axis=0).sum() for k in (first, last)]
    assert drawn[0] < 5 and drawn[1] > 200  # columns that the curve has reached


def test_the_target_is_marked(make):
    env = make()
    env.reset(seed=1)
    points = env.task.marker(env.batch.scene)
    assert points.shape == (1, 4, 3)  # from the tool at the goal down to the base
    assert pixels(env.render()[: HEIGHT - STRIP, :390], TARGET, 40).sum() > 20


def test_a_diverged_episode_shows_its_last_meaningful_state(make):
    env = make()
    env.reset(seed=0)
    env.step(np.zeros(3, np.float32))
    before = env.render()
    s = env.batch.sim.state
    env.batch.sim.reset(q=s.q[0], v=3e9, y=s.y[0], ids=[0])
    assert env.step(np.zeros(3, np.float32))[-1]["diverged"]
    assert same(env.render(), before)


# ------------------------------------------------------------- vectors and wrappers


def test_a_vector_shows_every_environment_as_it_would_be_alone(make):
    """Frames pixel by pixel those of single environments, from one drawing process."""
    many = gym.make_vec(IDEAL, num_envs=2, render_mode="rgb_array")
    try:
        many.reset(seed=5)
        for _ in range(4):
            many.step(np.full((2, 3), 0.7, np.float32))
            frames = many.render()
        assert isinstance(frames, tuple) and len(frames) == 2
        process = drawing_process(many)
        for i, frame in enumerate(frames):
            one = make()
            one.reset(seed=5, options={"index": i})
            for _ in range(4):
                one.step(np.full(3, 0.7, np.float32))
                alone = one.render()
            np.testing.assert_array_equal(frame, alone)
    finally:
        many.close()
    assert process.returncode is not None
    many.close()
    plain = gym.make_vec(IDEAL, num_envs=2)
    assert plain.render() is None
    with pytest.raises(ValueError, match=r"must be None or rgb_array, got 'human'"):
        VesVectorEnv(2, render_mode="human")


@pytest.mark.parametrize(
    "name", [k if k in PICTURED else pytest.param(k, marks=pytest.mark.slow) for k in IDS]
)
def test_observations_can_be_pictures(name, make):
    """Gymnasium's AddRenderObservation, alone and beside what else is observed."""
    env = gym.wrappers.AddRenderObservation(make(name), render_only=True)
    seen = [env.reset(seed=0)[0]]
    for action in actions(env, 8, 0):
        seen.append(env.step(action)[0])
    assert all(k in env.observation_space for k in seen)
    assert env.observation_space.shape == (480, 640, 3)
    assert not np.array_equal(seen[0], seen[-1])
    env = gym.wrappers.AddRenderObservation(env.unwrapped, render_only=False)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    np.testing.assert_array_equal(observation["pixels"], seen[0])


@pytest.mark.slow
def test_videos_are_recorded(make, tmp_path):
    """Gymnasium's RecordVideo, of one environment and of a vector."""
    pytest.importorskip("moviepy")
    many = gym.make_vec(IDEAL, num_envs=2, render_mode="rgb_array", duration=0.25)
    for env, wrapper, folder in (
        (make(duration=0.25), gym.wrappers.RecordVideo, tmp_path / "one"),
        (many, gym.wrappers.vector.RecordVideo, tmp_path / "many"),
    ):
        video = wrapper(env, str(folder), episode_trigger=lambda k: k == 0)
        video.reset(seed=0)
        for _ in range(20):
            video.step(np.zeros(env.action_space.shape, np.float32))
        video.close()
        (file,) = folder.iterdir()
        assert file.suffix == ".mp4" and file.stat().st_size > 1000


# -------------------------------------------------------------------- what it promises


@pytest.mark.parametrize(("name", "backend"), [(IDEAL, "mujoco"), (EMULATED, "kernel")])
def test_drawing_changes_nothing(name, backend, make):
    drawn, plain = make(name, backend=backend), make(name, backend=backend, render_mode=None)
    for env in (drawn, plain):
        env.reset(seed=2)
    for k in range(3):
        drawn.render()
        assert plain.render() is None
        assert same(walk(drawn, 5, k), walk(plain, 5, k))


def test_check_env_has_nothing_to_say_about_pictures(monkeypatch, make):
    """Without a display there is one mode to check."""
    monkeypatch.setattr(gl, "has_display", lambda: False)
    env = make(EMULATED)
    assert env.metadata["render_fps"] == 80
    assert env.metadata["render_modes"] == ["rgb_array"]
    check_env(env)


def test_physics_draws_nothing():
    """Not even a picture loads OpenGL into the process that simulates."""
    code = (
        "import sys, gymnasium as gym, ves_gym; e = gym.make('ves/PumaRestToRest-v0',"
        " render_mode='rgb_array'); e.reset(seed=0); e.step(e.action_space.sample());"
        " assert 'ves_gym.rendering.live' not in sys.modules; e.render(); e.close();"
        " print([k for k in ('OpenGL', 'ves_gym.rendering.drawing') if k in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "[]\n", "")


# --------------------------------------------------------------- ends and failures


def test_a_forgotten_environment_leaves_no_process():
    env = gym.make(IDEAL, render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    env.render()
    process = drawing_process(env)
    del env
    gc.collect()
    assert process.returncode is not None


def test_a_killed_drawing_process_is_told(make):
    env = make()
    env.reset(seed=0)
    env.render()
    os.kill(drawing_process(env).pid, signal.SIGKILL)
    with pytest.raises(RenderError, match=r"drawing with \w+ failed: it crashes \(signal 9\)"):
        env.render()


def test_missing_libraries_are_named(make, monkeypatch):
    env = make()
    env.reset(seed=0)
    monkeypatch.setattr(gl, "probe", lambda backend: Probe(backend, False, f"no {backend}"))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(RenderError, match=r"MUJOCO_GL is not set.*apt-get install") as error:
        env.render()
    assert "\n" not in str(error.value)


def test_a_window_without_a_display_is_refused_at_once(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(gl.platform, "system", lambda: "Linux")
    with pytest.raises(RenderError, match=r"DISPLAY is not set.*rgb_array.*MUJOCO_GL"):
        gym.make(IDEAL, render_mode="human")


# ------------------------------------------------------------------------- windows


def test_a_window_runs_in_real_time(make):
    with virtual_display():
        env = make(render_mode="human")
        assert env.metadata["render_modes"] == ["human", "rgb_array"]
        env.reset(seed=0)  # opens it
        begin = time.monotonic()
        for _ in range(40):
            env.step(np.zeros(3, np.float32))
        assert time.monotonic() - begin > 0.45  # 40 periods of 12.5 ms, the first at once
        assert env.render() is None
        assert env._renderer.open
        env.close()


def test_a_window_that_dies_is_told(make):
    with virtual_display():
        env = make(render_mode="human")
        renderer = Renderer(env.task, "human")
        env.batch.seed(np.zeros(1, int), 0, 0)
        env.batch.reset(np.zeros(1, int))
        renderer.frame(env.batch)
        os.kill(renderer.live._drawer.process.pid, signal.SIGKILL)
        with pytest.raises(RenderError, match="drawing with glfw failed"):
            for _ in range(200):
                renderer.frame(env.batch)
        renderer.close()
