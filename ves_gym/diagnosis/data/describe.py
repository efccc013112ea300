"""A first mapping file for one's own data: columns guessed by name, unit and range.

Nothing of it is believed without being read: every guess stands in the file with its grounds,
and what is missing is said at the top.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from scipy.constants import degree

from ves_gym._util.mujoco_loader import read_model
from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_xml
from ves_gym._util.recordings import FileColumns
from ves_gym._util.signals import GAP, told_error
from ves_gym.diagnosis.data.measured_run import BAND
from ves_gym.diagnosis.machines.mjcf_mapping import SCHEMA

_WORDS = {  # what a part of a column's name says
    "clock": ("t", "time", "timestamp", "stamp", "sec", "secs", "seconds"),
    "position": ("q", "pos", "position", "angle", "ang", "theta", "qpos", "joint", "actual",
                 "ist"),
    "velocity": ("v", "dq", "qd", "vel", "velocity", "rate", "speed", "qvel"),
    "force": (
        "tau", "torque", "trq", "effort", "eff", "force", "current", "curr", "i", "cur", "load",
    ),
    "command": (
        "cmd", "command", "des", "desired", "ref", "reference", "target", "goal", "set", "soll",
    ),
}  # fmt: skip
_AMPERE = ("current", "curr", "i", "cur")
# of what is no joint's
_OTHERS = ("tcp", "pose", "cartesian", "wrench", "quaternion", "temp", "temperature", "voltage")
_FILLER = (
    "read", "data", "meas", "measured", "motor", "m", "raw", "log", "act", "present", "fb",
    "feedback", "state", "value", "val",
)  # fmt: skip
_TURNS = 13.0  # rad: more than two turns looks like degrees
_STILL = 1e-3  # rad, m: less is no motion
_FEWEST = 100  # samples: fewer tell nothing
_WAY = 0.2  # s over which ways and rates are compared: noise of either counts little
_OTHER = 0.1  # share of the way that a rate may not explain: a late one leaves 0.02
_UNEVEN = 0.05  # of a step
_FORWARD = 0.95  # share of steps that run forward: less is no clock
_UNITS = {  # by quantity: a unit's name without spaces and marks, and SI units in it
    "clock": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9},
    "position": {"rad": 1.0, "mrad": 1e-3, "deg": degree, "°": degree, "rev": 2 * np.pi,
                 "m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "velocity": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": degree, "°/s": degree,
                 "rpm": np.pi / 30, "1/min": np.pi / 30, "m/s": 1.0, "mm/s": 1e-3},
    "force": {"nm": 1.0, "mnm": 1e-3, "knm": 1e3, "n": 1.0, "kn": 1e3, "a": 1.0, "ma": 1.0},
}  # fmt: skip
# those that may end a name without brackets
_ENDINGS = ("rad_s", "deg_s", "rpm", "rad", "deg", "mnm", "nm", "mm", "ms", "us", "ns")


@dataclass
class _Guess:
    """Columns of a joint."""

    columns: dict[str, str] = field(default_factory=dict)  # quantity -> column
    units: dict[str, str] = field(default_factory=dict)  # quantity -> unit, where it is said
    ampere: bool = False


@dataclass(frozen=True)
class _Name:
    """Meaning of a column's name."""

    words: list[str]
    unit: str  # "": it says none


@dataclass(frozen=True)
class _Time:
    text: str  # of the key `time`
    step: float  # s
    remarks: tuple[str, ...]
    grounds: str = ""


