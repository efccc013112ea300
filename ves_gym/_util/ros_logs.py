"""Joints, wrenches and poses of ROS logs: MCAP, rosbag2 and rosbag1, read by `rosbags`.

Messages are read as the four standard types that they say they are: definitions in a file, of
which a reader would make code, are not looked at.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError
from ves_gym._util.signals import interpolated, told_error

SUFFIXES = (".mcap", ".db3", ".bag")
_JOINTS = "sensor_msgs/msg/JointState"
_QUANTITIES = ("position", "velocity", "effort")
_MCAP = b"\x89MCAP0\r\n"  # begins and ends such a file
_ENCODINGS = ("cdr", "ros1")
_Row = tuple[list[str], list[float]]  # names of a message's numbers, and these


def _joint_row(message: Any) -> _Row:
    names, values = [], []
    if len(set(message.name)) < len(message.name):
        raise ValueError(f"names a joint twice: {', '.join(message.name)}")
    for quantity in _QUANTITIES:
        series = getattr(message, quantity)
        if len(series) not in (0, len(message.name)):  # none: it is not measured
            raise ValueError(f"has {len(series)} x {quantity} for {len(message.name)} joints")
        if len(series):
            names += [f"{joint}_{quantity}" for joint in message.name]
            values += list(series)
    return names, values


def _vectors(**vectors: tuple[Any, str]) -> _Row:
    parts = [
        (f"{k}_{axis}", getattr(v, axis)) for k, (v, axes) in vectors.items() for axis in axes
    ]
    return [name for name, _ in parts], [value for _, value in parts]


_ROWS: dict[str, Callable[[Any], _Row]] = {
    _JOINTS: _joint_row,
    "geometry_msgs/msg/WrenchStamped": lambda m: _vectors(
        wrench_force=(m.wrench.force, "xyz"), wrench_torque=(m.wrench.torque, "xyz")
    ),
    "geometry_msgs/msg/PoseStamped": lambda m: _vectors(
        pose_position=(m.pose.position, "xyz"), pose_orientation=(m.pose.orientation, "wxyz")
    ),
    "geometry_msgs/msg/TransformStamped": lambda m: _vectors(
        pose_position=(m.transform.translation, "xyz"),
        pose_orientation=(m.transform.rotation, "wxyz"),
    ),
}


def is_ros_log(path: Path) -> bool:
    """Return whether a file, or a folder, is a log of ROS."""
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").exists()


# ---------------------------------------------------------------------------- in the child


@dataclass
class _Rows:
    """Messages of one topic that share names."""

    topic: str
    joints: bool
    names: dict[str, None] = field(default_factory=dict)  # of all numbers, in order
    stamped: list[int] = field(default_factory=list)  # ns, by the sender; 0: not at all
    received: list[int] = field(default_factory=list)  # ns
    rows: list[dict[str, float]] = field(default_factory=list)

    def append(
        self, message: Any, received: int, names: list[str], values: list[float]
    ) -> None:
        """Add a message."""
        self.names |= dict.fromkeys(names)
        self.stamped.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        self.received.append(received)
        self.rows.append(dict(zip(names, values, strict=True)))


def arrays_of(path: Path) -> dict[str, Any]:
    """Tables of a log as plain arrays, for `read_apart`: one for each topic and its names.

    Returns:
        `topics` and `joints`, of each table its topic and whether it is of joints; of table k
        `columns{k}`, `stamps{k}` (T,) in ns and `values{k}` (T, c), NaN where a message lacks a
        number; `notes`.
    """
    require("a log of ROS", "rosbags")
    for file in path.iterdir() if path.is_dir() else [path]:
        _require_whole(file)
    reader, decode = _opened(path)
    with reader:
        skipped = [f"{c.topic} ({c.msgtype})" for c in reader.connections if not _usable(c)]
        notes = [f"left out: {k}, no joints, wrench or pose" for k in skipped]
        tables = _tables_of(reader, decode, notes)
    if not tables:
        kinds = ", ".join(kind.partition("/msg/")[2] for kind in _ROWS)
        raise ParameterError(f"no message of {kinds}; it has {', '.join(skipped) or 'none'}")
    out: dict[str, Any] = {"topics": np.array([table.topic for table in tables], str)}
    out["joints"] = np.array([table.joints for table in tables], bool)
    for k, table in enumerate(tables):
        if not any(table.stamped):
            notes.append(f"{table.topic}: messages have no stamps, times are of reception")
        stamps = table.stamped if any(table.stamped) else table.received
        out[f"columns{k}"] = np.array([*table.names], str)
        out[f"stamps{k}"] = np.array(stamps, np.int64)
        rows = [[row.get(name, np.nan) for name in table.names] for row in table.rows]
        out[f"values{k}"] = np.array(rows, float)
    return {**out, "notes": np.array(notes, str)}


def _tables_of(reader: Any, decode: Callable[[Any, str], Any], notes: list[str]) -> list[_Rows]:
    """Messages of the four types by topic; a note counts those that are not there."""
    used, tables = [c for c in reader.connections if _usable(c)], list[_Rows]()
    promised, count = Counter[str](), Counter[str]()
    for c in used:
        promised[c.topic] += c.msgcount
    for c, received, data in reader.messages(used) if used else ():
        count[c.topic] += 1
        try:
            message = decode(data, c.msgtype)
            names, values = _ROWS[c.msgtype](message)
        except Exception as error:  # what is damaged makes a decoder raise nearly anything
            text = f"message {count[c.topic]} of {c.topic} cannot be read: {error}"
            raise ParameterError(text) from None
        if names:
            table = _table_with(tables, c, names)
            table.append(message, received, names, values)
    for topic, n in promised.items():
        if count[topic] != n:
            notes.append(f"{topic}: {count[topic]} of {n} messages are there")
    return tables


def _table_with(tables: list[_Rows], connection: Any, names: list[str]) -> _Rows:
    """The topic's table that has any of the names; arm and gripper may share a topic."""
    for table in tables:
        if table.topic == connection.topic and not table.names.keys().isdisjoint(names):
            return table
    tables.append(_Rows(connection.topic, connection.msgtype == _JOINTS))
    return tables[-1]


