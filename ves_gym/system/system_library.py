"""Systems by name, and from files: arms on booms that carry them, on a host in space."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.system.system import System

ORBITER = Satellite(
    body=Inertial(mass=1e5, com=(-5.0, 3.0, -2.0), inertia=diagonal(1.3e6, 1e7, 1e7)),
    source="nominal, this project: a host of 100 t, as heavy as the Shuttle's orbiter; the"
    " boom's root to one side of its centre of mass",
)


def _driven() -> System:
    from ves_gym.mechanics.boom import SHUTTLE_LIKE  # few systems have a boom

    return System(arm=SHUTTLE_LIKE.carry(get_arm("puma560-wrist")), vehicle=ORBITER)


def _braked() -> System:
    from ves_gym.mechanics.boom import REACHING_OUT, SHUTTLE_LIKE

    arm = SHUTTLE_LIKE.braked(REACHING_OUT, get_arm("puma560-wrist"))
    return System(arm=arm, vehicle=ORBITER)


def _reduced() -> System:
    from ves_gym.mechanics.boom import REACHING_OUT, SHUTTLE_LIKE

    return System(arm=get_arm("puma560-wrist"), vehicle=SHUTTLE_LIKE.at(REACHING_OUT))


SYSTEMS: dict[str, Callable[[], System]] = {
    "macro-micro": _driven,  # a boom of three joints and a PUMA with its wrist on it: nine
    "macro-micro-braked": _braked,  # the boom's joints on their brakes: the PUMA's six
    "macro-micro-reduced": _reduced,  # the same, linear: the boom a base with internal modes
}


def get_system(name: str | os.PathLike[str]) -> System:
    """Return a system by name or from a .toml or .json file.

    Raises:
        ParameterError: neither a known name nor a readable file.
    """
    text = os.fspath(name)
    if text in SYSTEMS:
        return SYSTEMS[text]()
    if Path(text).suffix in (".toml", ".json"):
        return System.load(text)
    raise ParameterError(
        f"system must be one of {', '.join(SYSTEMS)}, or a .toml or .json file, got {text!r}"
        f"{did_you_mean(text, SYSTEMS)}"
    )