def describe(
    recording: FileColumns,
    source: str,
    model: Path | None = None,
    written: Path | None = None,
    called: Sequence[str] = (),
) -> str:
    """Return a commented mapping file for measured columns.

    Args:
        recording: as `read_recording` gives it.
        source: name of the data, for the comments.
        model: MJCF or URDF, for the names and types of joints.
        written: the model as the mapping file is to name it.
        called: what the columns are, in their order, where the file's own names do not tell.

    Raises:
        ParameterError: no column looks like the position of a joint; the model.
    """
    complete, notes = _complete(recording)
    names = _called(recording, complete, called, source)
    clock = _clock(complete, names)
    notes += _other_clocks(complete, names, clock)
    joints = _joints({k: names[k] for k in complete if k != clock})
    if not joints:
        raise ParameterError(
            f"{source}: no column looks like the position of a joint; it has"
            f" {', '.join(recording.columns)}: say what they are, by place (--columns"
            " t,q_1,v_1,tau_1, in Python called=)"
        )
    used = [c for guess in joints.values() for c in guess.columns.values()]
    time = _time(complete, clock, names, used)
    named = _names(list(joints), model, notes)
    notes += [f"{clock}: {time.grounds}"] if time.grounds.startswith("uneven") else []
    missing = [*time.remarks]
    if (samples := len(next(iter(complete.values())))) < _FEWEST:
        missing.append(f"a log that is long enough: it has {samples} samples")
    for what, consequence in (
        ("velocity", "port `velocity` (rates logged) is not tested"),
        ("force", "port `joint` (friction, payload, drives) is not tested"),
    ):
        lacks = [name for name, guess in joints.items() if what not in guess.columns]
        if lacks and len(lacks) < len(joints):
            missing.append(f"{what} of {', '.join(lacks)}: give it, or take it from all joints")
        elif lacks:
            missing.append(f"{what} of all joints: {consequence}")
    if model is None:
        missing.append(
            'a model: `model = "robot.urdf"` or .xml; without it only rates are tested'
        )
    for key, _, kind in named:
        notes += _doubts(complete, joints[key], kind, 0.0 if time.remarks else time.step)
    unused = [k for k in complete if k not in (*used, clock)]
    alone = [k for k in unused if (kind := _kind(names[k].words)) in ("velocity", "force")
             and _key(names[k].words, kind) not in joints]  # fmt: skip
    if alone:
        notes.append(f"not used, for no position has their name: {', '.join(alone)}")
    lines = [f"# Mapping of {source}: check every guess, then run", "#"]
    lines += [f"#   ves-gym diagnose {source} --machine THIS_FILE", "#"]
    lines += ["# Missing:", *(f"#   - {text}" for text in missing)] if missing else []
    lines += ["# As understood:", *(f"#   * {text}" for text in notes)] if notes else []
    if unused:
        lines.append(f"# Columns not used: {', '.join(unused)}")
    rate = 1 / time.step
    band = min(BAND, float(f"{rate / 5:.2g}"))
    lines += ["", f'schema = "{SCHEMA}"', 'name = "my robot"']
    lines.append(
        '# model = "robot.urdf"'
        if model is None
        else f"model = {_text((written or model).as_posix())}"
    )
    measured = f"; the log has {rate:.4g} Hz" if clock else ""
    lines.append(f"band = {band:g} # Hz compared{measured}")
    lines += [time.text, "", *SETTINGS]
    for key, name, kind in named:
        lines += ["", *_joint_lines(complete, key, joints[key], name, kind, time.step)]
    return "\n".join(lines) + "\n"


SETTINGS = (  # lines of a new mapping file
    "# Errors that a description may have without being called wrong (standard deviations).",
    "# Larger: fewer and surer names, small effects are not seen. Smaller: the reverse.",
    "[tolerance]",
    "inertia = 0.05 # of every link: 0.006 weighed, 0.05 from CAD, 0.2 from drawings",
    "# centre = 0.005 # m, of mass of every link",
    "# gain = 0.0006 # of torques: 0.05 for currents times a data sheet's constant",
    "# friction = 0.03 # N m: less is not worth a name",
    "unexplained = 0.05 # of a torque that no simple law explains: 0.1 for geared robots",
    "",
    "# Noise, where the data hide it (it is estimated from what is faster than motion).",
    "# [noise]",
    "# position = 1e-5 # rad",
    "# force = 0.1 # N m",
    "",
    "# Facts that are better known than that, by the name of the tolerance.",
    "# [known]",
    '# "inertia of link_3" = 0.003 # weighed to 0.3 %',
)


def _complete(recording: FileColumns) -> tuple[dict[str, Array], list[str]]:
    """Columns of the samples, their gaps filled, and what is to be told of the data."""
    notes, out = list(recording.notes), {}
    lengths = Counter(len(x) for x in recording.columns.values() if len(x) > 1)
    samples = lengths.most_common(1)[0][0] if lengths else 0
    for name, x in _once(recording.columns).items():
        good = np.isfinite(x)
        if len(x) != samples or good.sum() < samples / 2:
            if len(x) > 1:
                notes.append(f"{name} left out: {int(good.sum())} numbers in {samples} rows")
            continue
        rows = np.arange(samples)
        out[name] = x if good.all() else np.interp(rows, rows[good], x[good])
    return out, notes


