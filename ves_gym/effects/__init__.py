"""Effects: named physical deviations from the nominal system, one per file.

Importing this package files them all under their names in `EFFECTS`.
"""

from __future__ import annotations

from ves_gym.effects.base_amplitude_damping import BaseAmplitudeDamping
from ves_gym.effects.base_damping import BaseDamping
from ves_gym.effects.base_extra_mode import BaseExtraMode
from ves_gym.effects.base_stiffness import BaseStiffness
from ves_gym.effects.base_unknown import BaseUnknown
from ves_gym.effects.base_virtual_mass import BaseVirtualMass
from ves_gym.effects.budget import LABORATORY_ERRORS
from ves_gym.effects.command_delay import CommandDelay
from ves_gym.effects.gravity_delay import GravityDelay
from ves_gym.effects.gravity_mass import GravityMass
from ves_gym.effects.gravity_moment import GravityMoment
from ves_gym.effects.gravity_scale import GravityScale
from ves_gym.effects.gravity_tilt import GravityTilt
from ves_gym.effects.gravity_tool import GravityTool
from ves_gym.effects.joint_asymmetry import JointAsymmetry
from ves_gym.effects.joint_backlash import JointBacklash
from ves_gym.effects.joint_coulomb import JointCoulomb
from ves_gym.effects.joint_curves import JointCurves
from ves_gym.effects.joint_drive_gain import JointDriveGain
from ves_gym.effects.joint_elasticity import JointElasticity
from ves_gym.effects.joint_load_friction import JointLoadFriction
from ves_gym.effects.joint_measurement_delay import JointMeasurementDelay
from ves_gym.effects.joint_memory import JointMemory
from ves_gym.effects.joint_ripple import JointRipple
from ves_gym.effects.joint_rotor_inertia import JointRotorInertia
from ves_gym.effects.joint_stribeck import JointStribeck
from ves_gym.effects.joint_torque_limit import JointTorqueLimit
from ves_gym.effects.joint_torque_offset import JointTorqueOffset
from ves_gym.effects.joint_unknown import JointUnknown
from ves_gym.effects.joint_velocity_lag import JointVelocityLag
from ves_gym.effects.joint_viscous import JointViscous
from ves_gym.effects.payload_body import PayloadBody
from ves_gym.effects.payload_com import PayloadCom
from ves_gym.effects.payload_inertia import PayloadInertia
from ves_gym.effects.payload_mass import PayloadMass
from ves_gym.effects.platform_bandwidth import PlatformBandwidth
from ves_gym.effects.platform_damping import PlatformDamping
from ves_gym.effects.platform_delay import PlatformDelay
from ves_gym.effects.platform_stroke import PlatformStroke
from ves_gym.effects.sensor_bias import SensorBias
from ves_gym.effects.sensor_calibration import SensorCalibration
from ves_gym.effects.sensor_drift import SensorDrift
from ves_gym.effects.sensor_lag import SensorLag
from ves_gym.effects.sensor_noise import SensorNoise
from ves_gym.effects.sensor_rotation import SensorRotation
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
