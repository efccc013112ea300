"""Logs of ROS, written by the writers of `rosbags`."""

from pathlib import Path

import numpy as np
import pytest


def store(distribution="ROS2_HUMBLE"):
    typesys = pytest.importorskip("rosbags.typesys")
    return typesys.get_typestore(typesys.Stores[distribution])


def header(types, ns):
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base")


def joints(topic, t, names, position, velocity=None, effort=None, start=1_700_000_000):
    """Messages of sensor_msgs/JointState: t (T,) s, the rest (T, n)."""
    types, none = store().types, np.zeros((len(t), 0))
    series = [
        none if x is None else np.ascontiguousarray(x, float)
        for x in (position, velocity, effort)
    ]
    for k, ns in enumerate(np.round(1e9 * np.asarray(t)).astype(int).tolist()):
        stamp = ns + start * 10**9
        q, v, tau = (x[k] for x in series)
        message = types["sensor_msgs/msg/JointState"](
            header=header(types, stamp), name=list(names), position=q, velocity=v, effort=tau
        )
        yield topic, stamp, message


def vectors(topic, t, kind, **parts):
    """Messages of a stamped type of geometry_msgs; parts (T, 3) or (T, 4), w first."""
    types, start = store().types, 1_700_000_000
    geometry = {name.rpartition("/")[2]: of for name, of in types.items() if "geometry" in name}
    inside, first, second = {
        "WrenchStamped": ("wrench", "force", "torque"),
        "PoseStamped": ("pose", "position", "orientation"),
        "TransformStamped": ("transform", "translation", "rotation"),
    }[kind]
    for k, ns in enumerate(np.round(1e9 * np.asarray(t)).astype(int).tolist()):
        stamp = ns + start * 10**9
        place = dict(zip("xyz", parts[first][k], strict=True))
        turn = dict(zip("wxyz"[-parts[second].shape[1] :], parts[second][k], strict=True))
        of = geometry["Quaternion" if len(turn) == 4 else "Vector3"](**turn)
        point = geometry["Point" if kind == "PoseStamped" else "Vector3"](**place)
        body = geometry[kind.replace("Stamped", "")](**{first: point, second: of})
        extra = {"child_frame_id": "tool"} if kind == "TransformStamped" else {}
        yield (
            topic,
            stamp,
            geometry[kind](header=header(types, stamp), **{inside: body}, **extra),
        )


def write(path: Path, *series, storage="MCAP"):
    """Write a rosbag2 of some topics; returns the file with the messages."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    known, open_topics = store(), {}
    with rosbag2.Writer(
        path, version=9, storage_plugin=rosbag2.StoragePlugin[storage]
    ) as writer:
        messages = sorted((k for one in series for k in one), key=lambda k: k[1])
        for topic, stamp, message in messages:
            kind = message.__msgtype__
            if topic not in open_topics:
                open_topics[topic] = writer.add_connection(topic, kind, typestore=known)
            writer.write(open_topics[topic], stamp, known.serialize_cdr(message, kind))
    return next(k for k in path.iterdir() if k.suffix != ".yaml")
