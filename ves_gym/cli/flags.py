"""The table that a command is: per option its name, its unit and the parameter that takes it.

People write degrees and lists with commas; verbs take radians, tuples and numbers. Everything
between the two is here, and what a command receives and prints.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, require_one_of
from ves_gym.report.figures import FORMATS

if TYPE_CHECKING:
    from ves_gym.mechanics.arm import Arm

UNITS = {"deg": math.pi / 180, "deg/s": math.pi / 180, "deg/s^2": math.pi / 180}  # others: SI


class Place(NamedTuple):
    """Context of a value: its option, and the arm whose joints it is about."""

    name: str  # --goal
    arm: Arm | None = None
    angles: str | None = None  # "degrees" or "radians", where the user says which
    beside: Mapping[str, Any] = {}  # what the options say that belong to this one


Read: TypeAlias = Callable[[str, Place], Any]


def read(convert: Callable[[str], Any], expected: str = "") -> Read:
    """Read by a function of the text alone; its ValueError becomes a sentence of what is
    expected, or its own stands."""

    def reader(value: str, place: Place) -> Any:
        try:
            return convert(value)
        except ValueError as error:
            if not expected or isinstance(error, ParameterError):
                raise
        raise ParameterError(f"{place.name} must be {expected}, got {value!r}")

    return reader


def floats(value: str) -> list[float]:
    """Numbers with commas between them."""
    out = [float(part) for part in value.split(",")]
    if any(map(math.isnan, out)):
        raise ValueError
    return out


text = read(str)
path = read(Path)
names = read(lambda value: [part.strip() for part in value.split(",")])
integers = read(
    lambda value: tuple(int(part) for part in value.split(",")), "whole numbers like 0,1,2"
)


@dataclass(frozen=True)
class Flag:
    """One option: how it is written, how it is read, and the parameter that takes it."""

    name: str  # --goal; without dashes a word of the command line, such as LOG
    form: str = ""  # of its value, in the help; "": a switch, true where it is set
    read: Read = text
    help: str = ""
    to: str = ""  # parameter of the command; default its own name
    many: bool = False  # repeatable; of words, one or more
    row: bool = False  # takes several values at once
    optional: bool = False  # a word that may be left out
    required: bool = False  # an option that may not
    group: str = ""  # under which heading the help has it
    against: str = ""  # options with the same word here exclude each other
    of: str = ""  # the option whose reader takes this one, in place of the command

    @property
    def parameter(self) -> str:
        """Name of the parameter."""
        return self.to or self.name.lstrip("-").replace("-", "_").lower()


def grouped(group: str, *flags: Flag) -> tuple[Flag, ...]:
    """Put options under one heading of the help; those that have one keep it."""
    return tuple(replace(flag, group=flag.group or group) for flag in flags)


def values(flags: Sequence[Flag], texts: Mapping[str, Any], arm: Arm | None) -> dict[str, Any]:
    """Return what was written, by parameter and in SI units, about an arm's joints; what was
    not is left out."""
    out: dict[str, Any] = {}
    angles = "degrees" if texts.get("degrees") else "radians" if texts.get("radians") else None
    beside: dict[str, dict[str, Any]] = {}
    for flag in sorted(flags, key=lambda flag: not flag.of):
        value = texts.get(flag.parameter)
        if value is None or value is False or value == []:
            if flag.name in beside:
                first = next(k for k in flags if k.of and k.parameter in beside[flag.name])
                raise ParameterError(f"{first.name} goes with {flag.name} FILE")
            continue
        place = Place(flag.name, arm, angles, beside.get(flag.name, {}))
        taken = beside.setdefault(flag.of, {}) if flag.of else out
        if value is True:
            taken[flag.parameter] = True
        elif flag.many or flag.row:
            taken[flag.parameter] = tuple(flag.read(part, place) for part in value)
        else:
            taken[flag.parameter] = flag.read(value, place)
    return out


# ------------------------------------------------------------------------------- readers


def number(unit: str = "", *, above: float | None = None, least: float | None = None) -> Read:
    """Read one number, in a unit, more than `above` or not less than `least`."""
    if above is not None:
        limit = f"> {above:g}"
    else:
        limit = "a number" if least is None else f">= {least:g}"

    def reader(value: str, place: Place) -> float:
        try:
            out = float(value)
        except ValueError:
            out = math.nan
        inside = (above is None or out > above) and (least is None or out >= least)
        if not (math.isfinite(out) and inside):
            needed = f"{limit} {unit}".rstrip()
            raise ParameterError(f"{place.name} must be {needed}, got {value}")
        return out * UNITS.get(unit, 1.0)

    return reader


def integer(least: int = 0, most: int | None = None) -> Read:
    """Read a whole number in a range."""

    def reader(value: str, place: Place) -> int:
        out: int = read(int, f"a whole number >= {least}")(value, place)
        if out < least or (most is not None and out > most):
            within = f">= {least}" if most is None else f"from {least} to {most}"
            raise ParameterError(f"{place.name} must be {within}, got {value}")
        return out

    return reader


def word_or(word: str, reader: Read, expected: str) -> Read:
    """Read a word that stands for None, such as `auto`, or what another reader takes."""

    def either(value: str, place: Place) -> Any:
        if value == word:
            return None
        try:
            return reader(value, place)
        except ParameterError:
            raise ParameterError(f"{place.name} must be {expected}, got {value!r}") from None

    return either


def one_of(*choices: str) -> Read:
    """Read one of some names."""

    def reader(value: str, place: Place) -> str:
        require_one_of(place.name, value, choices)
        return value

    return reader


def _pose(value: str) -> Array:
    out = np.array(floats(value))
    if out.shape != (6,) or not np.isfinite(out).all():
        raise ValueError
    return np.r_[out[:3], out[3:] * UNITS["deg"]]


pose = read(_pose, "six numbers x,y,z [m] and angles [deg]")


def per_joint(unit: str, what: str = "numbers") -> Read:
    """Read a number per joint, such as speeds, in a unit."""

    def reader(value: str, place: Place) -> Array:
        assert place.arm is not None
        needed = f"{place.arm.n} {what} in {unit}"
        out = np.array(read(floats, f"{needed}, like 0,-45,90")(value, place))
        if len(out) != place.arm.n:
            raise ParameterError(f"{place.name} must be {needed}, got {len(out)}: {value!r}")
        return out * UNITS.get(unit, 1.0)

    return reader


def joints(value: str, place: Place) -> Array:
    """Read joint angles within the arm's limits; of joints that slide [m]."""
    arm = place.arm
    assert arm is not None
    unit = place.angles or "degrees"
    typed = per_joint(unit, "angles")(value, place)
    angles = typed if unit == "radians" else typed * UNITS["deg"]
    slides = list(arm.sliding)
    angles[slides] = typed[slides]
    out = arm.require_within_limits(angles, place.name)
    if place.angles is None and (note := radians_note(value, place.name)):
        say(note, "note")
    return out


