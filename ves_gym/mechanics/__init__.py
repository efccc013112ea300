"""Pure functions on arrays: arm, vehicle, rigid-body dynamics, motion, servo, kinematics."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.mechanics.gravity import GravityModel as GravityModel
    from ves_gym.mechanics.gravity import minimal_model as minimal_model
    from ves_gym.mechanics.vehicle import BENT as BENT

__all__ = ["BENT", "GravityModel", "minimal_model"]

_HOMES = {"BENT": "vehicle", "GravityModel": "gravity", "minimal_model": "gravity"}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
