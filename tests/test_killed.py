"""A command that is killed at any moment, and given again, ends as if it had not been."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ves_gym.baselines.train import CHECKPOINT

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix", reason="SIGKILL"),
]

ROOT = Path(__file__).parents[1]
KILLS = {"diagnose": 1}  # takes minutes; others three times
SWEEP = """
[[evaluate]]
envs = ["PumaDamp-v0"]
policies = ["zero", "pped"]
seeds = [0, 100, 200, 300]
episodes = 10

[[plan]]
suite = "reach100"
planners = ["straight", "direct"]
durations = [2.0]
queries = 3
"""
TRAINING = """
env = "ves/BeamLQR-v0"
algorithm = "PPO"
total_timesteps = 6000
n_envs = 8
seeds = [0, 1]
[hyperparameters]
n_steps = 40
batch_size = 320
"""
MATRIX = """
seeds = [0, 1]
episodes = 5

[[machines]]
name = "space"

[[tasks]]
env = "PumaDamp"
methods = [
    { name = "high gains", policy = "high" },
    { name = "PPO", policy = "ppo" },
]
"""
IMITATION = """
env = "ves/PumaReach-v0"
algorithm = "DAgger"
imitate = "closing"
total_timesteps = 800
n_envs = 8
hold = 2
seeds = [0, 1]
layers = [8, 8]
eval_episodes = 4
settings = { duration = 0.5, hold = 0.1, control = "joint_velocity" }
imitation = { rounds = 5, batch_size = 64 }
"""
ZOO = """
from pathlib import Path
from scripts import training

training.CONFIGS = Path("zoo")
training.main(["--train", "out"])
"""
COMMANDS = {
    "sweep": ("sweep", "sweep.toml", "--workers", "2", "--out", "out"),
    "train": ("train", "mine.toml", "--resume", "--workers", "2", "--out", "out"),
    "zoo": ("-c", ZOO),  # every configuration of a folder
    "matrix": ("matrix", "matrix.toml", "--workers", "2", "--out", "out"),
    "diagnose": (
        "diagnose",
        "runs/a.parquet",
        "runs/b.parquet",
        "--no-free-run",
        "--out",
        "out",
    ),
    "leaderboard": ("leaderboard", "run", "paths", "bent-2s-quick", "direct", "--out", "out"),
}
LOGS = ("simulate", "--effect", "joint/coulomb:torque=3,0,0", "--duration", "1")
_SECONDS = re.compile(rb'"seconds\w*":\s*(\[[^]]*\]|[-+.e0-9]+)')
ABOUT = "about"  # folder of a sweep: when, where and how long


def started(words, folder):
    """The command as a process, in a folder."""
    return subprocess.Popen(
        [sys.executable, *(words if words[0] == "-c" else ("-m", "ves_gym.cli.main", *words))],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(words, folder):
    process = started(words, folder)
    out, err = process.communicate()
    if "new or empty folder for the entry" in err:
        return  # it was done
    assert process.returncode == 0, (out, err)


def files(folder):
    """What was made, by name, but for the seconds that it took; checkpoints hold them too."""
    found = (p for p in sorted((folder / "out").rglob("*")) if p.is_file())
    made = {str(p.relative_to(folder)): p.read_bytes() for p in found}
    return {
        name: b"" if name.endswith(CHECKPOINT) else _SECONDS.sub(b"", data)
        for name, data in made.items()
    }


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with what the commands read."""
    folder = tmp_path_factory.mktemp("killed")
    (folder / "sweep.toml").write_text(SWEEP)
    (folder / "mine.toml").write_text(TRAINING)
    (folder / "matrix.toml").write_text(MATRIX)
    (folder / "zoo").mkdir()
    (folder / "zoo" / "a.toml").write_text(TRAINING)
    (folder / "zoo" / "b.toml").write_text(IMITATION)
    for name, goal in (("a", "-10,5,-15"), ("b", "10,-5,15")):
        finished((*LOGS, "--goal", goal, "--log", f"{name}.parquet", "--out", "runs"), folder)
    return folder


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_killed_and_given_again(name, desk, tmp_path):
    words = COMMANDS[name]

    def place(label):
        folder = tmp_path / label
        folder.mkdir()
        for file in desk.iterdir():
            (folder / file.name).symlink_to(file)
        return folder

    finished(words, place("first"))  # compiles: the others take as long as each other
    whole, start = place("whole"), time.monotonic()
    finished(words, whole)
    seconds = time.monotonic() - start
    draws = random.Random(time.time_ns())
    for k in range(KILLS.get(name, 3)):
        folder, delay = place(str(k)), draws.uniform(0.2, 1.0) * seconds
        process = started(words, folder)
        time.sleep(delay)
        process.send_signal(signal.SIGKILL)
        out, err = process.communicate(timeout=90.0)  # no orphan holds on to them
        print(f"killed after {delay:.2f} of {seconds:.2f} s; it said {out!r} {err!r}")
        assert "Traceback" not in err
        finished(words, folder)
        ours, theirs = files(whole), files(folder)
        differ = [k for k in ours | theirs if ours.get(k) != theirs.get(k)]
        assert not [k for k in differ if ABOUT not in Path(k).parts], differ
        assert set(ours) == set(theirs)
