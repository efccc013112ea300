"""Policies as ONNX: other engines give the same actions, and none is ever read."""

import itertools

import gymnasium as gym
import numpy as np
import pytest

onnx = pytest.importorskip("onnx")
runtime = pytest.importorskip("onnxruntime")
from onnx.reference import ReferenceEvaluator  # noqa: E402

from ves_gym._util.params import ParameterError  # noqa: E402
from ves_gym.baselines import onnx_file  # noqa: E402
from ves_gym.baselines.arm_features import arm_features  # noqa: E402
from ves_gym.baselines.onnx_file import difference, to_onnx, write_onnx  # noqa: E402
from ves_gym.baselines.policy import (  # noqa: E402
    RELEASED,
    Network,
    Policy,
    load_policy,
)

NAMES = [p.relative_to(RELEASED).with_suffix("").as_posix() for p in RELEASED.glob("*/*.json")]


def drawn(activation="relu", output="tanh", inputs=(), sizes=(7, 16, 9, 2), features=None):
    draw = np.random.default_rng(1)
    weights = tuple(
        (draw.normal(size=(a, b)), draw.normal(size=b)) for a, b in itertools.pairwise(sizes)
    )
    network = Network(
        sizes=sizes, activation=activation, output=output, inputs=inputs, hold=3,
        features=features,
    )  # fmt: skip
    return Policy(network, weights, {"env": "ves/PumaReach-v0"})


@pytest.mark.parametrize("name", sorted(NAMES))
def test_released_policies_act_alike(name):
    """Judges: onnxruntime, and the evaluator of the package onnx, which is NumPy of others."""
    policy = load_policy(name)
    data = to_onnx(policy)
    assert difference(policy, data) <= 1e-6
    net = policy.network
    x = np.random.default_rng(0).uniform(-6, 6, (50, net.entries)).astype(np.float32)
    (theirs,) = ReferenceEvaluator(onnx.load_from_string(data)).run(None, {"observation": x})
    if net.inputs:  # all of it as the first part of the dictionary
        x = {**dict.fromkeys(net.inputs, x[:, :0]), net.inputs[0]: x}
    assert np.abs(theirs - policy(x)).max() <= 1e-6


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("output", ["clip", "tanh"])
def test_every_architecture(activation, output):
    policy = drawn(activation, output)
    assert difference(policy, to_onnx(policy)) <= 1e-6


def test_a_model_computes_the_features_of_a_pose():
    env = gym.make_vec("ves/PoseReach-v0", num_envs=1, control={"kind": "joint_velocity"})
    features = arm_features(env.task)
    policy = drawn(sizes=(len(features.scales) + features.size, 16, 3), features=features)
    assert difference(policy, to_onnx(policy), rows=100) <= 1e-6


def test_onnxruntime_runs_it_and_the_model_says_how_it_is_used(tmp_path):
    policy = drawn(inputs=("observation", "desired_goal"))
    gap = write_onnx(policy, tmp_path / "p.onnx")
    assert gap <= 1e-6
    session = runtime.InferenceSession(tmp_path / "p.onnx", providers=["CPUExecutionProvider"])
    about = session.get_modelmeta().custom_metadata_map
    assert about["inputs"] == "observation desired_goal" and about["hold"] == "3"
    assert session.get_inputs()[0].shape == ["n", 7]


def test_a_model_that_acts_otherwise_is_not_written(tmp_path, monkeypatch):
    other = to_onnx(drawn("tanh"))
    monkeypatch.setattr(onnx_file, "to_onnx", lambda policy: other)
    with pytest.raises(ArithmeticError, match="differ"):
        write_onnx(drawn(), tmp_path / "p.onnx")
    assert list(tmp_path.iterdir()) == []


def test_onnx_is_never_read(tmp_path):
    write_onnx(drawn(), tmp_path / "p.onnx")
    with pytest.raises(ParameterError, match="safetensors"):
        load_policy(tmp_path / "p.onnx")