def radians_note(value: str, name: str) -> str | None:
    """Return the note on an option's angles in degrees that may be meant in radians.

    They may if none is beyond a whole turn in radians and one has decimals; a note says so.
    It is a question if one of them has two decimals or more and is, to half of its last, a
    multiple of 15 degrees: 1.57, 0.785, -2.36.
    """
    parts = value.split(",")
    if max(map(abs, floats(value))) > 2 * math.pi:
        return None
    if not any(map(_is_round, parts)):
        decimals = any("." in part and float(part) for part in parts)
        note = (
            f"{name} {value} is taken as degrees (--radians takes radians, --degrees says so)"
        )
        return note if decimals else None
    meant = ",".join(f"{_nearest(part):g}" for part in parts)
    return (
        f"{name} {value} looks like radians; angles are degrees: did you mean {meant}?"
        " (--degrees: no; --radians: take them as they are meant)"
    )


def _is_round(part: str) -> bool:
    value, decimals = abs(float(part)), len(part.strip().partition(".")[2])
    if decimals < 2 or "e" in part.lower() or value < math.radians(15) - 5e-3:
        return False
    off = abs(value - math.radians(15) * round(value / math.radians(15)))
    return off <= 0.5001 * 10.0**-decimals


def _nearest(part: str) -> float:
    """Return an angle given in radians in degrees: round where it is meant to be."""
    angle = math.degrees(float(part))
    return 15.0 * round(angle / 15) if _is_round(part) else round(angle, 1)


def _log(value: str) -> Path:
    if Path(value).suffix not in (".toml", ".json"):
        return Path(value)
    from ves_gym.planners.case import load_case

    case = load_case(value)
    if case.log is None:
        raise ParameterError(f"{value}: the case names no log")
    return Path(case.log)


