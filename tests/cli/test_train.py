"""`ves-gym train`."""

import json

import pytest

from ves_gym.baselines.policy import load_policy
from ves_gym.cli.common import with_effects

CONFIG = """
env = "ves/PumaRestToRest-v0"
algorithm = "PPO"
total_timesteps = 400
n_envs = 8
seeds = [0, 1]
layers = [8]
eval_episodes = 4
settings = { duration = 0.5, tail = 0.5 }
hyperparameters = { n_steps = 16, batch_size = 64, n_epochs = 1 }
"""


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(CONFIG)
    return path


def test_trains_a_policy_per_seed(call, config, tmp_path):
    pytest.importorskip("stable_baselines3")
    status, out, err, result = call("train", config, "--steps", 200)
    assert status == 0 and err == ""
    assert "PumaRestToRest" in out and "100%" in out
    assert result["schema"] == "ves-train/1" and result["config"]["total_timesteps"] == 200
    assert [r["seed"] for r in result["runs"]] == [0, 1]
    for r in result["runs"]:
        assert load_policy(r["policy"]).about["seed"] == r["seed"]
        assert r["policy"] in out and r["steps"] >= 200
    rows = (tmp_path / "out" / "seed-0" / "curve.jsonl").read_text().splitlines()
    assert json.loads(rows[-1])["steps"] == result["runs"][0]["last"]["steps"]

    status, out, err, _ = call("train", config, "--steps", 200)
    assert status == 2 and "holds a run already" in err and err.count("\n") == 1
    status, _, err, again = call("train", config, "--steps", 200, "--resume")
    assert status == 0 and err == ""
    assert [r["best"] for r in again["runs"]] == [r["best"] for r in result["runs"]]


def test_seeds_run_in_processes_of_their_own(call, config):
    pytest.importorskip("stable_baselines3")
    words = ("train", config, "--steps", 130, "--seed", 3)
    status, _, err, result = call(*words, "--workers", 2)
    assert status == 0 and err == ""
    assert [r["seed"] for r in result["runs"]] == [3, 4]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nothing.toml",), "cannot be read"),
        (("ves/Nothing-v0",), "no configuration for ves/Nothing-v0"),
        (("ves/PumaDamp",), 'did you mean "ves/PumaDamp-v0"?'),
        (("PumaRestToRest-v0", "--algo", "dqn"), "algorithm must be one of"),
        (("PumaRestToRest-v0", "--seeds", "one"), "--seeds must be whole numbers"),
        (("PumaRestToRest-v0", "--steps", "0"), "total_timesteps must be >= 1"),
        (("PumaRestToRest-v0", "--workers", "0"), "--workers must be >= 1"),
    ],
)
def test_bad_input_is_one_line(refused, words, message):
    assert message in refused("train", *words)


def test_a_configuration_of_another_algorithm_is_refused(refused, config):
    assert "is for ppo, got algorithm sac" in refused("train", config, "--algo", "sac")


def test_another_arm_takes_its_own_accelerations():
    """Those of the package's configurations are the PUMA's, one per joint."""
    settings = {"control": {"kind": "acceleration", "a_max": [6.0, 6.0, 12.0]}}
    found = with_effects("ves/PumaReach-v0", settings, [], "ur5e")
    assert found["arm"] == "ur5e" and found["control"]["kind"] == "acceleration"
    assert found["control"].get("a_max") is None
    assert with_effects("ves/PumaReach-v0", settings, [], None) == settings
