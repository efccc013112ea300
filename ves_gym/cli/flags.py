"""The table that a command is: per option its name, its unit and the parameter that takes it.

People write degrees and lists with commas; verbs take radians, tuples and numbers. Everything
between the two is here.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean

if TYPE_CHECKING:
    from ves_gym.mechanics.arm import Arm

UNITS = {"deg": math.pi / 180, "deg/s": math.pi / 180, "deg/s^2": math.pi / 180}  # others: SI


class Place(NamedTuple):
    """Where a value stands: its option, and the arm whose joints it is about."""

    name: str  # --goal
    arm: Arm | None = None
    angles: str | None = None  # "degrees" or "radians", where the user says which


Read: TypeAlias = Callable[[str, Place], Any]


def text(value: str, place: Place) -> str:
    """Take a value as it is."""
    return value


@dataclass(frozen=True)
class Flag:
    """One option: how it is written, how it is read, and the parameter that takes it."""

    name: str  # --goal; without dashes a word of the command line, such as LOG
    form: str = ""  # of its value, in the help; "": a switch, true where it is given
    read: Read = text
    help: str = ""
    to: str = ""  # parameter of the command; default its own name
    many: bool = False  # repeatable; of words, one or more
    row: bool = False  # takes several values at once
    optional: bool = False  # a word that may be left out
    required: bool = False  # an option that may not
    group: str = ""  # under which heading the help has it
    against: str = ""  # options with the same word here exclude each other

    @property
    def parameter(self) -> str:
        """Name of the parameter."""
        return self.to or self.name.lstrip("-").replace("-", "_").lower()


def grouped(group: str, *flags: Flag) -> tuple[Flag, ...]:
    """Put options under one heading of the help."""
    return tuple(replace(flag, group=group) for flag in flags)


def values(flags: Sequence[Flag], given: Mapping[str, Any], arm: Arm | None) -> dict[str, Any]:
    """Return what was given, by parameter and in SI units; what was not is left out.

    Args:
        flags: of the command.
        given: texts by parameter, None or False where there is none.
        arm: whose joints the options are about.
    """
    out: dict[str, Any] = {}
    angles = next((unit for unit in ("degrees", "radians") if given.get(unit)), None)
    for flag in flags:
        value = given.get(flag.parameter)
        if value is None or value is False or value == []:
            continue
        place = Place(flag.name, arm, angles)
        if not flag.form and flag.name.startswith("-"):
            out[flag.parameter] = True
        elif flag.many or flag.row:
            out[flag.parameter] = tuple(flag.read(part, place) for part in value)
        else:
            out[flag.parameter] = flag.read(value, place)
    return out


# ------------------------------------------------------------------------------- readers


def number(unit: str = "", *, above: float | None = None, least: float | None = None) -> Read:
    """Read one number.

    Args:
        unit: it is given in.
        above, least: what it must be more than, or not less than.
    """
    said = "" if above is least is None else f" {'>' if least is None else '>='}"
    said += "" if above is least is None else f" {above if least is None else least:g}"

    def read(value: str, place: Place) -> float:
        try:
            out = float(value)
        except ValueError:
            out = math.nan
        inside = (above is None or out > above) and (least is None or out >= least)
        if not (math.isfinite(out) and inside):
            what = f"{said} {unit}".rstrip() if said else f" a number {unit}".rstrip()
            raise ParameterError(f"{place.name} must be{what}, got {value}")
        return out * UNITS.get(unit, 1.0)

    return read


def whole(least: int = 0, most: int | None = None) -> Read:
    """Read a whole number in a range.

    Args:
        least, most: its ends.
    """

    def read(value: str, place: Place) -> int:
        try:
            out = int(value)
        except ValueError:
            raise ParameterError(
                f"{place.name} must be a whole number >= {least}, got {value!r}"
            ) from None
        if out < least or (most is not None and out > most):
            within = f">= {least}" if most is None else f"from {least} to {most}"
            raise ParameterError(f"{place.name} must be {within}, got {value}")
        return out

    return read


def wholes(value: str, place: Place) -> tuple[int, ...]:
    """Read whole numbers with commas between them."""
    try:
        return tuple(int(part) for part in value.split(","))
    except ValueError:
        raise ParameterError(
            f"{place.name} must be whole numbers like 0,1,2, got {value!r}"
        ) from None


def names(value: str, place: Place) -> list[str]:
    """Read names with commas between them."""
    return [part.strip() for part in value.split(",")]


def one_of(*known: str) -> Read:
    """Read one of some names."""

    def read(value: str, place: Place) -> str:
        if value not in known:
            raise ParameterError(
                f"{place.name} must be one of {', '.join(known)}, got {value!r}"
                f"{did_you_mean(value, known)}"
            )
        return value

    return read


def path(value: str, place: Place) -> Path:
    """Read the name of a file or folder."""
    return Path(value)


def pose(value: str, place: Place) -> Array:
    """Read a pose of the base: x,y,z [m] and angles [deg]."""
    try:
        out = np.array([float(part) for part in value.split(",")])
    except ValueError:
        out = np.full(6, np.nan)
    if out.shape != (6,) or not np.isfinite(out).all():
        raise ParameterError(
            f"{place.name} must be six numbers x,y,z [m] and angles [deg], got {value!r}"
        )
    return np.r_[out[:3], out[3:] * UNITS["deg"]]


def listed(value: str, n: int, place: Place, what: str, like: str) -> Array:
    """Return n numbers with commas between them.

    Args:
        value: what was given.
        n: how many it must be.
        place: of the option.
        what: they are, in the plural, for the error.
        like: an example.
    """
    try:
        out = np.array([float(part) for part in value.split(",")])
    except ValueError:
        raise ParameterError(
            f"{place.name} must be {n} {what}, like {like}, got {value!r}"
        ) from None
    if len(out) != n:
        raise ParameterError(f"{place.name} must be {n} {what}, got {len(out)}: {value!r}")
    return out


def per_joint(unit: str, *, none: bool = False) -> Read:
    """Read a number per joint, such as speeds.

    Args:
        unit: they are given in.
        none: `none` is an answer, too, and taken as it is.
    """

    def read(value: str, place: Place) -> Any:
        if none and value == "none":
            return value
        assert place.arm is not None
        what = "angles in degrees"
        return listed(value, place.arm.n, place, what, "0,-45,90") * UNITS[unit]

    return read


def joints(value: str, place: Place) -> Array:
    """Read joint angles within the arm's limits; of joints that slide [m]."""
    arm = place.arm
    assert arm is not None
    said = place.angles or "degrees"
    given = listed(value, arm.n, place, f"angles in {said}", "0,-45,90")
    angles = given if said == "radians" else given * UNITS["deg"]
    slides = list(arm.sliding)
    angles[slides] = given[slides]
    out = arm.require_within_limits(angles, place.name)
    if place.angles is None and (note := radians_note(value, place.name)):
        say(note, "note")
    return out


def radians_note(value: str, name: str) -> str | None:
    """Return the question that angles given in degrees raise if they look like radians.

    They do if none is beyond a whole turn in radians and one of them has two decimals or more
    and is, to half of its last, a multiple of 15 degrees: 1.57, 0.785, -2.36.

    Args:
        value: numbers with commas between them.
        name: of the option.
    """
    parts = value.split(",")
    if max(abs(float(part)) for part in parts) > 2 * math.pi or not any(map(_is_round, parts)):
        return None
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


# ------------------------------------------------------------------------------- answers


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command has done: its text, its JSON, its files, and what comes next."""

    text: object = ""  # printed by `str`
    plain: Mapping[str, Any] | None = None  # None: there is no result
    files: Sequence[Path | str] = ()
    next: Sequence[Sequence[str | Path]] = ()  # words of commands
    negative: bool = False


def say(sentence: object, kind: str = "") -> None:
    """Say one line beside the result: on stderr, with the program's name before it."""
    print(f"ves-gym: {kind}{': ' if kind else ''}{sentence}", file=sys.stderr)