log_file = read(_log)  # the name of a run log, or of a case: that of its log

# --------------------------------------------------------------------- where files are made


def require_writable(folder: Path, name: str) -> Path:
    """Return a folder that is there or can be made; by this name refused where no file can be
    made in it, before work begins."""
    place = folder.absolute()
    while not os.path.lexists(place):
        place = place.parent
    try:
        with tempfile.TemporaryFile(dir=place):
            return folder
    except OSError as error:
        why = "a file" if isinstance(error, NotADirectoryError) else error.strerror
        raise ParameterError(
            f"{name} must be a folder in which files can be made, got {str(folder)!r}"
            f" ({place}: {why})"
        ) from None


def folder_to_fill(value: str, place: Place) -> Path:
    """Read the name of a folder for files, or of a page in one."""
    path = Path(value)
    require_writable(path.parent if path.suffix == ".html" else path, place.name)
    return path


def file_to_write(value: str, place: Place) -> Path:
    """Read the name of a file that a command makes; - stands for standard output."""
    if value != "-":
        require_writable(Path(value).parent, f"the place of {place.name}")
    return Path(value)


# ----------------------------------------------------------------- options of several commands

FILES = (
    Flag("--json", "FILE", lambda value, place: str(file_to_write(value, place)),
         "write the result as JSON; -: print it in place of the text"),
    Flag("--out", "DIR", folder_to_fill, "folder for files this command makes"),
)  # fmt: skip
WORKERS = Flag("--workers", "N", integer(1), "processes; default one per processor")
FORMAT = Flag("--format", "F", one_of(*FORMATS), f"of the pictures: {', '.join(FORMATS)} (png)")
LOG = Flag("LOG", read=log_file, help="a run log, .csv or .parquet, or a case with one")
PICTURES = (Flag("--no-figures", help="no pictures"), FORMAT)  # `main` reads and draws them
START = Flag("--start", "A,B,C", joints, "joint angles [deg] (default 0,0,0)")
GOAL = Flag("--goal", "A,B,C", joints, "joint angles [deg]")
DURATION = Flag("--duration", "S", number("s", above=0), "of the motion [s] (2)")


# --------------------------------------------------------------------------- told and answered


@dataclass(frozen=True, kw_only=True)
class Context:
    """Options common to every command, and what it prints."""

    progress: Any
    out: Path | None = None
    json: str | None = None
    seed: int = 0
    pictures: bool = True
    case: Any = None  # a Case: of commands that take the options of `MACHINE`
    machine: dict[str, Any] = field(default_factory=dict)  # those options that were given

    def folder(self, name: str | Path) -> Path:
        """Return the folder for files: --out, else this default, refused if it cannot be."""
        return self.out or require_writable(Path(name), "the default of --out")

    def log(self, path: Path) -> list[Path]:
        """Return the files of a run log that can be written there, beside the result --json."""
        if path.suffix not in (".csv", ".parquet"):
            raise ParameterError(f"--log must end in .csv or .parquet, got {path.name!r}")
        if path.is_dir():
            raise ParameterError(f"--log must be a file to write, got the folder {str(path)!r}")
        require_writable(path.parent, "the place of --log")
        if path.suffix == ".parquet":
            require("Parquet", "pyarrow")
            return [path]
        files = [path, path.with_suffix(".json")]  # a CSV file has its metadata beside it
        if self.json is not None and Path(self.json).resolve() == files[1].resolve():
            raise ParameterError(
                f"--json {self.json} is where the log's metadata goes; give another name"
            )
        return files


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Result of a command: its text, its JSON, its files, and the commands that follow."""

    text: object = ""  # printed by `str`
    plain: Mapping[str, Any] | None = None  # None: there is no result
    files: Sequence[Path | str] = ()
    # names of files without their suffix -> matplotlib's figures, drawn where they are wanted
    figures: Callable[[], Mapping[str, Any]] | None = None
    folder: Path = Path()  # of the figures
    then: Sequence[Sequence[str | Path]] = ()  # commands that go on from here
    negative: bool = False


def say(sentence: object, kind: str = "") -> None:
    """Say one line beside the result: on stderr, with the program's name before it."""
    print(f"ves-gym: {kind}{': ' if kind else ''}{sentence}", file=sys.stderr)
