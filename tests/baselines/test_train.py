"""Training: it stores what it says, shows it, and a killed run ends as if it had not been."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.walks import IDS as EVERY_ID
from ves_gym._util.params import ParameterError, from_plain
from ves_gym.baselines.checkpoint import load_state
from ves_gym.baselines.config import (
    CONFIGS,
    TrainConfig,
    choose_config,
    find_configs,
    read_config,
)
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.learner import Learner
from ves_gym.baselines.policy import load_policy
from ves_gym.baselines.train import CHECKPOINT, VALIDATION, scalars, train
from ves_gym.envs.registration import IDS

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples" / "training").glob("*.toml"))
SHORT = {"duration": 0.5, "hold": 0.1}  # of reaching: 40 periods
PPO = TrainConfig(
    env="ves/PumaReachGoal-v0",
    algorithm="PPO",
    total_timesteps=1000,
    n_envs=8,
    hold=2,
    eval_every=400,
    settings=SHORT,
    curriculum={"tolerance": (0.3, 0.01)},
    layers=(8, 8),
    eval_episodes=4,
    hyperparameters={
        "n_steps": 16, "batch_size": 64, "n_epochs": 2, "normalise": True, "critic_first": 1
    },
)  # fmt: skip
IMITATING = replace(
    PPO, env="ves/PumaReach-v0", imitate="resolved", frames=3, curriculum={},
    imitation={"rounds": 3, "batch_size": 64, "recall": 2},
)  # fmt: skip
DAGGER = replace(
    PPO, env="ves/PumaReach-v0", algorithm="DAgger", imitate="closing", features="arm",
    settings={**SHORT, "control": "joint_velocity"}, curriculum={}, eval_every=200,
    total_timesteps=8 * 20 * 5, hyperparameters={},
    imitation={"rounds": 5, "batch_size": 64, "batches": 9, "late": 2.0},
)  # fmt: skip


class Stopped(Exception):
    pass


def run(config, folder, stop=2.0, **options):
    """Train in this process, stopping after `stop` of the way."""

    def progress(done, note):
        if done > stop:
            raise Stopped

    try:
        return train(config, 0, folder, progress=progress, **options)
    except Stopped:
        return None


def weights(folder, name="last"):
    return [w for layer in load_policy(folder / f"{name}.json").weights for w in layer]


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def timeless(rows):
    """Rows of a curve without what a clock says."""
    return [{k: v for k, v in row.items() if not k.startswith("seconds")} for row in rows]


def curve(folder):
    lines = (folder / "curve.jsonl").read_text().splitlines()
    return timeless([json.loads(line) for line in lines])


def same_runs(a, b):
    return all(same(weights(a, name), weights(b, name)) for name in ("last", "best")) and curve(
        a
    ) == curve(b)


@pytest.mark.parametrize(
    "config",
    [IMITATING, *(pytest.param(k, marks=pytest.mark.slow) for k in (PPO, DAGGER))],
    ids=lambda c: c.label,
)
def test_a_stopped_run_ends_as_if_it_had_not_been(config, tmp_path):
    uninterrupted, parts = tmp_path / "uninterrupted", tmp_path / "parts"
    rows = run(config, uninterrupted)
    for stop in (0.3, 0.7, 2.0):
        assert (run(config, parts, stop, resume=True) is None) == (stop < 1)
    assert same_runs(uninterrupted, parts)
    assert rows[0]["steps"] == 0 and rows[-1]["steps"] >= config.total_timesteps
    expected = {"PPO": {"std", "value_loss", "explained_variance"}}
    expected |= {"DAgger": {"imitation_error"}}
    assert expected.get(config.algorithm, set()) <= rows[-1]["train"].keys()
    run(config, parts, resume=True)  # a finished run stays as it is
    assert same_runs(uninterrupted, parts)


def test_the_curve_is_what_evaluate_says(tmp_path):
    config = replace(
        PPO, env="ves/PumaRestToRest-v0", settings={"duration": 0.5, "tail": 0.5}, hold=1,
        curriculum={}, hyperparameters={"n_steps": 16, "batch_size": 64, "n_epochs": 2},
    )  # fmt: skip
    rows = run(config, tmp_path)
    policy = load_policy(tmp_path / "best.json")
    again = evaluate(policy, config.env, episodes=4, seed=VALIDATION, **config.settings)
    best = max(rows, key=lambda row: row["return"])
    assert again.summary()["return"]["mean"].value == best["return"]
    assert policy.about["steps"] == best["steps"] and policy.about["algorithm"] == "ppo"
    assert rows[0]["E_mean_ratio"] == pytest.approx(1, abs=0.1)  # it begins next to zero
    assert sum(row["train_episodes"] for row in rows) == 8 * (rows[-1]["steps"] // 8 // 40)


def test_the_policy_file_acts_as_the_learner_did(tmp_path):
    """The scale is in the first layer, and frames are remembered by the file's policy."""
    run(IMITATING, tmp_path)
    env = gym.make_vec(IMITATING.env, num_envs=5, threads=1, **SHORT).unwrapped
    learner = Learner(IMITATING, 0, env)
    learner.restore(load_state(tmp_path / CHECKPOINT, {"task": env.task})["learner"])
    env.reset(seed=3)
    learner.ppo.restart()
    policy = load_policy(tmp_path / "last.json")
    assert policy.network.frames == 3
    for _ in range(35):  # decisions of two periods, into the second episode
        theirs = policy.act(env, env.batch.observe())
        rows = learner.stack.scaled(learner.ppo.rows)
        action = np.clip(learner.agent.actor(rows), -1, 1)
        np.testing.assert_allclose(theirs, action, atol=2e-5)
        learner.ppo._step(action)


