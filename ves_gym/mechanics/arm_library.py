"""Arms by name, and from files: TOML and JSON, URDF, MJCF."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from ves_gym._util.params import ParameterError, from_plain
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.arm import Arm, read_arm
from ves_gym.mechanics.puma import PUMA_560

_DATA = Path(__file__).with_name("arm_data")
FILES = (".toml", ".json", ".urdf", ".xml", ".mjcf")


def arm_names() -> tuple[str, ...]:
    """Names of the arms that come with the package, the thesis's first."""
    return (PUMA_560.name, *sorted(path.stem for path in _DATA.glob("*.toml")))


@lru_cache(maxsize=32)
def _named(name: str) -> Arm:
    return PUMA_560 if name == PUMA_560.name else read_arm(_DATA / f"{name}.toml")


def get_arm(name: str | os.PathLike[str]) -> Arm:
    """Return an arm by name or from a file.

    Args:
        name: of an arm that comes with the package, or a file: .toml or .json that mirrors
            `Arm`, .urdf, .mjcf or .xml; FILE#LINK names the link (or site) that is the tool.

    Raises:
        ParameterError: neither a known name nor a readable file; what is wrong with one names
            the link.
    """
    text = os.fspath(name)
    if text in arm_names():
        return _named(text)
    file, _, tip = text.partition("#")
    suffix = Path(file).suffix.lower()
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
    if suffix == ".urdf" or _top(file) == "robot":
        return Arm.from_urdf(file, tip=tip or None)
    return Arm.from_mjcf(file, tip=tip or None)


def arm_from(value: Any) -> Arm:
    """Return an arm of a name, a file, plain data or an `Arm`.

    Args:
        value: one of these.
    """
    if isinstance(value, Arm):
        return value
    if isinstance(value, (str, os.PathLike)):
        return get_arm(value)
    arm: Arm = from_plain(Arm, value, "arm")
    return arm


def _top(file: str) -> str:
    """Tag at the top of an XML file."""
    try:
        for _, element in ElementTree.iterparse(file, events=("start",)):
            return str(element.tag)
    except (OSError, ElementTree.ParseError) as error:
        raise ParameterError(f"{file}: cannot be read: {error}") from None
    return ""
