"""A typical value of every effect for the PUMA 560; a new effect must be entered here."""

from __future__ import annotations

import dataclasses

import numpy as np

from ves_gym.mechanics.link import matrix
from ves_gym.system.effect import EFFECTS, Effect

CROSS = 0.02 * np.random.default_rng(0).normal(size=(6, 6))

VALUES = {
    "base/amplitude_damping": {"coefficient": (1e3, 1e3, 1e3, 1e4, 1e4, 1e4)},
    "base/damping": {"error": 0.5},
    "base/extra_mode": {
        "mass": 40.0,
        "frequency": 3.0,
        "damping_ratio": 0.02,
        "direction": (1.0, 0.0, 0.5),
    },
    "base/mode": {
        "error": 0.05,
        "frequency": 1.5,
        "momentum": (5.0, 0.0, 1.0, 0.0, 2.0, 0.0),
    },
    "base/stiffness": {"error": -0.2},
    "base/virtual_mass": {"error": 0.2},
    "base/unknown": {
        "stiffness": (5.0, 0.0, 20.0, 3.0, 0.0, 1.0),
        "damping": (2.0, 1.0, 0.0, 0.0, 0.5, 0.2),
    },
    "command/delay": {"delay": 0.007},
    "gravity/delay": {"delay": 0.03},
    "gravity/mass": {"error": 0.5},
    "gravity/moment": {"error": tuple((0.1 * np.arange(1.0, 10.0)).tolist())},
    "gravity/scale": {"error": 0.01},
    "gravity/tool": {"mass": 1.2, "moment": (0.06, -0.03, 0.18)},
    "gravity/tilt": {"angles": (0.01, -0.02, 0.0)},
    "joint/asymmetry": {"coulomb": (1.0, -2.0, 0.5), "viscous": (0.5, 0.5, -0.2)},
    "joint/backlash": {"gap": (0.01, 0.005, 0.01), "compliance": 2e-5, "damping": 5.0},
    "joint/coulomb": {"torque": (1.0, 2.0, 0.5)},
    "joint/curves": {
        "middle": (0.1, -0.2, 0.0),
        "reach": (1.0, 1.5, 2.0),
        "fastest": (1.0, 2.0, 0.5),
        "over_angle": (0.5, -1.0, 0.2, 1.0, 0.5, -0.2, -0.5, 0.3, 0.1),
        "over_angle_turning": (1.0, 2.0, 0.5, 2.0, 1.0, 0.2),
        "over_rate": (-0.5, -1.0, -0.2, 0.0, 0.0, 0.0, 0.5, 1.0, 0.2),
    },
    "joint/drive_gain": {"error": (0.05, -0.05, 0.1)},
    "joint/elasticity": {"compliance": (3e-5, 2e-5, 1e-4), "damping": (5.0, 5.0, 2.0)},
    "joint/load_friction": {"coefficient": (0.05, 0.1, 0.05)},
    "joint/measurement_delay": {"delay": 0.004},
    "joint/memory": {
        "lasting": (1.0, 2.0, 0.5),
        "rested_fast": (1.0, -0.5, 0.5),
        "rested": (2.0, 4.0, 0.5),
        "rested_slow": (3.0, 0.0, 0.5),
    },
    "joint/ripple": {
        "amplitude": (1.0, 1.0, 0.5),
        "cycles": (62.6, 107.8, 53.7),
        "phase": (0.0, 1.0, -2.0),
    },
    "joint/rotor_inertia": {"added": (0.5, 1.0, 0.3)},
    "joint/stribeck": {"coulomb": (1.0,) * 3, "stiction": (2.0,) * 3, "fade_speed": 0.1},
    "joint/torque_limit": {"fraction": (0.9, 0.8, 0.9)},
    "joint/torque_offset": {"torque": (1.0, -2.0, 0.5)},
    "joint/unknown": {
        "middle": (0.1, -0.2, 0.0),
        "reach": (1.0, 1.5, 2.0),
        "surface": tuple(np.random.default_rng(1).normal(size=57).tolist()),
        "level": (1.0, -2.0, 0.5),
        "coulomb": (-2.0, -3.0, -1.0),  # a torque: friction is negative
        "coulomb_along": (0.5, -0.5, 0.2),
        "fading": (-0.5, -1.0, -0.2),
        "asymmetry": (0.5, 1.0, 0.2),
        "viscous": (-0.5, -1.0, -0.2),
        **dict.fromkeys(("viscous_asymmetry", "quadratic"), (0.2, -0.3, 0.1)),
    },
    "joint/velocity_lag": {"time_constant": (0.003, 0.002, 0.005)},
    "joint/viscous": {"damping": (2.0, 2.0, 1.0)},
    "payload/body": {
        "mass": 2.0,
        "moment": (0.2, 0.1, 0.3),
        "inertia": (0.09, -0.01, 0.12, -0.03, -0.015, 0.07),
    },
    "payload/com": {"offset": (0.05, -0.02, 0.03)},
    "payload/inertia": {"error": 0.1},
    "payload/mass": {"mass": 2.0, "position": (0.05, 0.0, 0.1)},
    "platform/bandwidth": {"error": -0.2},
    "platform/damping": {"error": 0.3},
    "platform/delay": {"delay": 0.02},
    "platform/stroke": {"travel": 0.995, "speed": 0.99},
    "sensor/bias": {"force": (1.0, -2.0, 3.0), "moment": (0.5, 0.0, -0.5)},
    "sensor/calibration": {"error": matrix(CROSS)},
    "sensor/drift": {"force": (1.0, 1.0, 1.0), "moment": (0.3,) * 3, "time": 2.0},
    "sensor/lag": {"error": -0.3},
    "sensor/noise": {"force": (1.0, 0.5, 2.0), "moment": (0.1,) * 3},
    "sensor/rotation": {"angles": (0.01, 0.02, -0.03)},
}


def effect(kind: str) -> Effect:
    """The effect at its typical value."""
    return EFFECTS[kind](**VALUES[kind])


def null(kind: str) -> Effect:
    """The effect at its null value; parameters that have none keep the typical one."""
    values = dict(VALUES[kind])
    for field in dataclasses.fields(EFFECTS[kind]):
        zero = field.metadata["null"]
        if zero is not None:
            values[field.name] = np.full(np.shape(values[field.name]), zero)
    return EFFECTS[kind](**values)
