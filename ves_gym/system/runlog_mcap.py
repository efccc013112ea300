"""A run log as messages of ROS 2 in an MCAP file, for PlotJuggler, Foxglove and `ros2 bag`."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, canonical_json, write_bytes
from ves_gym.mechanics.attitude import from_angles, from_matrix
from ves_gym.mechanics.flexure import link_frames
from ves_gym.mechanics.spatial import rotation
from ves_gym.system.energy import log_base_energy, system_of
from ves_gym.system.runlog import RunLog
from ves_gym.system.runlog_files import META_KEY
from ves_gym.system.system import System

SPACE, PLATFORM = "world", "platform"  # frames: inertial, and that of the platform top
_NS = 10**9  # in a second


class Topic(NamedTuple):
    """Channel of one name: a message per sample."""

    name: str
    kind: str  # of its messages, like sensor_msgs/msg/JointState
    frame: str  # of the numbers
    names: list[str]  # of joints
    rows: tuple[Array | None, ...]  # (N, ...) each, in the order that `_CONTENT` takes them


def write_mcap(path: str | os.PathLike[str], log: RunLog) -> None:
    """Write a run as ROS 2 messages, completely or not at all; every float64 survives.

    Topics: `/joint_states` (position, velocity, effort) and `/joint_commands` (position,
    velocity; joints as `NAME_command`: one name is one number in a file) of JointState;
    `/base_pose`, `/tool_pose` and `/base_pose_command` of PoseStamped
    in the inertial frame; `/wrench`, `/wrench_compensated` of WrenchStamped in platform axes;
    `/base_energy/total`, `strain` and `kinetic` of Float64 [J]. Stamps count from the log's
    first sample. What follows from the system, tool and energies, is left out of a log that
    names none. The log's metadata is in the file's, as JSON.

    Args:
        path: ends in .mcap.
        log: the run.

    Raises:
        MissingPackageError: rosbags is not installed.
        ParameterError: another suffix.
    """
    path = Path(path)
    if path.suffix != ".mcap":
        raise ParameterError(f"{path}: expected a .mcap name")
    require("MCAP", "rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    stamps = np.rint((log.t - log.t[0]) * _NS).astype(np.int64).tolist()
    with tempfile.TemporaryDirectory(prefix="ves-mcap-") as folder:
        bag = Path(folder) / "run"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            writer.set_custom_data(META_KEY, canonical_json(log.meta))
            for topic in topics_of(log):
                connection = writer.add_connection(topic.name, topic.kind, typestore=store)
                messages = _messages(store.types, topic, stamps)
                for stamp, message in zip(stamps, messages, strict=True):
                    data = store.serialize_cdr(message, topic.kind)
                    writer.write(connection, stamp, data)
        write_bytes(path, (bag / "run.mcap").read_bytes())


def topics_of(log: RunLog) -> list[Topic]:
    """Return everything of a log that a message has words for."""
    joints, pose = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
    wrench = "geometry_msgs/msg/WrenchStamped"
    names = _names(log)
    commands = [f"{name}_command" for name in names]
    out = [
        Topic("/joint_states", joints, "", names, (log.q, log.v, log.tau)),
        Topic("/joint_commands", joints, "", commands, (log.q_cmd, log.v_cmd, log.tau_ff)),
    ]
    for name, y in (("/base_pose", log.y), ("/base_pose_command", log.y_cmd)):
        if y is not None:
            out.append(Topic(name, pose, SPACE, [], (y[:, :3], from_angles(y[:, 3:]))))
    for name, w in (("/wrench", log.w), ("/wrench_compensated", log.wg)):
        if w is not None:
            out.append(Topic(name, wrench, PLATFORM, [], (w[:, :3], w[:, 3:])))
    if "system" in log.meta:
        system = system_of(log)
        out.append(Topic("/tool_pose", pose, SPACE, [], tool_pose(log, system)))
        energy = log_base_energy(log, system)
        for part in ("total", "strain", "kinetic"):
            values = getattr(energy, part)
            out.append(Topic(f"/base_energy/{part}", "std_msgs/msg/Float64", "", [], (values,)))
    return out


def tool_pose(log: RunLog, system: System) -> tuple[Array, Array]:
    """Return place (N, 3) [m] and attitude (N, 4), scalar first, of the tool in space."""
    at = link_frames(system.arm, log.q, log.u)
    turn = rotation(log.y)
    place = log.y[:, :3] + (turn @ at.position[:, -1, :, None])[..., 0]
    return place, from_matrix(turn @ at.rotation[:, -1] @ system.arm.tool_rotation)


def _names(log: RunLog) -> list[str]:
    links = system_of(log).arm.links if "system" in log.meta else (None,) * log.n_joints
    return [getattr(k, "name", None) or f"q_{i}" for i, k in enumerate(links, start=1)]


def _messages(types: Any, topic: Topic, stamps: list[int]) -> Iterator[Any]:
    """Yield one message per sample."""
    content = _CONTENT[topic.kind.rpartition("/")[2]]
    header, time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    nothing = np.empty(0)
    for k, stamp in enumerate(stamps):
        head = header(time(stamp // _NS, stamp % _NS), topic.frame)
        rows = [nothing if row is None else row[k] for row in topic.rows]
        yield types[topic.kind](*content(types, head, topic.names, *rows))


def _joints(types: Any, head: Any, names: list[str], *rows: Array) -> tuple[Any, ...]:
    return head, names, *rows


def _pose(types: Any, head: Any, names: list[str], place: Array, turn: Array) -> Any:
    point, quaternion, pose = (
        types[f"geometry_msgs/msg/{k}"] for k in ("Point", "Quaternion", "Pose")
    )
    w, x, y, z = turn.tolist()
    return head, pose(point(*place.tolist()), quaternion(x, y, z, w))


def _wrench(types: Any, head: Any, names: list[str], force: Array, moment: Array) -> Any:
    vector, wrench = (types[f"geometry_msgs/msg/{k}"] for k in ("Vector3", "Wrench"))
    return head, wrench(vector(*force.tolist()), vector(*moment.tolist()))


def _number(types: Any, head: Any, names: list[str], value: Array) -> tuple[Any, ...]:
    return (float(value),)


_CONTENT: dict[str, Callable[..., tuple[Any, ...]]] = {  # of a message, by its kind
    "JointState": _joints,
    "PoseStamped": _pose,
    "WrenchStamped": _wrench,
    "Float64": _number,
}
