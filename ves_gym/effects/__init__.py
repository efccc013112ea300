"""Effects: named physical deviations from the nominal system, a file for each place.

Importing this package files them all under their names in `EFFECTS`.
"""

from __future__ import annotations

from ves_gym.effects.base import (
    BaseAmplitudeDamping,
    BaseDamping,
    BaseExtraMode,
    BaseStiffness,
    BaseUnknown,
    BaseVirtualMass,
)
from ves_gym.effects.command import CommandDelay
from ves_gym.effects.gravity import (
    GravityDelay,
    GravityMass,
    GravityMoment,
    GravityScale,
    GravityTilt,
    GravityTool,
)
from ves_gym.effects.joint_drive import (
    JointBacklash,
    JointDriveGain,
    JointElasticity,
    JointMeasurementDelay,
    JointRipple,
    JointRotorInertia,
    JointTorqueLimit,
    JointTorqueOffset,
    JointVelocityLag,
)
from ves_gym.effects.joint_friction import (
    JointAsymmetry,
    JointCoulomb,
    JointLoadFriction,
    JointStribeck,
    JointViscous,
)
from ves_gym.effects.joint_unnamed import JointCurves, JointMemory, JointUnknown
from ves_gym.effects.payload import PayloadBody, PayloadCom, PayloadInertia, PayloadMass
from ves_gym.effects.platform import (
    PlatformBandwidth,
    PlatformDamping,
    PlatformDelay,
    PlatformStroke,
)
from ves_gym.effects.sensor import (
    LABORATORY_ERRORS,
    SensorBias,
    SensorCalibration,
    SensorDrift,
    SensorLag,
    SensorNoise,
    SensorRotation,
)
from ves_gym.system.effect import (
    EFFECTS,
    ArmEffect,
    BaseEffect,
    DelayEffect,
    Effect,
    LaboratoryEffect,
    TorqueEffect,
)

__all__ = [
    "EFFECTS",
    "LABORATORY_ERRORS",
    "ArmEffect",
    "BaseAmplitudeDamping",
    "BaseDamping",
    "BaseEffect",
    "BaseExtraMode",
    "BaseStiffness",
    "BaseUnknown",
    "BaseVirtualMass",
    "CommandDelay",
    "DelayEffect",
    "Effect",
    "GravityDelay",
    "GravityMass",
    "GravityMoment",
    "GravityScale",
    "GravityTilt",
    "GravityTool",
    "JointAsymmetry",
    "JointBacklash",
    "JointCoulomb",
    "JointCurves",
    "JointDriveGain",
    "JointElasticity",
    "JointLoadFriction",
    "JointMeasurementDelay",
    "JointMemory",
    "JointRipple",
    "JointRotorInertia",
    "JointStribeck",
    "JointTorqueLimit",
    "JointTorqueOffset",
    "JointUnknown",
    "JointVelocityLag",
    "JointViscous",
    "LaboratoryEffect",
    "PayloadBody",
    "PayloadCom",
    "PayloadInertia",
    "PayloadMass",
    "PlatformBandwidth",
    "PlatformDamping",
    "PlatformDelay",
    "PlatformStroke",
    "SensorBias",
    "SensorCalibration",
    "SensorDrift",
    "SensorLag",
    "SensorNoise",
    "SensorRotation",
    "TorqueEffect",
]
