"""The matrix: cells of the same episodes, trained policies among them."""

import dataclasses
import shutil

import numpy as np
import pytest

from tests.experiments.sweeps import files
from ves_gym._util.params import ParameterError
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.config import CONFIGS
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.cli.main import main
from ves_gym.experiments.matrix import (
    cells,
    entries,
    read_matrix,
    run_matrix,
    shortened,
    trainings,
)
from ves_gym.experiments.sweep import merge
from ves_gym.experiments.units import read_result
from ves_gym.report.matrix_page import matrix_page

FILE = """
seeds = [0, 1]
episodes = 2

[[machines]]
name = "space"

[[machines]]
name = "lab"
emulated = true
settings = { laboratory = "lab" }

[[tasks]]
env = "BeamLQR"
methods = [
    { name = "zero", controller = "zero" },
    { name = "optimum", controller = "lqr" },
    { name = "softly", controller = "lqr", episodes = 1, settings = { shift = 1e-3 } },
    { name = "trained", train = "BeamLQR-ppo", machine = "lab", changes = { total_timesteps = 200, n_envs = 5, eval_episodes = 2, hyperparameters = { n_steps = 20, batch_size = 50 } } },
]
"""  # noqa: E501


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("matrix") / "matrix.toml"
    path.write_text(FILE)
    return path


@pytest.fixture(scope="module")
def done(file, here, tmp_path_factory):
    folder = tmp_path_factory.mktemp("done")
    report = run_matrix(read_matrix(file), folder, workers=here)
    assert report.complete and len(report.done) == 2 + 4 * 2 * 2
    return folder


def test_a_cell_is_the_evaluation_that_one_would_make_by_hand(file, done):
    matrix = read_matrix(file)
    (entry,) = [e for e in entries(matrix, done) if (e.method, e.machine) == ("optimum", "lab")]
    hand = [
        evaluate(
            get_controller("lqr"),
            "ves/BeamLQREmulated-v0",
            episodes=2,
            seed=seed,
            threads=1,
            laboratory="lab",
        )
        for seed in (0, 1_000_000)
    ]
    returns = np.concatenate([e.values("return")[0] for e in hand])
    # of four values the interquartile mean leaves out the least and the largest
    assert entry.ret.value == pytest.approx(np.sort(returns)[1:3].mean(), rel=1e-12)
    assert entry.ret.low <= entry.ret.value <= entry.ret.high
    assert entry.episodes == 2 and entry.energy is not None and entry.energy.value < 1


def test_the_first_method_is_the_scale_of_energies_and_policies_differ_by_seed(file, done):
    matrix = read_matrix(file)
    for entry in entries(matrix, done):
        if entry.method == "zero":
            assert entry.energy is not None and entry.energy[:3] == (1.0, 1.0, 1.0)
    assert not any("seconds" in row for row in merge([done]))  # of clocks results say nothing
    weights = {c.unit.identity["weights"] for c in cells(matrix, done) if c.method == "trained"}
    assert len(weights) == 2  # one policy per seed, the same on both machines
    episodes = {(c.machine, c.seed, c.unit.identity["seed"]) for c in cells(matrix, done)}
    assert len(episodes) == 4  # the methods share them


def test_a_method_has_episodes_and_settings_of_its_own(file, done):
    """The first of the episodes, and energies over the same ones of the first method."""
    matrix = read_matrix(file)
    by = {(e.method, e.machine): e for e in entries(matrix, done)}
    with on_one_thread():  # as units are done
        hand = evaluate(get_controller("lqr"), "ves/BeamLQR-v0", episodes=1, shift=1e-3)
    (cell, _) = [c for c in cells(matrix, done) if (c.method, c.machine) == ("softly", "space")]
    assert read_result(done / "results" / f"{cell.unit.id}.json")["rows"] == hand.rows
    assert by["softly", "space"].episodes == 1
    assert by["softly", "space"].energy is not None
    assert len(cells(matrix, done, trained=True)) == 4


