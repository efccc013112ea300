"""A small recorded run, and a way to call commands."""

import json

import numpy as np
import pytest

from ves_gym.cli.main import main
from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System


@pytest.fixture(scope="session")
def run_log(tmp_path_factory):
    """0.6 s on the bent beam, saved as CSV."""
    motion = Motion.straight(np.zeros(3), np.deg2rad([20.0, -10, 15]), 0.4)
    log = play_motions(System(), [motion], settle=0.2).log(0)
    path = tmp_path_factory.mktemp("log") / "run.csv"
    log.save(path)
    return path


@pytest.fixture
def call(tmp_path, capsys, monkeypatch):
    """Run a command in an empty folder; (status, stdout, stderr, JSON result or None)."""
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):  # no test opens a window
        monkeypatch.delenv(name, raising=False)

    def run(*words, out=tmp_path / "out"):
        result = tmp_path / "result.json"
        result.unlink(missing_ok=True)
        where = [] if out is None else ["--out", str(out)]
        status = main([*map(str, words), "--json", str(result), *where])
        text, found = capsys.readouterr(), result.exists()
        return status, text.out, text.err, json.loads(result.read_text()) if found else None

    return run


@pytest.fixture
def refused(call, tmp_path):
    """Assert that a command is refused as bad input, and return its one line."""

    def run(*words):
        status, out, err, result = call(*words)
        assert status == 2, out + err
        assert err.count("\n") == 1 and err.startswith("ves-gym: error: "), err
        assert result is None and not (tmp_path / "out").exists()
        return err

    return run
