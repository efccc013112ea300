"""The matrix: cells of the same episodes, trained policies among them."""

import numpy as np
import pytest

from tests.experiments.sweeps import files
from ves_gym._util.params import ParameterError
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import Network, Policy, save_policy
from ves_gym.baselines.registry import get_controller
from ves_gym.experiments.matrix import cells, entries, read_matrix, run_matrix
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
    { name = "zero", policy = "zero" },
    { name = "optimum", policy = "lqr" },
    { name = "softly", policy = "lqr", episodes = 1, settings = { shift = 1e-3 } },
    { name = "trained", policy = "runs" },
]
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A matrix beside the folder of a training of two seeds."""
    path = tmp_path_factory.mktemp("matrix") / "matrix.toml"
    path.write_text(FILE)
    for seed in (0, 1):
        weights = np.full((19, 3), seed / 10), np.zeros(3)
        (path.parent / f"runs/seed-{seed}").mkdir(parents=True)
        policy = Policy(Network(sizes=(19, 3)), (weights,))
        save_policy(policy, path.parent / f"runs/seed-{seed}/best.json")
    return path


@pytest.fixture(scope="module")
def done(file, here, tmp_path_factory):
    """The matrix, its cells, and the folder of their results."""
    matrix, folder = read_matrix(file), tmp_path_factory.mktemp("done")
    chosen = cells(matrix, file.parent)
    report = run_matrix(matrix, chosen, folder, workers=here)
    assert report.complete and len(report.done) == 4 * 2 * 2
    return matrix, chosen, folder


def test_a_cell_is_the_evaluation_that_one_would_make_by_hand(done):
    _, chosen, folder = done
    found = {(e.method, e.machine): e for e in entries(chosen, folder)}
    entry = found["optimum", "lab"]
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


def test_the_first_method_is_the_scale_of_energies_and_policies_differ_by_seed(done):
    _, chosen, folder = done
    for entry in entries(chosen, folder):
        if entry.method == "zero":
            assert entry.energy is not None and entry.energy[:3] == (1.0, 1.0, 1.0)
    assert not any("seconds" in row for row in merge([folder]))  # results know no clock
    units = [(c, unit.identity) for c in chosen for unit in c.units]
    # one policy per seed, the same on both machines; the methods share the episodes
    assert len({of["weights"] for c, of in units if c.method == "trained"}) == 2
    assert len({(c.machine, of["seed"]) for c, of in units}) == 4


def test_a_method_has_episodes_and_settings_of_its_own(done):
    """The first of the episodes, and energies over the same ones of the first method."""
    _, chosen, folder = done
    with on_one_thread():  # as units are done
        hand = evaluate(get_controller("lqr"), "ves/BeamLQR-v0", episodes=1, shift=1e-3)
    (cell,) = [c for c in chosen if (c.method, c.machine) == ("softly", "space")]
    assert read_result(folder / "results" / f"{cell.units[0].id}.json")["rows"] == hand.rows
    (entry,) = entries([chosen[0], cell], folder)[1:]
    assert entry.episodes == 1 and entry.energy is not None


def test_what_is_missing_is_done_again_with_the_same_bits(done, here):
    matrix, chosen, folder = done
    before = files(folder)
    lost = [name.removesuffix(".json") for name in sorted(before)[::3]]
    for id in lost:
        (folder / "results" / f"{id}.json").unlink(missing_ok=True)
    report = run_matrix(matrix, chosen, folder, workers=here)
    assert set(report.done) == set(lost) and files(folder) == before


def test_the_page_fits_a_phone(done):
    matrix, chosen, folder = done
    text = matrix_page(matrix, entries(chosen, folder), "Title")
    assert "4 episodes" in text and "95 %" in text
    assert "| optimum | 100 | " in text and "| zero | 1 | 1 |" in text
    assert max(len(line) for line in text.splitlines() if line.startswith("|")) < 45


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("episodes = 1,", "episodes = 0,", "episodes >= 1"),
        ('name = "lab"', 'name = "space"', "name of its own"),
        ('env = "BeamLQR"', 'env = "Nothing"', "no environment"),
        ('policy = "zero"', 'policy = "zer"', r"or one of zero, random.*ppo"),
        ('policy = "zero"', 'train = "zero"', "unknown key 'train'"),
    ],
)
def test_bad_matrices_are_refused(old, new, message, tmp_path, file):
    path = tmp_path / "m.toml"
    path.write_text(FILE.replace(old, new))
    with pytest.raises(ParameterError, match=message):
        cells(read_matrix(path), file.parent)