# ------------------------------------------------------------- seeds, curves elsewhere


def events(folder):
    """Tag -> [(step, value), ...] of what TensorBoard shows of a folder."""
    module = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    from tensorboard.util.tensor_util import make_ndarray

    read = module.EventAccumulator(str(folder))
    read.Reload()
    return {
        tag: [(e.step, make_ndarray(e.tensor_proto).item()) for e in read.Tensors(tag)]
        for tag in read.Tags()["tensors"]
    }


def expected_events(rows):
    out = {}
    for row in rows:
        for tag, value in scalars(row).items():
            out.setdefault(tag, []).append((row["steps"], pytest.approx(value, rel=1e-6)))
    return out


@pytest.mark.parametrize("from_the_start", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_resumed_run_shows_each_row_once(tmp_path, from_the_start):
    pytest.importorskip("tensorboard")
    board = tmp_path / "board"
    run(PPO, tmp_path / "run", 0.5, tensorboard=board if from_the_start else None)
    rows = run(PPO, tmp_path / "run", resume=True, tensorboard=board)
    assert events(board / PPO.name / "seed-0") == expected_events(rows)


def test_every_number_of_a_row_has_a_tag():
    row = {"steps": 9, "return": 1.0, "E_mean": None, "train_return": 2.0, "seconds": 3.0}
    assert scalars({**row, "train": {"loss": 4.0, "kl": None}}) == {
        "validation/return": 1.0,
        "train/return": 2.0,
        "time/seconds": 3.0,
        "learner/loss": 4.0,
    }


def test_a_run_is_not_overwritten_nor_mistaken_for_another(tmp_path):
    folder = tmp_path / "run"
    (tmp_path / "file").write_text("")
    with pytest.raises(ParameterError, match="tensorboard must be a folder"):
        run(PPO, folder, tensorboard=tmp_path / "file")
    assert not folder.exists()
    run(PPO, folder, stop=0.2)
    with pytest.raises(ParameterError, match="holds a run already"):
        run(PPO, folder)
    with pytest.raises(ParameterError, match="of another run: its config"):
        run(replace(PPO, reward_scale=2.0), folder, resume=True)
    (folder / ".last.json.abc").write_text("half")  # of a write that was killed
    run(PPO, folder, resume=True)
    assert not list(folder.glob(".*"))


# ------------------------------------------------------------------------- kills


def killed(config, folder, delays):
    """Train in processes of their own, each killed a delay after its first checkpoint."""
    file = folder.parent / "config.json"
    file.write_text(json.dumps(config.to_dict()))
    command = [sys.executable, "-m", "ves_gym.cli.main", "train", str(file), "--seeds", "0"]
    command += ["--out", str(folder), "--resume"]
    checkpoint = folder / "seed-0" / CHECKPOINT
    for delay in delays:
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        while process.poll() is None:
            if checkpoint.exists() and checkpoint.stat().st_mtime_ns > before:
                time.sleep(delay)
                break
            time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
        out, err = process.communicate()
        assert process.returncode in (-signal.SIGKILL, 0), err.decode()
        # the signal may come between the last line and the exit
        silent_or_whole = out == b"" or out.endswith(b"best.json\n")
        assert (err == b"" and silent_or_whole) or process.returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_killed_run_ends_as_if_it_had_not_been(tmp_path):
    config = replace(PPO, total_timesteps=6000)
    run(config, tmp_path / "uninterrupted")
    draws = random.Random(time.time_ns())
    delays = [draws.uniform(0.0, 0.4) for _ in range(3)]
    print("killed after", delays)
    killed(config, tmp_path / "parts", delays)
    run(config, tmp_path / "parts" / "seed-0", resume=True)
    assert same_runs(tmp_path / "uninterrupted", tmp_path / "parts" / "seed-0")


# ------------------------------------------------------------------- configuration


def test_configurations_of_the_package_are_good():
    configs = {path.stem: read_config(path) for path in CONFIGS.glob("*.toml")}
    assert all(config.name == name for name, config in configs.items())
    assert {c.env for c in configs.values()} == {f"ves/{k}-v0" for k in IDS}
    assert all(len(c.seeds) >= 5 for c in configs.values())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_recipes_among_the_examples_can_be_trained(path):
    config = read_config(path)
    env = gym.make_vec(config.env, num_envs=4, threads=1, **config.settings).unwrapped
    learner = Learner(config, 0, env)
    if config.imitate:
        learner.imitation.expert.reset(env, np.arange(4))


def test_an_emulated_id_is_trained_as_its_twin():
    (ideal,) = find_configs("ves/PumaRestToRest-v0", "ppo")
    (twin,) = find_configs("ves/PumaRestToRestEmulated-v0", "ppo")
    assert twin == replace(ideal, env="ves/PumaRestToRestEmulated-v0")
    assert twin.name == "PumaRestToRestEmulated-ppo"
    with pytest.raises(ParameterError, match=r"algorithm must be one of .*ppo.*, got 'dqn'"):
        find_configs("ves/PumaRestToRest-v0", "dqn")


@pytest.mark.parametrize("id", EVERY_ID)
def test_every_id_can_be_trained(id):
    """By the configurations of its own, or by PPO with hyper-parameters of another task."""
    assert choose_config(id).env == id
    config = choose_config(id, "ppo")
    assert (config.env, config.algorithm) == (id, "PPO")
    env = gym.make_vec(id, num_envs=2, threads=1, **config.settings).unwrapped
    Learner(config, 0, env)


def test_hyperparameters_of_another_task_come_without_what_is_of_that_task(monkeypatch):
    monkeypatch.setattr("ves_gym.baselines.config.GENERAL", "PumaReachGoal-ppo")
    monkeypatch.setattr("ves_gym.baselines.config.find_configs", lambda *_: [])
    config = choose_config("BerthingContact-v0", "ppo")
    assert (config.features, config.settings, config.curriculum) == ("", {}, {})


def test_an_environment_without_an_algorithm_says_what_it_has():
    with pytest.raises(ParameterError, match='did you mean "ves/PumaDamp-v0"'):
        choose_config("PumaDmap-v0")
    with pytest.raises(ParameterError, match=r"has no closing-dagger: .* one of ppo"):
        choose_config("PumaDamp-v0", "closing-dagger")


def test_the_learning_rate_falls_linearly():
    assert PPO.learning_rate(2.0, 0.25) == 0.5
    assert replace(PPO, final_rate=0.5).learning_rate(2.0, -1.0) == 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "DQN"}, "algorithm must be one of PPO, DAgger"),
        ({"n_envs": 0}, "n_envs must be >= 1"),
        ({"eval_every": -1}, "eval_every must be >= 0"),
        ({"rate": 1}, "unknown key 'rate'"),
        ({"seeds": []}, "seeds must be numbers"),
        ({"final_rate": 2.0}, "final_rate <= 1"),
        ({"imitation": {"rounds": 2}}, "need a controller"),
        ({"algorithm": "DAgger"}, "DAgger need a controller"),
        ({"features": "leg"}, "features must be one of"),
        ({"curriculum": {"tolerance": [0.0, 0.1]}}, "curriculum must be > 0"),
    ],
)
def test_a_bad_configuration_is_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        from_plain(TrainConfig, {**PPO.to_dict(), **changes})


@pytest.mark.parametrize(
    ("config", "changes", "message"),
    [
        (PPO, {"hyperparameters": {"n_step": 3}}, "unknown key 'n_step'"),
        (PPO, {"hyperparameters": {"batch_size": 1}}, "batch_size must be >= 2"),
        (PPO, {"hyperparameters": {"gamma": 1.1}}, "gamma must be 0 to 1"),
        (PPO, {"hyperparameters": {"n_epochs": 0}}, "n_epochs must be >= 1"),
        (PPO, {"hyperparameters": {"clip_range": 0.0}}, "clip_range must be > 0"),
        (DAGGER, {"total_timesteps": 900}, "those of its rounds, 800, got 900"),
        (DAGGER, {"imitation": {"rounds": 0}}, "rounds must be >= 1"),
        (DAGGER, {"imitation": {"noise": -1.0}}, "noise must be >= 0"),
        (DAGGER, {"imitation": {"learning_rate": 0.0}}, "learning_rate must be > 0"),
    ],
)
def test_bad_hyperparameters_are_refused(config, changes, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        run(replace(config, **changes), tmp_path / "run")
    assert not (tmp_path / "run").exists()
