"""`view`: pictures where OpenGL works, one clear line where it does not."""

import json
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from tests.display import require_opengl, type_keys, virtual_display
from ves_gym.api import simulate
from ves_gym.cli import watch
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import rotation
from ves_gym.rendering import live, render
from ves_gym.rendering import opengl as gl
from ves_gym.rendering.opengl import Probe
from ves_gym.rendering.render import View
from ves_gym.report.player import can_play
from ves_gym.system.energy import log_base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

TINY = ("--size", "128x64", "--fps", "5")


@pytest.fixture(scope="session")
def opengl():
    """Skip where nothing can draw: the other tests here say what happens then."""
    return require_opengl()


def test_without_a_display_a_page_plays_the_log(call, run_log, browser, monkeypatch):
    monkeypatch.setattr(watch, "has_display", lambda: False)
    status, out, _, result = call("view", run_log)
    assert status == 0 and "open it in any browser" in out
    page = Path(result["file"])
    for dark, width in ((False, 1280), (True, 390)):
        browser.screen(width, 900, dark)
        browser.open(page.as_uri())
        assert browser.obstacles() == [] and browser.errors == []
        assert browser.do("document.documentElement.scrollWidth <= innerWidth")
    assert browser.requests == [page.as_uri()]

    log = RunLog.load(run_log)
    [run] = json.loads(browser.do("document.getElementById('data').textContent"))["scenes"][0][
        "runs"
    ]
    at = np.searchsorted(log.t, run["dt"] * np.arange(len(run["E"])) - 1e-9)
    y, q = log.y[at], log.q[at]
    arm = np.einsum("tij,tkj->tki", rotation(y), joint_positions(System().arm, q))
    np.testing.assert_allclose(run["arm"], arm + y[:, None, :3], atol=5.1e-5)
    np.testing.assert_allclose(run["E"], log_base_energy(log, System()).total[at], rtol=1e-3)
    assert run["dt"] * (len(at) - 1) == pytest.approx(log.t[-1], abs=run["dt"])

    before = browser.do("Number(document.getElementById('scene-time').value)")
    browser.click("#scene-play")
    browser.page.wait_for_timeout(400)
    assert browser.do("Number(document.getElementById('scene-time').value)") != before


def test_what_the_page_cannot_show_is_drawn_into_a_gif():
    arm = System(arm="ur5e").arm
    two = System(arms=[arm.at((0.0, 0.5, 0.0)), arm.at((0.0, -0.5, 0.0))])
    still = Motion.straight(np.zeros(12), np.zeros(12), duration=0.1)
    assert not can_play(simulate(still, two, settle=0.1))


def test_gif_shows_a_structure_that_moves(call, run_log, tmp_path, opengl):
    status, out, _, result = call("view", run_log, *TINY, "--magnify", "20")
    assert status == 0 and result["schema"] == "ves-view/1" and "written" in out
    assert result["frames"] == 4 and result["backend"] == opengl
    assert result["digest"] == RunLog.load(run_log).digest
    with Image.open(tmp_path / "out" / "run.gif") as film:
        assert film.size == (128, 64) and film.n_frames == 4
        assert film.info["duration"] == 200  # ms: real time
        frames = []
        for k in range(film.n_frames):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB"), int))
    for half in (frames[0][:, :63], frames[0][:, 65:]):
        assert len(np.unique(half.reshape(-1, 3), axis=0)) > 10  # not just background
    assert np.abs(frames[-1] - frames[0]).max() > 50


def test_what_is_drawn_is_the_log_at_the_pictures_times(run_log):
    log = RunLog.load(run_log)
    system, samples = render.log_samples(log, View(fps=20.0, speed=2.0))
    assert system == System() and [k["t"] for k in samples] == pytest.approx(np.arange(7) / 10)
    energy = log_base_energy(log, system)
    for sample in samples:
        k = int(np.abs(log.t - sample["t"]).argmin())
        for name, column in (("q", log.q), ("y", log.y), ("u", log.u), ("w", log.w)):
            np.testing.assert_allclose(sample[name], column[k], rtol=1e-6, atol=1e-9)
        parts = sample["E"], sample["strain"]
        assert parts == pytest.approx((energy.total[k], energy.strain[k]), rel=1e-6, abs=1e-12)


