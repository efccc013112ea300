"""Pure functions on arrays: arm, vehicle, rigid-body dynamics, motion, servo, kinematics."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.mechanics.arm_library import arm_names as arm_names
    from ves_gym.mechanics.arm_library import get_arm as get_arm
    from ves_gym.mechanics.boom import Boom as Boom
    from ves_gym.mechanics.boom import BoomJoint as BoomJoint
    from ves_gym.mechanics.boom import BoomMember as BoomMember
    from ves_gym.mechanics.boom import get_boom as get_boom
    from ves_gym.mechanics.carried import Appendage as Appendage
    from ves_gym.mechanics.carried import ReactionWheel as ReactionWheel
    from ves_gym.mechanics.dynamics import inverse_dynamics as inverse_dynamics
    from ves_gym.mechanics.finite_elements import Material as Material
    from ves_gym.mechanics.finite_elements import Section as Section
    from ves_gym.mechanics.finite_elements import Tube as Tube
    from ves_gym.mechanics.flexible_base import CornerBody as CornerBody
    from ves_gym.mechanics.flexible_base import FlexibleBase as FlexibleBase
    from ves_gym.mechanics.flexible_base import Polyline as Polyline
    from ves_gym.mechanics.flexible_base import Reduced as Reduced
    from ves_gym.mechanics.flexible_base import Strut as Strut
    from ves_gym.mechanics.gravity import GravityModel as GravityModel
    from ves_gym.mechanics.gravity import minimal_model as minimal_model
    from ves_gym.mechanics.kinematics import tool_frame as tool_frame
    from ves_gym.mechanics.orbit import Orbit as Orbit
    from ves_gym.mechanics.pointing import AttitudeControl as AttitudeControl
    from ves_gym.mechanics.pointing import Jet as Jet
    from ves_gym.mechanics.structure import read_structure as read_structure
    from ves_gym.mechanics.vehicle import BENT as BENT
    from ves_gym.mechanics.vehicle import BENT_THESIS as BENT_THESIS

_NAMES = {  # by module
    "arm_library": ("arm_names", "get_arm"),
    "boom": ("Boom", "BoomJoint", "BoomMember", "get_boom"),
    "carried": ("Appendage", "ReactionWheel"),
    "dynamics": ("inverse_dynamics",),
    "finite_elements": ("Material", "Section", "Tube"),
    "flexible_base": ("CornerBody", "FlexibleBase", "Polyline", "Reduced", "Strut"),
    "gravity": ("GravityModel", "minimal_model"),
    "kinematics": ("tool_frame",),
    "orbit": ("Orbit",),
    "pointing": ("AttitudeControl", "Jet"),
    "structure": ("read_structure",),
    "vehicle": ("BENT", "BENT_THESIS"),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_HOMES)
_lazily(__name__, _HOMES)
