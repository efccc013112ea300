"""Learning curves in TensorBoard and W&B are those of `curve.jsonl`, resumed runs included."""

import contextlib
import json
import sys
import types

import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.tracking import Tracking, scalars
from ves_gym.baselines.train import train, train_seeds

CONFIG = TrainConfig(
    env="ves/BeamLQR-v0",
    algorithm="PPO",
    learner="native",
    total_timesteps=256,
    eval_every=128,
    n_envs=8,
    eval_episodes=2,
    layers=(8,),
    seeds=(0, 1),
    hyperparameters={"n_steps": 16, "batch_size": 64, "n_epochs": 1},
)


def curve(folder):
    return [json.loads(row) for row in (folder / "curve.jsonl").read_text().splitlines()]


def shown(folder):
    """Tag -> [(step, value), ...] of what TensorBoard shows of a folder."""
    module = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    from tensorboard.util.tensor_util import make_ndarray

    events = module.EventAccumulator(str(folder))
    events.Reload()
    return {
        tag: [(e.step, make_ndarray(e.tensor_proto).item()) for e in events.Tensors(tag)]
        for tag in events.Tags()["tensors"]
    }


def wanted(rows):
    """The same of the rows of a curve."""
    found = {}
    for row in rows:
        for tag, value in scalars(row).items():
            found.setdefault(tag, []).append((row["steps"], pytest.approx(value, rel=1e-6)))
    return found


def test_every_number_of_a_row_has_a_tag():
    row = {"steps": 9, "return": 1.0, "E_mean": None, "train_return": 2.0, "seconds": 3.0}
    assert scalars({**row, "train": {"loss": 4.0, "kl": None}}) == {
        "validation/return": 1.0,
        "train/return": 2.0,
        "time/seconds": 3.0,
        "learner/loss": 4.0,
    }


def test_tensorboard_shows_the_curve_of_each_seed(tmp_path):
    pytest.importorskip("tensorboard")
    tracking = Tracking(tensorboard=str(tmp_path / "board"))
    train_seeds(CONFIG, [0, 1], tmp_path / "run", tracking=tracking)
    for seed in (0, 1):
        rows = curve(tmp_path / "run" / f"seed-{seed}")
        assert len(rows) == 3
        found = shown(tmp_path / "board" / CONFIG.name / f"seed-{seed}")
        assert found == wanted(rows) and "validation/return" in found


def test_seeds_in_processes_of_their_own_tell_their_progress(tmp_path):
    told = []
    rows = train_seeds(
        CONFIG, [0, 1], tmp_path / "two", workers=2, progress=lambda *words: told.append(words)
    )
    alone = train_seeds(CONFIG, [0, 1], tmp_path / "one")
    clocked = {"seconds", "seconds_stepping"}
    timeless = [
        {seed: [{k: v for k, v in row.items() if k not in clocked} for row in curve]
         for seed, curve in found.items()}
        for found in (rows, alone)
    ]  # fmt: skip
    assert timeless[0] == timeless[1]
    assert {(seed, 1.0) for seed in (0, 1)} <= {(seed, done) for seed, done, _ in told}


@pytest.mark.parametrize("from_the_start", [True, False])
def test_a_resumed_run_shows_each_row_once(tmp_path, from_the_start, monkeypatch):
    pytest.importorskip("tensorboard")
    tracking = Tracking(tensorboard=str(tmp_path / "board"))

    def stop(done, words):
        if done >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first = tracking if from_the_start else Tracking()
        train(CONFIG, 0, tmp_path / "run", progress=stop, tracking=first)
    train(CONFIG, 0, tmp_path / "run", resume=True, tracking=tracking)
    found = shown(tmp_path / "board" / CONFIG.name / "seed-0")
    assert found == wanted(curve(tmp_path / "run"))


class Wandb(types.ModuleType):
    """A recorder under W&B's name: `init`, and runs with `log` and `finish`."""

    Error = type("Error", (Exception,), {})

    def __init__(self, refuses=False):
        super().__init__("wandb")
        self.refuses, self.started, self.logged, self.ended = refuses, [], [], []

    def init(self, **words):
        if self.refuses:
            raise self.Error("api_key not configured (no-tty). call wandb login\nmore")
        self.started.append(words)
        return self

    def log(self, values, step):
        self.logged.append((step, values))

    def finish(self, exit_code):
        self.ended.append(exit_code)


def test_wandb_gets_the_same_numbers(tmp_path, monkeypatch):
    fake = Wandb()
    monkeypatch.setitem(sys.modules, "wandb", fake)
    train(CONFIG, 0, tmp_path / "run", tracking=Tracking(wandb="arms"))
    rows = curve(tmp_path / "run")
    assert fake.logged == [(row["steps"], scalars(row)) for row in rows]
    (words,) = fake.started
    assert words["project"] == "arms" and words["group"] == CONFIG.name
    assert words["config"]["seeds"] == [0] and fake.ended == [0]


def test_wandb_hears_that_a_run_failed(tmp_path, monkeypatch):
    fake = Wandb()
    monkeypatch.setitem(sys.modules, "wandb", fake)

    def stop(done, words):
        raise KeyboardInterrupt

    with contextlib.suppress(KeyboardInterrupt):
        train(CONFIG, 0, tmp_path / "run", progress=stop, tracking=Tracking(wandb="arms"))
    assert fake.ended == [1]


def test_wandb_without_a_login_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", Wandb(refuses=True))
    with pytest.raises(ParameterError, match=r"api_key not configured.*WANDB_MODE=offline"):
        train(CONFIG, 0, tmp_path / "run", tracking=Tracking(wandb="arms"))


def test_a_file_is_no_folder(tmp_path):
    pytest.importorskip("tensorboard")
    (tmp_path / "board").write_text("")
    with pytest.raises(ParameterError, match="tensorboard must be a folder"):
        train(CONFIG, 0, tmp_path / "run", tracking=Tracking(tensorboard=f"{tmp_path}/board"))
    assert not (tmp_path / "run").exists()
