"""The policies that come with the package: safe to read, better than nothing, documented."""

import pickle
import zipfile
from pathlib import Path

import pytest

from scripts import training
from ves_gym.baselines.config import CONFIGS, read_config
from ves_gym.baselines.controllers import Random, Zero
from ves_gym.baselines.evaluate import beats, evaluate
from ves_gym.baselines.policy import RELEASED, load_policy, released
from ves_gym.envs.registration import IDS

ROOT = Path(__file__).parents[2]
CONFIGURED = [read_config(path) for path in sorted(CONFIGS.glob("*.toml"))]
EVERY = [config for config in CONFIGURED if config.label in released(config.env)]


UNTRAINED = {
    "MacroMicro",
    "PayloadTransfer",
    "PumaRestToRest",
    "ServicerCapture",
    "DualArmReach",
    "BerthingContact",
}  # tasks that no policy comes for yet


def test_every_task_but_the_untrained_has_a_policy_and_that_a_configuration():
    made = {path for config in EVERY for path in released(config.env).values()}
    assert made == set(RELEASED.glob("*/*.json"))
    assert {path.parent.name for path in made} == set(IDS) - UNTRAINED
    assert released("ves/PumaDampEmulated-v0") == released("ves/PumaDamp-v0")
    assert released("ves/Nothing-v0") == {}


def test_nothing_but_numbers_and_json_is_shipped():
    for path in RELEASED.rglob("*"):
        assert path.is_dir() or path.suffix in (".json", ".safetensors")
        assert path.is_dir() or not zipfile.is_zipfile(path)
    assert sum(path.stat().st_size for path in RELEASED.rglob("*") if path.is_file()) < 2e6


@pytest.mark.parametrize("config", EVERY, ids=lambda c: c.name)
def test_a_policy_is_what_its_configuration_makes(config, monkeypatch):

    def refuse(*arguments, **more):
        raise AssertionError("a policy was unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    policy = load_policy(released(config.env)[config.label])
    about = policy.about
    assert (about["env"], about["algorithm"]) == (config.env, config.label)
    assert policy.network.sizes[1:-1] == config.layers and policy.network.hold == config.hold
    curves = training.curves(config)
    assert len(curves) >= 5 and about["seed"] in curves
    for rows in curves.values():
        assert rows[0]["steps"] == 0 and rows[-1]["steps"] >= config.total_timesteps
    best = {seed: max(rows, key=lambda r: r["return"]) for seed, rows in curves.items()}
    chosen = max(best, key=lambda seed: best[seed]["return"])
    assert (about["seed"], about["steps"]) == (chosen, best[chosen]["steps"])


@pytest.mark.parametrize(
    "config", [c for c in EVERY if c.algorithm == "PPO"], ids=lambda c: c.name
)
def test_a_policy_beats_doing_nothing_and_chance(config):
    """On a few episodes; test_policies_learn.py has more, test_policies_solve.py the others."""
    policy = load_policy(released(config.env)[config.label])
    some = {"episodes": 24, "seed": 5000, "threads": 1}
    found = evaluate(policy, config.env, **some)
    assert beats(found, evaluate(Zero(), config.env, **some))
    assert beats(found, evaluate(Random(), config.env, **some))
