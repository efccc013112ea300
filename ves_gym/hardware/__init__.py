"""Parts of the emulator: admittance, force sensor, Stewart platform and its leg servos."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.hardware.force_sensor import ForceSensor as ForceSensor
    from ves_gym.hardware.leg_servo import LegServo as LegServo
    from ves_gym.hardware.platform import PoseServo as PoseServo

__all__ = ["ForceSensor", "LegServo", "PoseServo"]

_HOMES = {"ForceSensor": "force_sensor", "LegServo": "leg_servo", "PoseServo": "platform"}
_lazily(__name__, _HOMES)