def test_mp4_has_the_asked_frames(call, run_log, tmp_path, opengl):
    status, *_ = call("view", run_log, *TINY, "--mp4", "a.mp4", "--speed", "0.5")
    assert status == 0
    frames, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "out" / "a.mp4"))
    assert frames == 7


@pytest.mark.parametrize("vehicle", ["free-floating", "decoupled"])
def test_vehicles_without_a_beam_are_drawn(call, opengl, vehicle, tmp_path):
    words = ("--vehicle", vehicle, "--duration", "0.2", "--settle", "0")
    _, _, _, made = call("simulate", *words, "--record-dt", "0.0125", "--goal", "5,5,5")
    status, *_ = call("view", made["log"], *TINY)
    assert status == 0


# ------------------------------------------------------------- where it does not work


def test_unknown_mujoco_gl_is_one_line(refused, run_log, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    line = refused("view", run_log, *TINY)
    assert "MUJOCO_GL" in line and "egl" in line and "'nonsense'" in line


def test_missing_libraries_are_named(refused, run_log, monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl.platform, "system", lambda: "Linux")
    library = {"egl": "libEGL is missing", "osmesa": "libOSMesa is missing"}
    monkeypatch.setattr(gl, "probe", lambda backend: Probe(backend, False, library[backend]))
    line = refused("view", run_log, *TINY)
    for word in ("MUJOCO_GL is not set", "libEGL", "libOSMesa", "apt-get install libegl1"):
        assert word in line


def test_broken_opengl_is_survived(monkeypatch):
    monkeypatch.setattr(gl, "_TRY", "raise OSError('no such screen')")
    tried = gl.probe.__wrapped__("cgl")
    assert tried == Probe("cgl", False, "OSError: no such screen")


def test_drawing_that_fails_midway_writes_nothing(refused, run_log, monkeypatch):
    monkeypatch.setattr(live, "choose_backend", lambda: "nonsense")
    assert "drawing with nonsense failed" in refused("view", run_log, *TINY)


def test_drawing_that_hangs_is_given_up(refused, run_log, monkeypatch, opengl):
    monkeypatch.setattr(live, "_STALL", 0.001)  # s: no process starts as fast
    assert f"drawing with {opengl} hung: no frame for 0.001 s" in refused(
        "view", run_log, *TINY
    )


def test_window_without_a_display_is_one_line(refused, run_log, monkeypatch):
    monkeypatch.setattr(gl.platform, "system", lambda: "Linux")
    assert "DISPLAY" in refused("view", run_log, "--window")


# ------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--gif", "a.mp4"], ".gif"),
        (["--gif", "a.gif", "--fps", "30"], "100 / k"),
        (["--fps", "0"], "View.fps"),
        (["--speed", "nan"], "--speed must be a number, got nan"),
        (["--magnify", "-1"], "View.magnify"),
        (["--size", "big"], "WIDTHxHEIGHT"),
        (["--size", "641x480"], "even"),
        (["--gif", "a.gif", "--mp4", "a.mp4"], "not allowed with"),
    ],
)
def test_bad_options_are_one_line(words, expected, refused, run_log):
    assert expected in refused("view", run_log, *words)


@pytest.mark.parametrize(
    ("table", "meta", "said"),
    [
        (lambda text: text[: len(text) // 2].rpartition(",")[0], str, "bad.csv: row "),
        (str, lambda text: '{"format": "ves-run/1"}', "system"),
        (str, lambda text: text[:100], "JSON"),
    ],
)
def test_a_damaged_log_is_named(refused, run_log, tmp_path, table, meta, said):
    path = tmp_path / "bad.csv"
    path.write_text(table(run_log.read_text()))
    path.with_suffix(".json").write_text(meta(run_log.with_suffix(".json").read_text()))
    assert said in refused("view", path)


def test_a_window_replays_the_log_until_escape(run_log):
    words = [sys.executable, "-m", "ves_gym.cli.main", "view", str(run_log), "--window"]
    with virtual_display():
        run = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        try:
            type_keys("ves-gym view", "key Escape")
            _, err = run.communicate(timeout=60)
        finally:
            run.kill()
            run.wait()
    assert (run.returncode, err) == (0, "")
