"""Reach a point fixed in space with one of two arms on a free-floating satellite."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ves_gym._util.params import Vector, unit
from ves_gym.envs.control import Acceleration, Control
from ves_gym.envs.free_flyer import FreeFlyerReach
from ves_gym.envs.task import register_task
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.vehicle import FREE_FLOATING
from ves_gym.system.system import System

_APART = 0.5  # m from the satellite's middle to either arm
_HOME, _SPAN = (0.0, -75.0, 80.0, -95.0, -90.0, 0.0), (50.0, 25.0, 25.0, 20.0, 20.0, 20.0)


@register_task("dual_arm_reach")
class DualArmReach(FreeFlyerReach):
    """Bring one arm's tool to a point in space while another stops the satellite from turning.

    `FreeFlyerReach` with two UR5e: the last six joints carry the tool that has a target, the
    first six are another arm's, whose task is the reaction. No other actuator acts on the
    satellite. Solved: as there; both arms have come to rest.

    The controller `compensating` plans for both arms, `resolved` locks the second. The first
    leaves 0.03 of the base's mean energy and 0.11 of the mean turn that the second does (20
    starts of seed 0).
    """

    compiled: ClassVar[bool] = True
    system: System = System(
        arms=[get_arm("ur5e").at((0.0, y, 0.0)) for y in (_APART, -_APART)],
        vehicle=FREE_FLOATING,
    )
    control: Control = Acceleration()
    home: Vector = unit("rad", default=tuple(np.deg2rad(_HOME * 2).tolist()))
    span: Vector = unit("rad", default=tuple(np.deg2rad(_SPAN * 2).tolist()))
