"""The built wheel holds what a user needs, nothing generic, and runs on its own."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from ves_gym import __version__

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    options = ["--no-deps", "--no-build-isolation", "--quiet", "--disable-pip-version-check"]
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", *options, "-w", str(folder), str(ROOT)],
        check=True,
        capture_output=True,
    )
    return next(folder.glob("*.whl"))


def test_wheel_holds_only_the_package_and_its_data(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "ves_gym",
        f"ves_gym-{__version__}.dist-info",
    }
    kept = {
        "py.typed",
        "report/page.html",
        "report/page.css",
        "report/page.js",
        "report/dom.js",
    }
    kept |= {f"leaderboard/{name}" for name in ("page.html", "page.css", "page.js")}
    kept |= {f"baselines/policies/PumaDamp/ppo.{end}" for end in ("json", "safetensors")}
    assert {f"ves_gym/{name}" for name in kept} <= set(names)


def test_wheel_runs_on_its_own(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    done = subprocess.run(
        [sys.executable, "-m", "ves_gym.cli.main", "list", "vehicles"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "site")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "straight-vertical-thesis" in done.stdout