def _called(
    recording: FileColumns, complete: Mapping[str, Array], called: Sequence[str], source: str
) -> dict[str, _Name]:
    """Return the meaning of each column's name; none for a repeated one."""
    columns = recording.columns
    if called and len(called) != len(columns):
        raise ParameterError(
            f"{source}: --columns must name {len(columns)} columns, got {len(called)}"
        )
    words = dict(zip(columns, called or columns, strict=True))
    return {
        k: _Name([], "") if "@" in k else _name_of(words[k], recording.units.get(k, ""))
        for k in complete
    }


def _name_of(name: str, unit: str) -> _Name:
    """Words and unit of a name: `J1 pos [deg]`, `J1_torque_Nm`."""
    bare = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*", name)
    if bare and bare[1]:
        name, unit = bare[1], unit or bare[2]
    if not unit:
        low = name.lower().replace(" ", "_")
        ending = next((k for k in _ENDINGS if low.endswith(f"_{k}")), "")
        if ending:
            name, unit = name[: -len(ending) - 1], ending.replace("_s", "/s")
    return _Name(_parts(name), re.sub(r"[\s*.·]", "", unit).lower())


def _once(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Columns that a folder gives under two names ("x" and "file:x") under the shorter."""
    return {
        name: x
        for name, x in columns.items()
        if ":" not in name or name.split(":", 1)[1] not in columns
    }


def _parts(name: str) -> list[str]:
    """Words and numbers of a column's name, small letters."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", name)
    return [k for k in re.findall(r"[a-z]+|\d+", spaced.lower()) if k]


def _clock(columns: Mapping[str, Array], names: Mapping[str, _Name]) -> str | None:
    rising = {k: float((np.diff(x) > 0).mean()) for k, x in columns.items()}
    by_name = [k for k in rising if set(names[k].words) & set(_WORDS["clock"])]
    best = max(by_name, key=lambda k: rising[k], default=None)
    return best if best is not None and rising[best] >= _FORWARD else None


def _other_clocks(
    columns: Mapping[str, Array], names: Mapping[str, _Name], clock: str | None
) -> list[str]:
    """Say which clock is taken of several that run forward, and how fast the others are."""
    out = []
    for name, x in columns.items() if clock else ():
        forward = np.mean(np.diff(x) > 0) >= _FORWARD
        if name != clock and forward and set(names[name].words) & set(_WORDS["clock"]):
            t = columns[str(clock)]
            rate = float((x[-1] - x[0]) / (t[-1] - t[0]))
            out.append(f"{clock} is the clock; {name} is one, too, {rate:.5g} times as fast")
    return out


def _time(
    columns: Mapping[str, Array],
    clock: str | None,
    names: Mapping[str, _Name],
    used: Sequence[str],
) -> _Time:
    if clock is None:
        text = "time = { step = 0.01 } # s: NOT MEASURED, say the step of the samples"
        return _Time(text, 0.01, ("a clock: say the step of the samples under `time`",))
    t = columns[clock]
    steps = np.diff(t)
    usual = float(np.median(steps))
    unit, gain = ("s", 1.0)
    for name, scale, longest in (("ns", 1e-9, 1e5), ("us", 1e-6, 2e2), ("ms", 1e-3, 0.5)):
        if usual >= longest:
            unit, gain = name, scale
            break
    if names[clock].unit in _UNITS["clock"]:
        unit = names[clock].unit
        gain = _UNITS["clock"][unit]
    remarks = []
    late, back = int(np.argmax(steps)), int(np.argmin(steps))
    if steps[back] <= 0:
        remarks.append(
            f"a clock that runs forward: {np.sum(steps <= 0)} of {len(steps)} steps do not, the"
            f" one to row {back + 3} takes {gain * steps[back]:.3g} s"
        )
    if steps[late] > GAP * usual:
        remarks.append(
            f"a whole clock: row {late + 3} is {gain * steps[late]:.3g} s after the one before;"
            " cut the log there, or give start and stop"
        )
    steps = steps[(steps > 0) & (steps <= GAP * usual)]
    low, high = (1e3 * gain * float(k) for k in (steps.min(), steps.max()))
    mean = gain * float(steps.mean())
    even = f"even steps of {1e3 * mean:.4g} ms"
    if np.abs(steps / usual - 1).max() > _UNEVEN:
        even = f"uneven steps of {low:.4g} to {high:.4g} ms, {1e3 * mean:.4g} ms on average"
        if not remarks:
            signals = np.stack([columns[k] for k in used], axis=1)
            even += f"; resampled, {told_error(used, gain * t, signals)}"
    keys = f'column = "{clock}"'
    if gain != 1.0 or abs(gain * t[0]) > 1e3:
        keys += f", gain = {gain:g}, offset = {0.0 - gain * float(t[0])!r}"
    return _Time(f"time = {{ {keys} }} # {unit}; {even}", mean, tuple(remarks), even)


def _joints(names: Mapping[str, _Name]) -> dict[str, _Guess]:
    """Columns by joint, in the order in which their positions come."""
    out: dict[str, _Guess] = {}
    for quantity in ("position", "velocity", "force"):
        for name, meaning in names.items():
            parts, unit = meaning.words, meaning.unit
            kind = _kind(parts)
            if kind != quantity:
                continue
            key = _key(parts, kind)
            if quantity != "position" and key not in out:
                continue
            guess = out.setdefault(key, _Guess())
            if quantity in guess.columns:
                continue
            guess.columns[quantity] = name
            known = unit in _UNITS[quantity]
            if known:
                guess.units[quantity] = unit
            if quantity == "force":
                guess.ampere = unit.endswith("a") if known else bool(set(parts) & set(_AMPERE))
    return out


def _kind(parts: Sequence[str]) -> str:
    """Return the quantity that a name speaks of; a plain "joint" is the weakest word."""
    if set(parts) & set(_OTHERS):
        return ""
    matches = [kind for kind, words in _WORDS.items() if set(parts) & set(words)]
    for kind in ("command", "velocity", "force", "position"):
        if kind in matches:
            return kind
    return ""


def _names(
    keys: Sequence[str], model: Path | None, told: list[str]
) -> list[tuple[str, str, str]]:
    """Key, name and type of each joint, as the model has them and in its order, where there is
    one; pairs by place are told."""
    if model is None:
        return [(k, k if not k.isdigit() else f"joint_{k}", "hinge") for k in keys]
    inside = _of_model(model)
    if len(inside) != len(keys):
        raise ParameterError(
            f"{model} has {len(inside)} joints ({', '.join(n for n, _ in inside)}), the data"
            f" {len(keys)} ({', '.join(keys)}): name the columns alike, or write the mapping"
        )
    by_name = {_key(_parts(name)): (name, kind) for name, kind in inside}
    alike = [
        next((v for k, v in by_name.items() if k == key or k.endswith(f"_{key}")), None)
        for key in keys
    ]
    if None not in alike and len({*alike}) == len(keys):
        by_joint = dict(zip(alike, keys, strict=True))
        return [(by_joint[joint], *joint) for joint in inside]
    numbered = all(key.isdigit() for key in keys)
    keys = sorted(keys, key=int) if numbered else keys
    pairs = ", ".join(f"{key} = {name}" for key, (name, _) in zip(keys, inside, strict=True))
    which = "numbers do" if numbered else "order does"
    told.append(f"names do not tell which joint is which, their {which}: {pairs}")
    return [(key, *joint) for key, joint in zip(keys, inside, strict=True)]


def _key(parts: Sequence[str], kind: str = "position") -> str:
    """A joint's own name, without words for what is measured of it."""
    drop = {*_WORDS[kind], *_FILLER, *_WORDS["position"]}
    return "_".join(k for k in parts if k not in drop) or "joint"


def _of_model(model: Path) -> list[tuple[str, str]]:
    if model.suffix == ".urdf":
        with named(f"model {model}"):
            root = read_xml(model)
        kinds = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}
        matches = [
            (j.get("name", ""), kinds.get(j.get("type", ""))) for j in root.iter("joint")
        ]
        return [(name, kind) for name, kind in matches if kind]
    with named(f"model {model}"):
        compiled = read_model(model)
    slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
    return [
        (compiled.joint(i).name, "slide" if int(compiled.jnt_type[i]) == slide else "hinge")
        for i in range(compiled.njnt)
    ]


