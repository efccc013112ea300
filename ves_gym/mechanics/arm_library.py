"""Arms by name, and from files: TOML and JSON, URDF, MJCF."""

from __future__ import annotations

import os
from functools import lru_cache
from math import pi, radians
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, from_plain
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.arm import Arm, Inertial, Link, diagonal, read_arm

_DATA = Path(__file__).with_name("arm_data")
FILES = (".toml", ".json", ".urdf", ".xml", ".mjcf")

# The PUMA 560 of the thesis, Appendix B, as printed, except where `docs/errata.md` says
# otherwise: its I2zz and I3zz contain the motors' reflected inertia, which is the joint's.
_SOURCE = (
    "thesis Appendix B (Armstrong, Khatib, Burdick 1986); rotor inertias split off I2zz and"
    " I3zz; joint ranges 320/220/270 deg (Corke's Robotics Toolbox model) about the thesis's"
    " zero; torque limits AKB 1986;"
    " a_max: what tau_max gives the arm stretched out, rounded down (this project)"
)

# Base link, platform top to shoulder pan axis. Thesis B.2: r0, M0, I0.
_BASE = Inertial(mass=54.5, com=(0.0, 0.0, 0.283), inertia=diagonal(6.686, 6.465, 1.815))

PUMA_560 = Arm(
    name="puma560",
    source=_SOURCE,
    base=_BASE,
    links=(
        Link(
            d=0.22844 + 0.672,  # d0 + d1
            a=0.0,
            alpha=pi / 2,
            inertial=Inertial(
                mass=12.8, com=(0.0, 0.0, -0.056), inertia=diagonal(0.615, 0.615, 0.081)
            ),
            rotor_inertia=1.14,  # AKB 1986; the thesis's I1 carries none
            q_min=radians(-160),
            q_max=radians(160),
            v_max=radians(82),
            a_max=10.0,
            tau_max=97.6,
        ),
        Link(
            d=-0.2435,
            a=0.4318,
            alpha=0.0,
            inertial=Inertial(
                mass=17.4, com=(-0.3638, 0.006, 0.016), inertia=diagonal(0.130, 0.524, 0.539)
            ),
            rotor_inertia=4.710,  # 5.249 printed = 0.539 + 4.710
            q_min=radians(-110),
            q_max=radians(110),
            v_max=radians(54),
            a_max=15.0,
            tau_max=186.4,
        ),
        Link(
            d=0.098,
            a=0.4331,
            alpha=0.0,
            inertial=Inertial(
                mass=9.0, com=(-0.1420, 0.0, 0.0), inertia=diagonal(0.015, 0.574, 0.589)
            ),
            rotor_inertia=0.835,  # 1.424 printed = 0.589 + 0.835; see docs/errata.md
            q_min=radians(-135),
            q_max=radians(135),
            v_max=radians(122),
            a_max=40.0,
            tau_max=89.4,
        ),
    ),
)


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
    return Arm.from_file(file, tip=tip or None)


def arm_from(value: Any) -> Arm:
    """Return an arm of a name, a file, plain data or an `Arm`."""
    if isinstance(value, Arm):
        return value
    if isinstance(value, (str, os.PathLike)):
        return get_arm(value)
    arm: Arm = from_plain(Arm, value, "arm")
    return arm
