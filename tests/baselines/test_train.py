"""Training: it runs, it stores what it says, and a killed run ends as if it had not been."""

import json
import multiprocessing
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
    CONFIGS,
    TrainConfig,
    config_from_plain,
    find_configs,
    read_config,
)
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import load_policy

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples" / "training").glob("*.toml"))
SMALL = {"settings": {"duration": 0.5, "tail": 0.5}, "layers": [8, 8], "eval_episodes": 4}
PPO = config_from_plain(
    {
        "env": "ves/PumaRestToRest-v0",
        "algorithm": "PPO",
        "total_timesteps": 1500,
        "n_envs": 8,
        "eval_every": 300,
        "hyperparameters": {"n_steps": 16, "batch_size": 64, "n_epochs": 2, "gamma": 1.0},
        **SMALL,
    }
)
SAC = replace(
    PPO,
    algorithm="SAC",
    total_timesteps=800,
    n_envs=4,
    eval_every=200,
    hyperparameters={
        "buffer_size": 400,  # it turns over
        "learning_starts": 200,
        "batch_size": 32,
        "train_freq": 4,
        "gradient_steps": 2,
    },
)
HER = replace(
    SAC,
    env="ves/PumaReachGoal-v0",
    hold=4,
    settings={"duration": 0.5, "hold": 0.1, "control": "pd_target"},
    her={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
)


@pytest.fixture(scope="module")
def run():
    """Train in this process, stopping after `stop` of the way if asked to."""
    pytest.importorskip("stable_baselines3")
    from ves_gym.baselines.train import train

    class Stopped(Exception):
        pass

    def run(config, folder, stop=2.0, **options):
        def progress(done, note):
            if done > stop:
                raise Stopped

        try:
            return train(config, 0, folder, progress=progress, **options)
        except Stopped:
            return None

    return run


def weights(folder, name="last"):
    policy = load_policy(folder / f"{name}.json")
    return [w for layer in policy.weights for w in layer]


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def curve(folder):
    """Rows without what a clock says."""
    rows = [json.loads(line) for line in (folder / "curve.jsonl").read_text().splitlines()]
    return [{k: v for k, v in row.items() if not k.startswith("seconds")} for row in rows]


@pytest.mark.parametrize("config", [PPO, SAC, HER], ids=lambda c: c.label)
def test_a_stopped_run_ends_as_if_it_had_not_been(run, config, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    rows = run(config, whole)
    for stop in (0.3, 0.31, 0.7, 2.0):
        assert (run(config, parts, stop, resume=True) is None) == (stop < 1)
        np.random.rand(3)  # noqa: NPY002 what happens between does not matter
    assert same(weights(whole), weights(parts))
    assert same(weights(whole, "best"), weights(parts, "best"))
    assert curve(whole) == curve(parts)
    assert rows[-1]["steps"] >= config.total_timesteps
    assert rows[0]["steps"] == 0 and len(rows) >= 4

    steps = curve(parts)
    run(config, parts, resume=True)  # a finished run stays as it is
    assert curve(parts) == steps


def test_the_curve_is_what_evaluate_says(run, tmp_path, monkeypatch):
    """And the library leaves no log (SB3-...) in the folder of temporary files."""
    from ves_gym.baselines.train import VALIDATION

    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    rows = run(PPO, tmp_path)
    assert not list(temporary.glob("SB3*"))
    policy = load_policy(tmp_path / "best.json")
    found = evaluate(policy, PPO.env, episodes=4, seed=VALIDATION, threads=1, **PPO.settings)
    best = max(rows, key=lambda row: row["return"])
    assert found.summary()["return"]["mean"].value == best["return"]
    assert policy.about["steps"] == best["steps"] and policy.about["algorithm"] == "ppo"
    assert rows[0]["E_mean_ratio"] == pytest.approx(1, abs=0.1)  # it begins next to zero
    assert {"std", "value_loss", "explained_variance"} <= rows[-1]["train"].keys()
    assert sum(row["train_episodes"] for row in rows) == 8 * (rows[-1]["steps"] // 8 // 40)


def test_seeds_differ_and_repeat(run, tmp_path):
    from ves_gym.baselines.train import train_seeds

    config = replace(PPO, total_timesteps=300)
    told = []
    found = train_seeds(
        config,
        [0, 1],
        tmp_path / "a",
        progress=lambda seed, done, note: told.append((seed, done)),
    )
    assert set(found) == {0, 1} and {seed for seed, done in told if done == 1} == {0, 1}
    run(config, tmp_path / "b")
    assert same(weights(tmp_path / "a" / "seed-0"), weights(tmp_path / "b"))
    assert not same(weights(tmp_path / "a" / "seed-0"), weights(tmp_path / "a" / "seed-1"))


def test_a_run_is_not_overwritten_nor_mistaken_for_another(run, tmp_path):
    run(PPO, tmp_path, stop=0.2)
    with pytest.raises(ParameterError, match="holds a run already"):
        run(PPO, tmp_path)
    with pytest.raises(ParameterError, match="of another run: its config"):
        run(replace(PPO, reward_scale=2.0), tmp_path, resume=True)
    (tmp_path / ".last.json.abc").write_text("half")  # of a write that was killed
    run(PPO, tmp_path, resume=True)
    assert not list(tmp_path.glob(".*"))


def killed(config, folder, delays):
    """Train in processes of their own, each killed a delay after its first checkpoint."""
    file = folder.parent / "config.json"
    file.write_text(json.dumps(config.to_dict()))
    command = [sys.executable, "-m", "ves_gym.cli.main", "train", str(file), "--seeds", "0"]
    command += ["--out", str(folder), "--resume"]
    checkpoint = folder / "seed-0" / "checkpoint.safetensors"
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
def test_a_killed_run_ends_as_if_it_had_not_been(run, kills, tmp_path):
    config = replace(PPO, total_timesteps=6000)
    run(config, tmp_path / "whole")
    draws = random.Random(time.time_ns())
    delays = [draws.uniform(0.0, 0.4) for _ in range(kills)]
    print("killed after", delays)
    killed(config, tmp_path / "parts", delays)
    run(config, tmp_path / "parts" / "seed-0", resume=True)
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "parts" / "seed-0"))
    assert curve(tmp_path / "whole") == curve(tmp_path / "parts" / "seed-0")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
def test_a_run_whose_worker_is_killed_goes_on_by_itself(run, tmp_path):
    from ves_gym.baselines.train import train_seeds

    config = replace(PPO, total_timesteps=1500)
    run(config, tmp_path / "whole")
    killed = []

    def tell(seed, done, note):
        if 0.3 < done < 0.9 and not killed:
            killed.append(multiprocessing.active_children()[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    found = train_seeds(config, [0, 1], tmp_path / "parts", workers=2, progress=tell)
    assert len(killed) == 1 and set(found) == {0, 1}
    assert same(weights(tmp_path / "whole"), weights(tmp_path / "parts" / "seed-0"))


# ------------------------------------------------------------------- configuration


def test_configurations_of_the_package_are_good():
    configs = [read_config(path) for path in CONFIGS.glob("*.toml")]
    assert {path.stem for path in CONFIGS.glob("*.toml")} == {c.name for c in configs}
    envs = {c.env for c in configs}
    assert {f"ves/{name}-v0" for name in (*TASKS, "PoseReach")} == envs
    assert all(len(c.seeds) >= 5 for c in configs)


TASKS = (
    "PumaRestToRest",
    "PumaReach",
    "PumaReachGoal",
    "PumaTrack",
    "PumaDamp",
    "FreeFlyerReach",
    "BeamLQR",
)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_recipes_among_the_examples_can_be_trained(path):
    from ves_gym.baselines.train import make_learner

    config = read_config(path)
    env = gym.make_vec(config.env, num_envs=4, threads=1, **config.settings).unwrapped
    learner = make_learner(config, 0, env)
    assert config.learner == "native"
    if config.imitate:
        assert learner.imitation.expert.name == config.imitate
        learner.imitation.expert.reset(env, np.arange(4))


def test_an_emulated_id_is_trained_as_its_twin():
    (ideal,) = find_configs("ves/PumaRestToRest-v0", "ppo")
    (found,) = find_configs("ves/PumaRestToRestEmulated-v0", "ppo")
    assert found == replace(ideal, env="ves/PumaRestToRestEmulated-v0")
    assert found.name == "PumaRestToRestEmulated-ppo"
    with pytest.raises(ParameterError, match=r"algorithm must be one of .*ppo.*, got 'dqn'"):
        find_configs("ves/PumaRestToRest-v0", "dqn")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "DQN"}, "algorithm must be one of PPO, SAC"),
        ({"n_envs": 0}, "n_envs must be >= 1"),
        ({"rate": 1}, "unknown key 'rate'"),
        ({"seeds": []}, "seeds must be numbers"),
        ({"her": {}}, "her needs SAC"),
        ({"hyperparameters": {"use_sde": True}}, "cannot set use_sde"),
        ({"final_rate": 2.0}, "final_rate <= 1"),
        ({"learner": "rust"}, "learner must be one of sb3, native"),
        ({"learner": "native", "algorithm": "SAC"}, "native is of PPO"),
        ({"imitate": "resolved"}, "need learner native"),
        ({"learner": "native", "imitation": {"rounds": 2}}, "needs a controller"),
        ({"learner": "native", "algorithm": "DAgger"}, "DAgger needs a controller"),
        ({"features": "arm"}, "need learner native"),
        ({"learner": "native", "features": "leg"}, "features must be one of"),
    ],
)
def test_a_bad_configuration_is_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        config_from_plain({**PPO.to_dict(), **changes})


@pytest.mark.parametrize(
    ("hyperparameters", "message"),
    [
        ({"n_step": 3}, "PPO has no hyper-parameter 'n_step'; known: .*n_steps"),
        ({"n_steps": 1, "batch_size": 1}, "PPO: .*batch_size"),
    ],
)
def test_bad_hyperparameters_are_refused(run, hyperparameters, message, tmp_path):
    config: TrainConfig = replace(PPO, hyperparameters=hyperparameters)
    with pytest.raises(ParameterError, match=message):
        run(config, tmp_path)