def _position_gain(position: Array, guess: _Guess, kind: str) -> tuple[float, str]:
    """Gain to rad or m, and its grounds, which ask where it is taken by the range."""
    low, high = float(position.min()), float(position.max())
    far, remark = max(abs(low), abs(high)), f"{low:.4g} to {high:.4g}"
    if unit := guess.units.get("position"):
        return _UNITS["position"][unit], f"{remark} {unit}"
    if kind == "hinge" and far > _TURNS:
        asked = "degrees? else take gain away, or 1 / gear ratio for angles of a motor"
        return degree, f"{remark}: {asked}"
    if kind == "slide" and far > 5.0:
        return 1e-3, f"{remark}: mm? else take gain away"
    return 1.0, remark


def _rate_gain(position: Array, logged: Array, step: float, guess: _Guess) -> tuple[float, str]:
    """Gain of a rate to rad/s or m/s, and its grounds, by its unit or else by the position."""
    rate = np.gradient(position, step)
    ratio = float(rate @ logged) / max(float(logged @ logged), 1e-300)
    remark = f"rate of the position over it {ratio:.4g}"
    if unit := guess.units.get("velocity"):
        return _UNITS["velocity"][unit], f"{unit}; {remark}"
    size = abs(ratio) if abs(ratio) > 1e-4 else 1.0  # of what stands nothing is told
    return min((1.0, degree, 1e-3), key=lambda s: abs(np.log(size / s))), remark


