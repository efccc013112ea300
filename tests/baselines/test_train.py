"""Training: it stores what it says, shows it, and a killed run ends as if it had not been."""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.config import (
    ALGORITHMS,
    CONFIGS,
    TrainConfig,
    config_from_plain,
    find_configs,
    read_config,
)
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import load_policy
from ves_gym.baselines.tracking import scalars
from ves_gym.baselines.train import CHECKPOINT, VALIDATION, make_learner, train, train_seeds
from ves_gym.envs.registration import IDS

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples" / "training").glob("*.toml"))
SHORT = {"duration": 0.5, "hold": 0.1}  # of reaching: 40 periods
NATIVE = TrainConfig(
    env="ves/PumaReachGoal-v0",
    algorithm="PPO",
    total_timesteps=1000,
    n_envs=8,
    hold=2,
    eval_every=400,
    settings=SHORT,
    layers=(8, 8),
    eval_episodes=4,
    hyperparameters={
        "n_steps": 16, "batch_size": 64, "n_epochs": 2, "normalise": True, "critic_first": 1
    },
)  # fmt: skip
IMITATING = replace(
    NATIVE, env="ves/PumaReach-v0", imitate="resolved", frames=3,
    imitation={"rounds": 3, "batch_size": 64, "recall": 2},
)  # fmt: skip
DAGGER = replace(
    NATIVE, env="ves/PumaReach-v0", algorithm="DAgger", imitate="closing", features="arm",
    settings={**SHORT, "control": "joint_velocity"}, eval_every=200,
    total_timesteps=8 * 20 * 5, hyperparameters={},
    imitation={"rounds": 5, "batch_size": 64, "batches": 9, "late": 2.0},
)  # fmt: skip
PPO = replace(
    NATIVE, env="ves/PumaRestToRest-v0", learner="sb3", total_timesteps=1500, hold=1,
    eval_every=300, settings={"duration": 0.5, "tail": 0.5},
    hyperparameters={"n_steps": 16, "batch_size": 64, "n_epochs": 2, "gamma": 1.0},
)  # fmt: skip
SAC = replace(
    PPO, algorithm="SAC", total_timesteps=800, n_envs=4, eval_every=200,
    hyperparameters={
        "buffer_size": 400,  # it turns over
        "learning_starts": 200, "batch_size": 32, "train_freq": 4, "gradient_steps": 2,
    },
)  # fmt: skip
HINDSIGHT = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
HER = replace(
    SAC, algorithm="SAC-HER", env="ves/PumaReachGoal-v0", hold=4,
    settings={**SHORT, "control": "pd_target"},
    hyperparameters={**SAC.hyperparameters, "replay_buffer_kwargs": HINDSIGHT},
)  # fmt: skip


class Stopped(Exception):
    pass


def run(config, folder, stop=2.0, **options):
    """Train in this process, stopping after `stop` of the way."""
    if config.learner == "sb3":
        pytest.importorskip("stable_baselines3")

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
    "config", [NATIVE, IMITATING, DAGGER, PPO, SAC, HER], ids=lambda c: f"{c.learner} {c.label}"
)
def test_a_stopped_run_ends_as_if_it_had_not_been(config, tmp_path):
    uninterrupted, parts = tmp_path / "uninterrupted", tmp_path / "parts"
    rows = run(config, uninterrupted)
    for stop in (0.3, 0.31, 0.7, 2.0):
        assert (run(config, parts, stop, resume=True) is None) == (stop < 1)
        np.random.rand(3)  # noqa: NPY002 what happens between does not matter
    assert same_runs(uninterrupted, parts)
    assert rows[0]["steps"] == 0 and rows[-1]["steps"] >= config.total_timesteps
    expected = {"PPO": {"std", "value_loss", "explained_variance"}}
    expected |= {"DAgger": {"imitation_error"}}
    assert expected.get(config.algorithm, set()) <= rows[-1]["train"].keys()
    run(config, parts, resume=True)  # a finished run stays as it is
    assert same_runs(uninterrupted, parts)


