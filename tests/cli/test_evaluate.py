"""`ves-gym evaluate`."""

import numpy as np
import pytest

from ves_gym.baselines.policy import Network, Policy, save_policy

ID = "PumaRestToRest-v0"


@pytest.fixture
def policy(tmp_path):
    """One that does nothing."""
    pytest.importorskip("safetensors")
    network = Network(sizes=(26, 3))
    return save_policy(
        Policy(network, ((np.zeros((26, 3)), np.zeros(3)),)), tmp_path / "still.json"
    )


def test_compares_controllers_on_the_same_episodes(call):
    words = ("evaluate", ID, "--controller", "zero,random", "--episodes", 20, "--n-envs", 7)
    status, out, err, result = call(*words)
    assert status == 0 and err == ""
    assert "zero beats random (return, intervals apart)" in out
    assert result["schema"] == "ves-evaluate/1" and result["id"] == f"ves/{ID}"
    zero, noisy = result["controllers"]
    assert (zero["name"], noisy["name"]) == ("zero", "random")
    assert [r["seed"] for r in zero["rows"]] == [r["seed"] for r in noisy["rows"]]
    assert result["beats"] == [["zero", "random"]]
    assert result["ratios"]["zero"]["E_mean"] == {"value": 1, "low": 1, "high": 1}
    assert result["ratios"]["random"]["E_mean"]["low"] > 1


def test_a_policy_stands_beside_controllers(call, policy, tmp_path):
    folder = tmp_path / "run"
    for seed in (0, 1):
        target = folder / f"seed-{seed}"
        target.mkdir(parents=True)
        for suffix in (".json", ".safetensors"):
            (target / f"best{suffix}").write_bytes(policy.with_suffix(suffix).read_bytes())
    status, out, err, result = call(
        *("evaluate", ID, "--controller", "zero", "--policy", policy, "--policy", folder),
        *("--episodes", 3, "--seed", 9),
    )
    assert status == 0 and err == ""
    zero, still, both = result["controllers"]
    assert still["name"] == "still" and both["name"] == "best x 2"
    assert [r["return"] for r in still["rows"]] == [r["return"] for r in zero["rows"]]
    assert [r["group"] for r in both["rows"]] == [0, 0, 0, 1, 1, 1]
    assert zero["rows"][0]["seed"] == 9 and "best x 2" in out


def test_a_released_policy_is_taken_by_name(call):
    pytest.importorskip("safetensors")
    words = ("evaluate", "PumaDamp-v0", "--episodes", 2)
    _, _, _, default = call(*words)
    assert [c["name"] for c in default["controllers"]] == ["zero", "random", "ppo"]
    _, _, err, result = call(*words, "--controller", "high", "--policy", "released")
    assert [c["name"] for c in result["controllers"]] == ["high", "ppo"] and err == ""
    assert result["controllers"][1]["rows"] == default["controllers"][2]["rows"]
    assert result["ratios"]["ppo"]["E_int"]["value"] < 0.8
    _, _, _, named = call(*words, "--policy", "ppo")
    assert named["controllers"][0]["rows"] == default["controllers"][2]["rows"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("ves/Nothing-v0",), "Nothing"),
        ((ID, "--controller", "best"), "controller must be one of zero"),
        ((ID, "--controller", "zero,zero"), "controllers must differ"),
        ((ID, "--controller", "lqr"), "acts on task lqr"),
        ((ID, "--policy", "none.json"), "cannot be read"),
        ((ID, "--policy", "model.zip"), "pickles are not read"),
        ((ID, "--policy", "genius"), "none released"),
        ((ID, "--policy", "."), "no seed-*/best.json"),
        ((ID, "--episodes", "0"), "episodes must be a whole number from 1"),
    ],
)
def test_bad_input_is_one_line(refused, words, message):
    assert message in refused("evaluate", *words)


def test_any_arm_is_evaluated(call):
    status, _, err, result = call(
        "evaluate", "PumaReach-v0", "--controller", "zero,resolved", "--episodes", "2",
        "--arm", "ur5e",
    )  # fmt: skip
    assert (status, err) == (0, "") and len(result["controllers"]) == 2
    status, _, err, _ = call("evaluate", "PumaReach-v0", "--arm", "ur55")
    assert status == 2 and "arm must be one of puma560" in err