def _doubts(columns: Mapping[str, Array], guess: _Guess, kind: str, step: float) -> list[str]:
    """Return remarks on a joint: a unit by its range, spikes, and, for a clock with even
    steps (else 0), a rate that is not its position's."""
    name, rate = guess.columns["position"], guess.columns.get("velocity")
    gain, remark = _position_gain(columns[name], guess, kind)
    out = [f"{name}: {remark}"] if "?" in remark else []
    x = gain * columns[name]
    off = np.abs(x[1:-1] - (x[:-2] + x[2:]) / 2)
    usual = float(np.subtract(*np.quantile(x, (0.95, 0.05))))
    spikes = [k for k in np.flatnonzero(off > max(2 * usual, _STILL))
              if off[k] == off[max(k - 1, 0) : k + 2].max()]  # fmt: skip
    if spikes:
        out.append(f"{name} leaps away and back, {len(spikes)} times, first in row"
                   f" {spikes[0] + 3}: what stands for a missing number?")  # fmt: skip
    window = round(_WAY / step) if step else 0
    if rate is None or not 0 < window < len(x) / 2:
        return out
    v = _rate_gain(x, columns[rate], step, guess)[0] * columns[rate]
    run = step * np.r_[0.0, np.cumsum((v[1:] + v[:-1]) / 2)]
    way, travelled = x[window:] - x[:-window], run[window:] - run[:-window]
    most = max(float(way @ way), float(travelled @ travelled))
    share = float(np.square(way - travelled).sum()) / max(most, 1e-300)
    if most > len(way) * _STILL**2 and share > _OTHER:
        out.append(f"{rate} is not the rate of {name}, by {100 * min(share, 1.0):.0f} %: names"
                   " exchanged, a sign, a unit, a reading that sticks or leaps?")  # fmt: skip
    return out


def _joint_lines(
    columns: Mapping[str, Array], key: str, guess: _Guess, name: str, kind: str, step: float
) -> list[str]:
    """Entries of a joint, each with its grounds."""
    position = columns[guess.columns["position"]]
    out = ["[[joint]]", f"name = {_text(name)}"]
    if kind == "slide":
        out += ['type = "slide"', "radius = 0.1 # m: of the pinion that friction sees"]
    gain, remark = _position_gain(position, guess, kind)
    if np.ptp(position) < _STILL / gain:
        remark += "; hardly moves, so nothing can be told of this joint"
    out.append(_quantity("position", guess.columns["position"], gain, remark))
    if "velocity" in guess.columns:
        logged = columns[guess.columns["velocity"]]
        scale, remark = _rate_gain(gain * position, logged, step, guess)
        out.append(_quantity("velocity", guess.columns["velocity"], scale, remark))
    if "force" in guess.columns:
        force = columns[guess.columns["force"]]
        remark = f"{force.min():.4g} to {force.max():.4g}"
        if guess.ampere:
            remark += (
                "; a current? its gain is found from the load, or give N m at the joint per"
                " unit as gain, and take gain_unknown away"
            )
        gain = _UNITS["force"].get(guess.units.get("force", ""), 1.0)
        out.append(_quantity("force", guess.columns["force"], gain, remark))
        if guess.ampere:
            out.append("gain_unknown = true")
    out.append(
        "# rotor = 0.0 # kg m^2 at the joint, beside the model's: gear ratio^2 x motor's"
    )
    return out


def _quantity(what: str, column: str, gain: float, remark: str) -> str:
    scaled = "" if gain == 1.0 else f", gain = {gain!r}"
    return f"{what} = {{ column = {_text(column)}{scaled} }} # {remark}"


def _text(value: str) -> str:
    """TOML string."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