@pytest.mark.parametrize(
    "config", [replace(PPO, learner="native"), PPO], ids=lambda c: c.learner
)
def test_the_curve_is_what_evaluate_says(config, tmp_path, monkeypatch):
    """And Stable-Baselines3 leaves no log (SB3-...) in the folder of temporary files."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    rows = run(config, tmp_path)
    assert not list(temporary.glob("SB3*"))
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
    learner = make_learner(IMITATING, 0, env)
    from ves_gym.baselines.checkpoint import load_state

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


@pytest.mark.slow
def test_seeds_in_processes_differ_repeat_and_report(tmp_path):
    pytest.importorskip("tensorboard")
    config, board = replace(NATIVE, seeds=(0, 1), total_timesteps=300), tmp_path / "board"
    notes = []
    curves = train_seeds(
        config, tmp_path / "a", workers=2, progress=lambda *words: notes.append(words),
        tensorboard=board,
    )  # fmt: skip
    assert {(0, 1.0), (1, 1.0)} <= {(seed, done) for seed, done, _ in notes}
    alone = train_seeds(config, tmp_path / "b")
    for seed in (0, 1):
        assert timeless(curves[seed]) == timeless(alone[seed])
        shown = events(board / config.name / f"seed-{seed}")
        assert shown == expected_events(curves[seed]) and "validation/return" in shown
    assert not same(weights(tmp_path / "a" / "seed-0"), weights(tmp_path / "a" / "seed-1"))


@pytest.mark.parametrize("from_the_start", [True, False])
def test_a_resumed_run_shows_each_row_once(tmp_path, from_the_start):
    pytest.importorskip("tensorboard")
    board = tmp_path / "board"
    run(NATIVE, tmp_path / "run", 0.5, tensorboard=board if from_the_start else None)
    rows = run(NATIVE, tmp_path / "run", resume=True, tensorboard=board)
    assert events(board / NATIVE.name / "seed-0") == expected_events(rows)


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
        run(NATIVE, folder, tensorboard=tmp_path / "file")
    assert not folder.exists()
    run(NATIVE, folder, stop=0.2)
    with pytest.raises(ParameterError, match="holds a run already"):
        run(NATIVE, folder)
    with pytest.raises(ParameterError, match="of another run: its config"):
        run(replace(NATIVE, reward_scale=2.0), folder, resume=True)
    (folder / ".last.json.abc").write_text("half")  # of a write that was killed
    run(NATIVE, folder, resume=True)
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
        assert out == err == b"" or process.returncode == 0


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
@pytest.mark.parametrize(
    "kills", [1, pytest.param(3, marks=pytest.mark.slow)], ids=["once", "three times"]
)
def test_a_killed_run_ends_as_if_it_had_not_been(kills, tmp_path):
    config = replace(NATIVE, total_timesteps=6000)
    run(config, tmp_path / "uninterrupted")
    draws = random.Random(time.time_ns())
    delays = [draws.uniform(0.0, 0.4) for _ in range(kills)]
    print("killed after", delays)
    killed(config, tmp_path / "parts", delays)
    run(config, tmp_path / "parts" / "seed-0", resume=True)
    assert same_runs(tmp_path / "uninterrupted", tmp_path / "parts" / "seed-0")


# ------------------------------------------------------------------- configuration


def test_configurations_of_the_package_are_good():
    configs = {path.stem: read_config(path) for path in CONFIGS.glob("*.toml")}
    assert all(config.name == name for name, config in configs.items())
    untrained = {"MacroMicro", "PayloadTransfer", "ServicerCapture"}
    assert {c.env for c in configs.values()} == {f"ves/{k}-v0" for k in set(IDS) - untrained}
    assert all(len(c.seeds) >= 5 for c in configs.values())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_recipes_among_the_examples_can_be_trained(path):
    config = read_config(path)
    env = gym.make_vec(config.env, num_envs=4, threads=1, **config.settings).unwrapped
    learner = make_learner(config, 0, env)
    assert config.learner == "native"
    if config.imitate:
        learner.imitation.expert.reset(env, np.arange(4))


def test_an_emulated_id_is_trained_as_its_twin():
    (ideal,) = find_configs("ves/PumaRestToRest-v0", "ppo")
    (twin,) = find_configs("ves/PumaRestToRestEmulated-v0", "ppo")
    assert twin == replace(ideal, env="ves/PumaRestToRestEmulated-v0")
    assert twin.name == "PumaRestToRestEmulated-ppo"
    with pytest.raises(ParameterError, match=r"algorithm must be one of .*ppo.*, got 'dqn'"):
        find_configs("ves/PumaRestToRest-v0", "dqn")


def test_every_algorithm_has_a_learner_by_itself():
    for name, algorithm in ALGORITHMS.items():
        config = replace(
            PPO, algorithm=name, learner="", imitate="closing" if algorithm.imitates else ""
        )
        assert config.learner == algorithm.learners[0]
        assert config.env_settings.get("goal", False) == algorithm.goal
    assert NATIVE.learning_rate(2.0, 0.25) == 0.5
    assert replace(NATIVE, final_rate=0.5).learning_rate(2.0, -1.0) == 1.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "DQN"}, "algorithm must be one of PPO, SAC"),
        ({"n_envs": 0}, "n_envs must be >= 1"),
        ({"eval_every": -1}, "eval_every must be >= 0"),
        ({"rate": 1}, "unknown key 'rate'"),
        ({"seeds": []}, "seeds must be numbers"),
        ({"hyperparameters": {"use_sde": True}}, "cannot set use_sde"),
        ({"final_rate": 2.0}, "final_rate <= 1"),
        ({"learner": "rust"}, "learner must be one of sb3, native"),
        ({"learner": "native", "algorithm": "SAC"}, "learner of SAC must be sb3, got native"),
        ({"imitate": "resolved"}, "need learner native"),
        ({"learner": "native", "imitation": {"rounds": 2}}, "need a controller"),
        ({"learner": "native", "algorithm": "DAgger"}, "DAgger need a controller"),
        ({"features": "arm"}, "need learner native"),
        ({"learner": "native", "features": "leg"}, "features must be one of"),
    ],
)
def test_a_bad_configuration_is_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        config_from_plain({**PPO.to_dict(), **changes})


@pytest.mark.parametrize(
    ("config", "hyperparameters", "message"),
    [
        (PPO, {"n_step": 3}, "PPO has no hyper-parameter 'n_step'; known: .*n_steps"),
        (PPO, {"n_steps": 1, "batch_size": 1}, "PPO: .*batch_size"),
        (NATIVE, {"n_step": 3}, "unknown key 'n_step'"),
        (NATIVE, {"batch_size": 1}, "batch_size must be > 1"),
        (NATIVE, {"gamma": 1.1}, "gamma must be 0 to 1"),
        (NATIVE, {"n_epochs": 0}, "n_epochs must be >= 1"),
        (NATIVE, {"clip_range": 0.0}, "clip_range must be > 0"),
    ],
)
def test_bad_hyperparameters_are_refused(config, hyperparameters, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        run(replace(config, hyperparameters=hyperparameters), tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"total_timesteps": 900}, "those of its rounds, 800, got 900"),
        ({"imitation": {"rounds": 0}}, "rounds must be >= 1"),
        ({"imitation": {"noise": -1.0}}, "noise must be >= 0"),
        ({"imitation": {"learning_rate": 0.0}}, "learning_rate > 0"),
    ],
)
def test_bad_imitations_are_refused(changes, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        run(replace(DAGGER, **changes), tmp_path)