def test_of_a_part_of_a_matrix_the_complete_cells_are_told(file, done, tmp_path):
    """Without a training the method is left out; without one result its cell."""
    matrix = read_matrix(file)
    shutil.copytree(done, tmp_path / "part")
    results = tmp_path / "part" / "results"
    for key, unit in trainings(matrix).items():
        if key[-1] == 1:
            (results / f"{unit.id}.json").unlink()
    gone = next(c for c in cells(matrix, done) if (c.method, c.machine) == ("optimum", "lab"))
    (results / f"{gone.unit.id}.json").unlink()
    some = entries(matrix, tmp_path / "part")
    assert [(e.method, e.machine) for e in some] == [
        ("zero", "space"), ("optimum", "space"), ("softly", "space"),
        ("zero", "lab"), ("softly", "lab"),
    ]  # fmt: skip
    full = {(e.method, e.machine): e for e in entries(matrix, done)}
    assert all(e == full[e.method, e.machine] for e in some)
    text = matrix_page(matrix, some, "Title")
    assert "Not run yet: BeamLQR optimum on lab; BeamLQR trained." in text
    words = ["matrix", str(file), "--partial", "--out", str(tmp_path / "part")]
    assert main(words) == 0
    assert "| optimum | " in (tmp_path / "part" / "matrix.md").read_text()


def test_what_is_missing_is_done_again_with_the_same_bits(file, done, here):
    """A finished matrix without some of its results, a trained policy's among them."""
    before, policies = files(done), {p.name for p in (done / "policies").iterdir()}
    lost = [*policies][:1] + [n.removesuffix(".json") for n in sorted(before)[::3]]
    for id in lost:
        (done / "results" / f"{id}.json").unlink(missing_ok=True)
    report = run_matrix(read_matrix(file), done, workers=here)
    assert set(report.done) == set(lost) and files(done) == before


def test_the_page(file, done):
    matrix = read_matrix(file)
    text = matrix_page(matrix, entries(matrix, done), "Title")
    assert "| optimum | " in text and "4 episodes" in text and "95 %" in text
    assert "Not run yet" not in text
    longer = dataclasses.replace(matrix, tasks=shortened(matrix, 600))
    steps = {u.identity["config"]["total_timesteps"] for u in trainings(longer).values()}
    assert steps == {600} and len(trainings(matrix)) == 2


def test_a_configuration_of_ones_own_beside_the_matrix(tmp_path, file):
    (tmp_path / "mine.toml").write_text((CONFIGS / "BeamLQR-ppo.toml").read_text())
    path = tmp_path / "m.toml"
    path.write_text(FILE.replace("BeamLQR-ppo", "mine.toml"))
    units = [[u.id for u in trainings(read_matrix(k)).values()] for k in (path, file)]
    assert units[0] == units[1]


def test_bad_matrices_are_refused(tmp_path, file):
    path = tmp_path / "m.toml"
    path.write_text(FILE.replace('controller = "lqr"', 'controller = "lqr", released = "ppo"'))
    with pytest.raises(ParameterError, match="one of controller, released and train"):
        read_matrix(path)
    path.write_text(FILE.replace("episodes = 1,", "episodes = 0,"))
    with pytest.raises(ParameterError, match="softly needs episodes >= 1, got 0"):
        read_matrix(path)
    path.write_text(FILE.replace('machine = "lab"', 'machine = "moon"'))
    with pytest.raises(ParameterError, match="moon"):
        read_matrix(path)
    path.write_text(FILE.replace("BeamLQR-ppo", "BeamLQR-pp"))
    with pytest.raises(ParameterError, match=r"'BeamLQR-pp'; did you mean .BeamLQR-ppo"):
        read_matrix(path)
    path.write_text(FILE.replace('name = "lab"', 'name = "space"'))
    with pytest.raises(ParameterError, match="name of its own"):
        read_matrix(path)
    path.write_text(FILE.replace('env = "BeamLQR"', 'env = "Nothing"'))
    with pytest.raises(ParameterError, match="no environment"):
        cells(read_matrix(path), tmp_path)
    path.write_text(FILE.replace('{ name = "zero", controller', '{ name = "zero", released'))
    with pytest.raises(ParameterError, match=r"or one of zero, random.*ppo"):
        cells(read_matrix(path), tmp_path)
