"""Nested state in a file that nothing is executed from."""

import dataclasses
import json
import struct
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.baselines.checkpoint import load_state, save_state
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System


def test_values_come_back_as_they_were(tmp_path):
    value = {
        "numbers": [1, 2.5, True, None, -(2**200), float("inf")],
        ("a", 1): ("text", ["~", {"~": "x"}]),
        "arrays": (
            np.arange(6).reshape(2, 3),
            np.float32(0.1),
            np.zeros((0, 2)),
            np.array(True),
            np.ones((3, 2)).T,  # sums may depend on the order in memory
        ),
        "system": [
            System(vehicle=BENT_THESIS),
            System(vehicle=BENT_THESIS, physics_dt=2.5e-3),
            System(vehicle=BENT_THESIS),
        ],
    }
    save_state(tmp_path / "x", value)
    again = load_state(tmp_path / "x")
    assert again["numbers"] == value["numbers"] and again["system"] == value["system"]
    assert again["system"][0] is again["system"][2]
    assert again["a", 1] == value["a", 1]
    for a, b in zip(again["arrays"], value["arrays"], strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)
        assert np.asarray(a).flags.c_contiguous == np.asarray(b).flags.c_contiguous
    again["arrays"][0][0, 0] = 7  # writable


@pytest.mark.parametrize(
    "settings",
    [{"mode": "emulated", "laboratory": "nominal"}, {"backend": "mujoco"}],
    ids=["emulated", "mujoco"],
)
def test_an_environment_continues_from_the_file(tmp_path, settings):
    def make():
        return gym.make_vec("ves/PumaRestToRest-v0", num_envs=3, threads=1, **settings)

    env, other = make(), make()
    env.reset(seed=1)
    other.reset(seed=2)
    rng = np.random.default_rng(0)
    for _ in range(20):
        env.step(rng.uniform(-1, 1, (3, 3)))
    save_state(tmp_path / "x", env.snapshot(), {"task": env.task})
    other.restore(load_state(tmp_path / "x", {"task": other.task}))
    for _ in range(160):  # into the next episodes
        action = rng.uniform(-1, 1, (3, 3))
        for a, b in zip(env.step(action)[:4], other.step(action)[:4], strict=True):
            np.testing.assert_array_equal(a, b)


@dataclasses.dataclass
class Foreign:
    x: int = 1


class Pair(NamedTuple):
    x: int


@pytest.mark.parametrize(
    "value", [Foreign(), Pair(1), object(), np.array([object()]), {1, 2}, b"bytes"]
)
def test_only_what_can_be_read_safely_is_written(tmp_path, value):
    with pytest.raises(ParameterError, match="a checkpoint cannot hold"):
        save_state(tmp_path / "x", [value])
    assert not (tmp_path / "x").exists()


def forged(tree):
    """A file whose header asks for `tree`."""
    header = json.dumps({"__metadata__": {"state": json.dumps({"value": tree, "systems": []})}})
    return struct.pack("<Q", len(header)) + header.encode()


@pytest.mark.parametrize(
    "name",
    ["os:system", "ves_gym._util.params:write_text", "ves_gym.mechanics.arm:Nobody"],
)
def test_a_file_cannot_name_what_to_build(tmp_path, name):
    path = tmp_path / "x"
    for fields in ([["command", "true"]], []):
        path.write_bytes(forged({"~": "object", "class": name, "of": fields}))
        with pytest.raises(ParameterError, match=f"has no {name}"):
            load_state(path)


LONG = b'{"__metadata__": "' + b"long " * 1000 + b'"}'


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80\x04K\x01.",
        struct.pack("<Q", 2) + b"{}",
        struct.pack("<Q", len(LONG)) + LONG,  # quoted whole by its reader
    ],
)
def test_other_files_are_refused(tmp_path, data):
    path = tmp_path / "x"
    path.write_bytes(data)
    with pytest.raises(ParameterError, match="no checkpoint") as refused:
        load_state(path)
    assert len(str(refused.value)) < 500
    with pytest.raises(ParameterError, match="cannot be read"):
        load_state(tmp_path / "none")
