"""Effects: named physical deviations from the nominal system, a file for each place.

Importing this package files them all under their names in `EFFECTS`.
"""

from __future__ import annotations

from ves_gym.effects.base import BaseAmplitudeDamping as BaseAmplitudeDamping
from ves_gym.effects.base import BaseDamping as BaseDamping
from ves_gym.effects.base import BaseExtraMode as BaseExtraMode
from ves_gym.effects.base import BaseMode as BaseMode
from ves_gym.effects.base import BaseStiffness as BaseStiffness
from ves_gym.effects.base import BaseUnknown as BaseUnknown
from ves_gym.effects.base import BaseVirtualMass as BaseVirtualMass
from ves_gym.effects.gravity import GravityDelay as GravityDelay
from ves_gym.effects.gravity import GravityMass as GravityMass
from ves_gym.effects.gravity import GravityMoment as GravityMoment
from ves_gym.effects.gravity import GravityScale as GravityScale
from ves_gym.effects.gravity import GravityTilt as GravityTilt
from ves_gym.effects.gravity import GravityTool as GravityTool
from ves_gym.effects.joint_drive import CommandDelay as CommandDelay
from ves_gym.effects.joint_drive import JointBacklash as JointBacklash
from ves_gym.effects.joint_drive import JointDriveGain as JointDriveGain
from ves_gym.effects.joint_drive import JointElasticity as JointElasticity
from ves_gym.effects.joint_drive import JointMeasurementDelay as JointMeasurementDelay
from ves_gym.effects.joint_drive import JointRipple as JointRipple
from ves_gym.effects.joint_drive import JointRotorInertia as JointRotorInertia
from ves_gym.effects.joint_drive import JointTorqueLimit as JointTorqueLimit
from ves_gym.effects.joint_drive import JointTorqueOffset as JointTorqueOffset
from ves_gym.effects.joint_drive import JointVelocityLag as JointVelocityLag
from ves_gym.effects.joint_friction import JointAsymmetry as JointAsymmetry
from ves_gym.effects.joint_friction import JointCoulomb as JointCoulomb
from ves_gym.effects.joint_friction import JointLoadFriction as JointLoadFriction
from ves_gym.effects.joint_friction import JointStribeck as JointStribeck
from ves_gym.effects.joint_friction import JointViscous as JointViscous
from ves_gym.effects.joint_unnamed import JointCurves as JointCurves
from ves_gym.effects.joint_unnamed import JointMemory as JointMemory
from ves_gym.effects.joint_unnamed import JointUnknown as JointUnknown
from ves_gym.effects.payload import PayloadBody as PayloadBody
from ves_gym.effects.payload import PayloadCom as PayloadCom
from ves_gym.effects.payload import PayloadInertia as PayloadInertia
from ves_gym.effects.payload import PayloadMass as PayloadMass
from ves_gym.effects.platform import PlatformBandwidth as PlatformBandwidth
from ves_gym.effects.platform import PlatformDamping as PlatformDamping
from ves_gym.effects.platform import PlatformDelay as PlatformDelay
from ves_gym.effects.platform import PlatformStroke as PlatformStroke
from ves_gym.effects.sensor import LABORATORY_ERRORS as LABORATORY_ERRORS
from ves_gym.effects.sensor import SensorBias as SensorBias
from ves_gym.effects.sensor import SensorCalibration as SensorCalibration
from ves_gym.effects.sensor import SensorDrift as SensorDrift
from ves_gym.effects.sensor import SensorLag as SensorLag
from ves_gym.effects.sensor import SensorNoise as SensorNoise
from ves_gym.effects.sensor import SensorRotation as SensorRotation
from ves_gym.system.effect import EFFECTS as EFFECTS
from ves_gym.system.effect import ArmEffect as ArmEffect
from ves_gym.system.effect import BaseEffect as BaseEffect
from ves_gym.system.effect import DelayEffect as DelayEffect
from ves_gym.system.effect import Effect as Effect
from ves_gym.system.effect import LaboratoryEffect as LaboratoryEffect
from ves_gym.system.effect import TorqueEffect as TorqueEffect

__all__ = [name for name in dir() if name[0].isupper()]
