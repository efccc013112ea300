"""Arms by name, those of two packages of robots too, and from files: TOML, JSON, URDF, MJCF."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError, from_plain
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.arm import Arm, read_arm

_DATA = Path(__file__).with_name("arm_data")
_FIRST = "puma560"  # the thesis's
_OTHERS = "_description"  # ends the names of robot_descriptions
_LONGEST = 200  # characters of what others say
FILES = (".toml", ".json", ".urdf", ".xml", ".mjcf")


def arm_names() -> tuple[str, ...]:
    """Names of the arms that come with the package, the thesis's first."""
    return tuple(sorted((k.stem for k in _DATA.glob("*.toml")), key=lambda k: (k != _FIRST, k)))


@lru_cache(maxsize=32)
def _named(name: str) -> Arm:
    return read_arm(_DATA / f"{name}.toml")


PUMA_560 = _named(_FIRST)


def get_arm(name: str | os.PathLike[str], **choice: Any) -> Arm:
    """Return an arm by name or from a file.

    Args:
        name: of an arm that comes with the package; of one in `robot_descriptions`, like
            panda_description, or `example-robot-data`, like ur5_robot; or a file: .toml or
            .json that mirrors `Arm`, .urdf, .mjcf or .xml; FILE#LINK names the link (or site)
            that is the tool.
        choice: how a URDF or MJCF file is read, as `Arm.from_file` takes it.
    """
    text = os.fspath(name)
    file, _, tip = text.partition("#")
    if file.endswith(_OTHERS):
        file = _file_of_description(file)
    elif file not in arm_names():
        file = _file_of_example(file) or file
    suffix = Path(file).suffix.lower()
    if choice and suffix in ("", ".toml", ".json"):
        raise ParameterError(f"{', '.join(choice)} goes with a URDF or MJCF file, got {text!r}")
    if text in arm_names():
        return _named(text)
    if suffix not in FILES:
        raise ParameterError(
            f"arm must be one of {', '.join(arm_names())}, or a {', '.join(FILES[:-1])} or"
            f" {FILES[-1]} file, got {text!r}{did_you_mean(text, arm_names())}"
        )
    if suffix in (".toml", ".json"):
        if tip:
            raise ParameterError(
                f"{text}: a {suffix} file says what is the tool, leave out #{tip}"
            )
        return read_arm(file)
    if tip and choice.get("tip"):
        raise ParameterError(f"{text} and tip={choice['tip']!r} both name the tool: leave one")
    return Arm.from_file(file, **{"tip": tip or None, **choice})


def _file_of_example(name: str) -> str | None:
    """The URDF of a name in `example-robot-data`, which has no code; None without one."""
    try:
        files = metadata.files("example-robot-data") or ()
    except metadata.PackageNotFoundError:
        return None
    matches = [os.path.normpath(k.locate()) for k in files if k.name == f"{name}.urdf"]
    if len(matches) > 1:
        raise ParameterError(f"{name} is several files: take one of {', '.join(matches)}")
    return matches[0] if matches else None


def _file_of_description(name: str) -> str:
    """URDF or MJCF of a robot of `robot_descriptions`, which fetches it where it has to."""
    require(f"arm {name}", "robot_descriptions")
    descriptions = importlib.import_module("robot_descriptions").DESCRIPTIONS
    if name not in descriptions:
        raise ParameterError(
            f"robot_descriptions has no {name!r}{did_you_mean(name, descriptions)}: `python -m"
            " robot_descriptions list` prints its names"
        )
    try:
        with contextlib.redirect_stdout(sys.stderr):  # it tells of its progress
            module = importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:  # no git, no network, no such commit: each raises its own
        text = " ".join(str(error).rpartition("stderr:")[2].split())[:_LONGEST]
        raise ParameterError(f"{name}: robot_descriptions cannot fetch it: {text}") from None
    file: str | None = getattr(module, "URDF_PATH", getattr(module, "MJCF_PATH", None))
    if file is None:
        others = [
            k
            for k, v in descriptions.items()
            if v.has_mjcf and v.robot == descriptions[name].robot
        ]
        raise ParameterError(
            f"{name} is a xacro, no URDF: take {' or '.join(others) or 'another'}, or make a"
            f" URDF of {getattr(module, 'XACRO_PATH', 'it')}"
        )
    return file


def arm_from(value: Any) -> Arm:
    """Return an arm of a name, a file, plain data or an `Arm`."""
    if isinstance(value, Arm):
        return value
    if isinstance(value, (str, os.PathLike)):
        return get_arm(value)
    arm: Arm = from_plain(Arm, value, "arm")
    return arm
