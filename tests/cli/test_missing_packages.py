"""Commands without an optional package: one line that says how to get it, and exit status 2."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from ves_gym._util import optional
from ves_gym._util.optional import PACKAGES, MissingPackageError, explain, require
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.system.system import System

ROOT = Path(__file__).parents[2]

# As on a machine without the packages: they are neither found nor loaded. The commands are
# loaded once, without any of them; each is then run by a copy of this process.
SERVER = """
import importlib, json, os, signal, sys
from importlib.abc import MetaPathFinder

class Hidden(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

hidden = set(sys.argv[1].split(","))
sys.meta_path.insert(0, Hidden())
from ves_gym.cli.main import COMMANDS, main
for name, _ in COMMANDS.values():
    importlib.import_module(f"ves_gym.cli.{name}")
for request in sys.stdin:
    names, words, folder, *files = json.loads(request)
    child = os.fork()
    if child == 0:
        signal.alarm(120)
        hidden.clear()
        hidden.update(names.split(","))
        os.chdir(folder)
        for stream, file in enumerate(files, 1):
            os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), stream)
        sys.exit(main(words))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}
EVERYTHING = ",".join({name.partition(".")[0] for name in PACKAGES} - {"mujoco"})
SPEC = """
[[train]]
configs = ["BeamLQR-ppo"]

[search]
trials = 2
batch = 2
objective = "E_mean"
space = { "train.0.changes.total_timesteps" = { low = 400, high = 800 } }
"""


@pytest.fixture(scope="module")
def server():
    with subprocess.Popen(
        [sys.executable, "-c", SERVER, EVERYTHING],
        env=ENVIRONMENT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield process


@pytest.fixture
def command(server, tmp_path, tmp_path_factory):
    """Run a command in an empty folder with packages hidden: (status, stdout, stderr)."""
    files = tmp_path_factory.mktemp("streams")

    def run(hidden, *words):
        streams = [files / "out", files / "err"]
        what = [hidden, list(map(str, words)), str(tmp_path), *map(str, streams)]
        print(json.dumps(what), file=server.stdin, flush=True)
        status = int(server.stdout.readline())
        return status, *(file.read_text() for file in streams)

    return run


TRAIN = "train ves/BeamLQR-v0 --steps 64"
BOARD = f"{TRAIN} --tensorboard board"
PARQUET = "pip install 'ves-gym[parquet]'"
REFUSED = {  # command, perhaps what alone is hidden -> part of the sentence
    TRAIN: "training needs the package safetensors: pip install safetensors",
    f"{TRAIN} | safetensors": "needs the package safetensors: pip install safetensors",
    f"{BOARD} | tensorboard": "a curve in TensorBoard needs the package tensorboard: pip",
    "evaluate ves/PumaDamp-v0 --policy released": "pip install safetensors",
    "view LOG --gif a.gif": "GIF output needs the package pillow",
    "view LOG --mp4 a.mp4": "'ves-gym[movie]'",
    "simulate --log log.parquet": PARQUET,
    "teleop --keys KEYS --log log.parquet": PARQUET,
    "merge folder --parquet": PARQUET,
    "diagnose a.parquet b.parquet": PARQUET,
    "plan --planner ompl-qt --start 0,0,0 --goal 9,0,0": "planner ompl-qt needs the package"
    " ompl: pip install ompl; ompl has wheels for Linux and macOS 15, Python 3.11 to 3.13",
    "benchmark --quick --first 1 --planners ompl-qt": "package ompl",
    "sweep SWEEP": "training needs the package safetensors",
    "search SPEC": "search needs the package optuna: pip install 'ves-gym[scale]'",
}


@pytest.mark.parametrize("line", REFUSED)
def test_refused_in_one_line(command, run_log, tmp_path, line):
    files = {"LOG": run_log}
    texts = {"KEYS": "0.1 q 0.2\n", "SPEC": SPEC, "SWEEP": SPEC.partition("[search]")[0]}
    for name, text in {**texts, "a.parquet": "", "b.parquet": ""}.items():
        files[name] = tmp_path / f"{name}.toml" if name in texts else tmp_path / name
        files[name].write_text(text)
    there = sorted(tmp_path.iterdir())
    words, _, hidden = line.partition(" | ")
    words = [files.get(word, word) for word in words.split()]
    status, out, err = command(hidden or EVERYTHING, *words)
    assert (status, out) == (2, ""), out + err
    assert err.startswith("ves-gym: error: ") and err.count("\n") == 1, err
    assert REFUSED[line] in err
    assert sorted(tmp_path.iterdir()) == there


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["map", "--joints", "2,3", "--points", "5"], "map_q2_q3.npz"),
        (["simulate", "--settle", "0.2"], "run.csv"),
    ],
)
def test_pictures_are_left_out_and_the_rest_is_done(command, tmp_path, words, written):
    status, out, err = command(EVERYTHING, *words, "--out", "out")
    assert status == 0 and not err, err
    assert (
        "no pictures: drawing needs the package matplotlib: pip install 'ves-gym[report]'"
        in out
    )
    assert (tmp_path / "out" / written).exists()
    assert not list(tmp_path.rglob("*.png"))


def test_doctor_loads_what_is_there(command, tmp_path):
    status, out, _ = command(EVERYTHING, "doctor", "--json", "doctor.json")
    assert status == 0 and "the core works" in out
    names = {
        check["name"] for check in json.loads((tmp_path / "doctor.json").read_text())["checks"]
    }
    assert (
        "import mujoco" in names and not {"import pinocchio", "import ompl.geometric"} & names
    )


# ------------------------------------------------------------------------- the sentences


def test_what_is_installed_is_left_alone():
    require("this test", "matplotlib", "PIL")
    assert optional.lacking("this test", "matplotlib") == ""


def test_several_packages_are_one_command(monkeypatch):
    monkeypatch.setattr(optional, "installed", lambda module: False)
    with pytest.raises(MissingPackageError) as caught:
        require("a picture", "PIL", "matplotlib", "pyarrow", "safetensors")
    assert str(caught.value) == (
        "a picture needs the packages pillow and matplotlib and pyarrow and safetensors: pip"
        " install 'ves-gym[report]' 'ves-gym[parquet]' safetensors"
    )


def test_pinocchio_is_asked_for_on_use(monkeypatch):
    monkeypatch.setattr(optional, "installed", lambda module: False)
    system = System()
    with pytest.raises(MissingPackageError, match=r"'ves-gym\[pinocchio\]'; pin has wheels"):
        pinocchio_model(system.arm, system.base)


def test_a_package_that_does_not_load_is_told_from_one_that_is_missing():
    broken = ImportError("libavcodec.so.61: cannot open", name="imageio_ffmpeg._binaries")
    assert explain(broken) == (
        "the package imageio-ffmpeg does not load here (libavcodec.so.61: cannot open): pip"
        " install 'ves-gym[movie]'"
    )
    assert explain(ImportError("no", name="ves_gym.cli.nothing")) is None
    assert explain(ImportError("no")) is None


def test_every_extra_is_one_that_has_the_package():
    """Else the command in the sentence would install something else."""
    with open(ROOT / "pyproject.toml", "rb") as file:
        project = tomllib.load(file)["project"]
    extras = project["optional-dependencies"]
    for module, source in PACKAGES.items():
        texts = extras[source.extra] if source.extra else project["dependencies"]
        names = [re.match(r"[\w.-]+", text)[0] for text in texts]
        assert source.package in names or module == "ray"  # only where installed
