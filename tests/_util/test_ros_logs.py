"""Logs of ROS: every topic is used or named, on one clock whose error is told."""

import numpy as np
import pytest

from tests import ros_logs
from ves_gym._util.params import ParameterError
from ves_gym._util.recordings import read_recording
from ves_gym.cli.main import main
from ves_gym.system.runlog import RunLog
from ves_gym.system.runlog_mcap import write_mcap

pytest.importorskip("rosbags")

T = 0.01 * np.arange(200)
JOINTS = ("shoulder_joint", "elbow_joint")
Q = np.column_stack([np.sin(3 * T), np.cos(2 * T)])
V = np.column_stack([3 * np.cos(3 * T), -2 * np.sin(2 * T)])


def arm(topic="/joint_states", t=T, names=JOINTS, **more):
    return ros_logs.joints(topic, t, names, Q, V, **more)


def force(t, topic="/ft_sensor/wrench"):
    wave = np.column_stack([np.sin(4 * t), np.cos(4 * t), 20 + np.sin(t)])
    return ros_logs.vectors(topic, t, "WrenchStamped", force=wave, torque=0.1 * wave)


def pose(t, kind="PoseStamped"):
    first, second = (
        ("position", "orientation") if kind[0] == "P" else ("translation", "rotation")
    )
    turn = np.column_stack([np.cos(t), np.sin(t), 0 * t, 0 * t])
    place = np.column_stack([t, 2 * t, 3 * t])
    return ros_logs.vectors("/tool", t, kind, **{first: place, second: turn})


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_file_and_its_folder_give_the_same_columns(tmp_path, storage):
    file = ros_logs.write(tmp_path / "bag", arm(), storage=storage)
    for path in (file, tmp_path / "bag"):
        got = read_recording(path)
        assert list(got.columns) == [
            "t", *(f"{j}_position" for j in JOINTS), *(f"{j}_velocity" for j in JOINTS)
        ]  # fmt: skip
        np.testing.assert_allclose(got.columns["t"], T, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(got.columns["elbow_joint_position"], Q[:, 1])
        assert got.notes == ()


def test_a_bag_of_ros_1(tmp_path):
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    known = ros_logs.store("ROS1_NOETIC")
    kind, header = "sensor_msgs/msg/JointState", "std_msgs/msg/Header"
    with rosbag1.Writer(tmp_path / "log.bag") as writer:
        topic = writer.add_connection("/joint_states", kind, typestore=known)
        for k, t in enumerate(T):
            ns = round(1e9 * t) + 10**18
            stamp = known.types["builtin_interfaces/msg/Time"](
                sec=ns // 10**9, nanosec=ns % 10**9
            )
            message = known.types[kind](
                header=known.types[header](seq=k, stamp=stamp, frame_id=""),
                name=list(JOINTS), position=Q[k], velocity=V[k], effort=np.zeros(0),
            )  # fmt: skip
            writer.write(topic, ns, known.serialize_ros1(message, kind))
    got = read_recording(tmp_path / "log.bag").columns
    np.testing.assert_allclose(got["t"], T, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(got["shoulder_joint_velocity"], V[:, 0])


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped"])
def test_other_clocks_are_interpolated_and_the_error_is_told(tmp_path, kind):
    """The truth is known; the bound that is told holds."""
    other = np.arange(0.0031, 1.9, 0.013)
    got = read_recording(
        ros_logs.write(tmp_path / "bag", arm(), force(other), pose(other, kind))
    )
    np.testing.assert_allclose(got.columns["t"], T, rtol=0, atol=1e-12)
    x = got.columns["/ft_sensor/wrench:wrench_force_x"]
    inside = (other[0] <= T) & (other[-1] >= T)
    assert np.isfinite(x).tolist() == inside.tolist()  # nothing is made up beyond the ends
    error = np.abs(x - np.sin(4 * T))[inside].max()
    note = next(k for k in got.notes if k.startswith("/ft_sensor/wrench is on another clock"))
    told = float(note.split("at most ")[1].split(" ")[0])
    assert error <= told < 1e-3
    z = got.columns["/tool:pose_position_z"][inside]
    np.testing.assert_allclose(z, 3 * T[inside], rtol=0, atol=1e-9)
    w = got.columns["/tool:pose_orientation_w"][inside]
    np.testing.assert_allclose(w, np.cos(T[inside]), rtol=0, atol=1e-6)
    lacking = int(np.sum(~inside))
    assert f"/tool:pose_position_z: no number in {lacking} of 200 rows" in got.notes


def test_a_gap_in_another_topic_is_no_number(tmp_path):
    other = np.r_[np.arange(0, 0.5, 0.01), np.arange(1, 2, 0.01)] + 1e-3
    x = read_recording(ros_logs.write(tmp_path / "bag", arm(), force(other))).columns
    bad = np.isnan(x["/ft_sensor/wrench:wrench_force_x"])
    assert bad[(T > 0.5) & (T < 1)].all() and not bad[(T > 1.01) & (T < 1.9)].any()


def test_joints_of_two_topics_are_asked_about(tmp_path, capsys):
    """A log of what was measured and of what was wanted."""
    late = T + 4e-3
    ros_logs.write(tmp_path / "bag", arm(), arm("/wanted", late))
    words = ["diagnose", str(tmp_path / "bag"), "--describe", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "is in several of /joint_states, /wanted: say which is meant (--topic" in error
    assert main([*words, "--topic", "/nothing"]) == 2
    assert "no topic /nothing of joints; there are" in capsys.readouterr().err
    assert main([*words, "--topic", "/wanted"]) == 0
    text = (tmp_path / "out" / "mapping.toml").read_text()
    assert 'column = "/wanted:t"' in text and "left out: /joint_states" in text
    from ves_gym.diagnosis.machines.mapping import read_machine

    run = read_machine(tmp_path / "out" / "mapping.toml")[1](tmp_path / "bag")
    np.testing.assert_allclose(run["q"], Q, rtol=0, atol=1e-9)
    assert main(["diagnose", str(tmp_path / "bag"), "--topic", "/wanted"]) == 2


def test_arm_and_gripper_share_a_topic(tmp_path):
    grip = ros_logs.joints(
        "/joint_states", T[:-1:2] + 2e-3, ["finger"], np.sin(T[:-1:2])[:, None]
    )
    got = read_recording(ros_logs.write(tmp_path / "bag", arm(), grip))
    np.testing.assert_array_equal(got.columns["elbow_joint_position"], Q[:, 1])
    x = got.columns["finger_position"]
    np.testing.assert_allclose(x[1:-3], np.sin(T[1:-3] - 2e-3), rtol=0, atol=1e-6)
    assert any("is on another clock" in k for k in got.notes)


def test_a_message_may_lack_joints_or_have_them_in_another_order(tmp_path):
    first = ros_logs.joints("/joint_states", T[:100], JOINTS, Q[:100], V[:100])
    turned = ros_logs.joints("/joint_states", T[100:199], JOINTS[::-1], Q[100:199, ::-1])
    last = ros_logs.joints("/joint_states", T[199:], JOINTS[:1], Q[199:, :1])
    got = read_recording(ros_logs.write(tmp_path / "bag", first, turned, last))
    np.testing.assert_array_equal(got.columns["shoulder_joint_position"], Q[:, 0])
    np.testing.assert_array_equal(got.columns["elbow_joint_position"][:199], Q[:199, 1])
    assert "elbow_joint_position: no number in 1 of 200 rows" in got.notes
    assert "elbow_joint_velocity: no number in 100 of 200 rows" in got.notes


def test_stamps_that_a_sender_leaves_out_are_those_of_reception(tmp_path):
    def unstamped():
        for topic, stamp, message in arm():
            message.header.stamp.sec = message.header.stamp.nanosec = 0
            yield topic, stamp, message

    got = read_recording(ros_logs.write(tmp_path / "bag", unstamped()))
    np.testing.assert_allclose(got.columns["t"], T, rtol=0, atol=1e-12)
    assert got.notes == ("/joint_states: messages have no stamps, times are of reception",)


def test_topics_that_say_nothing_are_named(tmp_path):
    types = ros_logs.store().types

    def words():
        yield "/chat", 1_700_000_000 * 10**9, types["std_msgs/msg/String"](data="go")

    got = read_recording(ros_logs.write(tmp_path / "a", arm(), words()))
    assert got.notes == ("left out: /chat (std_msgs/msg/String), no joints, wrench or pose",)
    with pytest.raises(ParameterError, match=r"no message of JointState.*it has /chat"):
        read_recording(ros_logs.write(tmp_path / "b", words()))
    x = read_recording(ros_logs.write(tmp_path / "c", force(T))).columns
    assert list(x)[:2] == ["t", "/ft_sensor/wrench:wrench_force_x"]


def test_without_the_package_the_sentence_says_what_to_install(tmp_path, monkeypatch):
    from ves_gym._util import optional
    from ves_gym._util import ros_logs as reader

    monkeypatch.setattr(optional, "installed", lambda module: False)
    with pytest.raises(ParameterError, match=r"pip install 'ves-gym\[mcap\]'"):
        reader.arrays_of(tmp_path / "a.mcap")


def test_a_run_that_was_handed_on_comes_back(tmp_path):
    """MCAP of a run of the simulator: joints, wrench and pose as they were."""
    n, rng = 100, np.random.default_rng(0)
    q, w, y = rng.normal(size=(n, 3)), rng.normal(size=(n, 6)), 0.1 * rng.normal(size=(n, 6))
    log = RunLog(
        t=0.01 * np.arange(n),
        q_cmd=q,
        v_cmd=0 * q,
        q=q + 1,
        y=y,
        w=w,
        meta={"format": "ves-run/1"},
    )
    write_mcap(tmp_path / "run.mcap", log)
    got = read_recording(tmp_path / "run.mcap").columns
    clock = got["/joint_states:t"]
    np.testing.assert_allclose(clock, log.t, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(got["q_3_command_position"], q[:, 2])
    np.testing.assert_array_equal(got["q_2_position"], log.q[:, 1])
    np.testing.assert_array_equal(got["/wrench:wrench_torque_z"], w[:, 5])
    np.testing.assert_array_equal(got["/base_pose:pose_position_y"], y[:, 1])