def _opened(path: Path) -> tuple[Any, Callable[[Any, str], Any]]:
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    if path.suffix.lower() == ".bag":
        return rosbag1.Reader(path), get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
    return rosbag2.Reader(path), get_typestore(Stores.LATEST).deserialize_cdr


def _require_whole(file: Path) -> None:
    """Refuse a file that is cut off, or of which a part lies elsewhere: SQLite reads on."""
    size = file.stat().st_size
    with file.open("rb") as data:
        head = data.read(100)
        data.seek(max(size - len(_MCAP), 0))
        end = data.read()
    if head.startswith(_MCAP) and end != _MCAP:
        raise ParameterError("is cut off (`mcap recover` keeps what there is)")
    if head.startswith(b"SQLite format 3"):  # its header has size and number of pages
        page, pages = int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        expected = (65536 if page == 1 else page) * pages
        if size < expected:
            raise ParameterError(f"is cut off: {size} of {expected} bytes")
        journal = file.with_name(f"{file.name}-wal")
        if journal.exists() and journal.stat().st_size:
            raise ParameterError(
                f"lacks what is in {journal.name}: open and close it once with sqlite3"
            )


def _usable(connection: Any) -> bool:
    encoding = getattr(connection.ext, "serialization_format", "ros1")
    return connection.msgtype in _ROWS and encoding in _ENCODINGS


# -------------------------------------------------------------------------- on one clock


@dataclass(frozen=True)
class _Table:
    topic: str
    joints: bool
    t: Array  # (T,) s from the log's first stamp
    columns: dict[str, Array]  # (T,) each; what is no joint's has its topic in its name


def columns_of(arrays: dict[str, Any], clock: str) -> tuple[dict[str, Array], list[str]]:
    """Return columns on the clock of one topic, and notes on them.

    What has another clock is interpolated to the stamps of the first. Where several topics have
    one joint, `clock` is "TOPIC:t" or "t" of the one that is chosen.
    """
    tables, notes = _tables(arrays), arrays["notes"].tolist()
    first = _first(tables, clock.rpartition(":")[0])
    several = len({table.topic for table in tables if table.joints}) > 1
    name = f"{first.topic}:t" if several else "t"
    columns = {name: first.t - first.t[0], **first.columns}
    for table in sorted(tables, key=lambda table: not table.joints):
        if table is first:
            continue
        repeated = [k for k in table.columns if k in columns]
        steps = np.diff(table.t)
        if repeated:
            notes.append(f"left out: {table.topic}, it has {repeated[0]} as {first.topic} has")
        elif not len(steps) or (steps <= 0).any():
            notes.append(f"left out: {table.topic}, its clock does not run forward")
        else:
            columns |= _resampled(table, first, notes)
    return columns, notes


def _tables(arrays: dict[str, Any]) -> list[_Table]:
    topics = arrays["topics"].tolist()
    start = min(arrays[f"stamps{k}"].min() for k in range(len(topics)))
    out = []
    for k, (topic, joints) in enumerate(zip(topics, arrays["joints"].tolist(), strict=True)):
        names = [n if joints else f"{topic}:{n}" for n in arrays[f"columns{k}"].tolist()]
        # whole nanoseconds only of a difference: a double has no more digits
        t = 1e-9 * (arrays[f"stamps{k}"] - start)
        columns = dict(zip(names, arrays[f"values{k}"].T, strict=True))
        out.append(_Table(topic, joints, t, columns))
    return out


def _first(tables: list[_Table], topic: str) -> _Table:
    """The table whose clock counts: of joints, of the topic that is meant, the longest."""
    usable = [table for table in tables if table.joints] or tables
    topics = ", ".join(dict.fromkeys(table.topic for table in usable))
    chosen = [table for table in usable if topic in ("", table.topic)]
    if not chosen:
        raise ParameterError(f"no topic {topic} of joints; there are {topics}")
    count = Counter(name for table in chosen for name in table.columns)
    name = max(count, key=count.__getitem__)
    if count[name] > 1:
        raise ParameterError(
            f"{name} is in several of {topics}: say which is meant (--topic NAME, in a mapping"
            ' file time = { column = "NAME:t" })'
        )
    return max(chosen, key=lambda table: len(table.t))


def _resampled(table: _Table, first: _Table, notes: list[str]) -> dict[str, Array]:
    """Columns at the first table's stamps; a note says how well they are known."""
    if np.array_equal(table.t, first.t):
        return table.columns
    stacked = np.stack([*table.columns.values()], axis=1)
    values = interpolated(table.t, stacked, first.t)
    notes.append(
        f"{table.topic} is on another clock than {first.topic}: interpolated,"
        f" {told_error(list(table.columns), table.t, stacked)}"
    )
    return dict(zip(table.columns, values.T, strict=True))
