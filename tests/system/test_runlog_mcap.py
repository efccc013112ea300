"""Runs as ROS 2 messages, read by rosbags' own reader."""

import json

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

import ves_gym as vg
from ves_gym.mechanics.attitude import from_angles
from ves_gym.mechanics.kinematics import tool_frame
from ves_gym.mechanics.spatial import rotation
from ves_gym.system.energy import log_base_energy

STORE = get_typestore(Stores.LATEST)


@pytest.fixture(scope="module", params=["ideal", "emulated"])
def log(request):
    motion = vg.Motion.straight([0, 0, 0], [0.5, -0.3, 0.4], 0.4)
    return vg.simulate(motion, vg.System(mode=request.param), settle=0.1, record_dt=0.0125)


def read(path):
    out = {}
    with Reader(path) as reader:
        for connection, stamp, data in reader.messages():
            message = STORE.deserialize_cdr(data, connection.msgtype)
            out.setdefault(connection.topic, []).append((stamp, message))
    return out


def numbers(rows, *names):
    def value(message, name):
        for part in name.split("."):
            message = getattr(message, part)
        return message

    return np.array([[value(message, name) for name in names] for _, message in rows])


def test_every_number_survives(log, tmp_path):
    topics = read(vg.export(log, tmp_path / "run.mcap"))
    joints = topics["/joint_states"]
    assert joints[0][1].name == ["q_1", "q_2", "q_3"]
    assert topics["/joint_commands"][0][1].name[0] == "q_1_command"
    states = np.stack([[m.position, m.velocity, m.effort] for _, m in joints], axis=1)
    np.testing.assert_array_equal(states, [log.q, log.v, log.tau])
    told = np.stack([[m.position, m.velocity] for _, m in topics["/joint_commands"]], axis=1)
    np.testing.assert_array_equal(told, [log.q_cmd, log.v_cmd])
    place = [f"pose.position.{k}" for k in "xyz"]
    turn = [f"pose.orientation.{k}" for k in "wxyz"]
    base = numbers(topics["/base_pose"], *place, *turn)
    np.testing.assert_array_equal(base, np.hstack([log.y[:, :3], from_angles(log.y[:, 3:])]))
    parts = [f"wrench.{kind}.{k}" for kind in ("force", "torque") for k in "xyz"]
    np.testing.assert_array_equal(numbers(topics["/wrench"], *parts), log.w)
    if log.wg is not None:
        np.testing.assert_array_equal(numbers(topics["/wrench_compensated"], *parts), log.wg)
        assert "/base_pose_command" in topics
    tool, _ = tool_frame(vg.PUMA_560, log.q)
    there = log.y[:, :3] + np.einsum("nij,nj->ni", rotation(log.y), tool)
    np.testing.assert_allclose(numbers(topics["/tool_pose"], *place), there, atol=1e-12)
    energy = log_base_energy(log)
    for part in ("total", "strain", "kinetic"):
        values = numbers(topics[f"/base_energy/{part}"], "data")[:, 0]
        np.testing.assert_array_equal(values, getattr(energy, part))


def test_stamps_are_the_logs_clock(log, tmp_path):
    joints = read(vg.export(log, tmp_path / "run.mcap"))["/joint_states"]
    stamps = [stamp for stamp, _ in joints]
    np.testing.assert_allclose(1e-9 * np.array(stamps), log.t, atol=5e-10)
    heads = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in joints]
    assert heads == stamps


def test_the_metadata_go_along(log, tmp_path):
    data = vg.export(log, tmp_path / "run.mcap").read_bytes()
    _, _, rest = data.partition(b"serialized_metadata")
    size = int.from_bytes(rest[:4], "little")
    told = YAML(typ="safe").load(rest[4 : 4 + size].decode())
    assert json.loads(told["custom_data"]["ves_gym"]) == log.meta


def test_a_log_without_a_system_has_what_it_measured(log, tmp_path):
    parts = {k: getattr(log, k) for k in ("t", "q", "q_cmd", "v_cmd", "y", "w")}
    bare = vg.RunLog(**parts, meta={"format": "ves-run/1"})
    topics = read(vg.export(bare, tmp_path / "run.mcap"))
    assert topics.keys() == {"/joint_states", "/joint_commands", "/base_pose", "/wrench"}
    assert not len(topics["/joint_states"][0][1].effort)
