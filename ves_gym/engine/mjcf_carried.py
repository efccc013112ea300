"""Wheels, appendages and jets of a satellite as MuJoCo's own bodies, joints and actuators."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.mujoco_loader import mujoco
from ves_gym.engine.mjcf import LEAST, regularised_inertial, set_inertial
from ves_gym.mechanics.arm import Inertial, matrix
from ves_gym.mechanics.vehicle import Appendage, BaseModel, ReactionWheel, rotor_inertia

_DISC = 1 + 1e-9  # a shade thicker than a thin disc: the engine compares principal moments


def add_carried(spec: mujoco.MjSpec, base: BaseModel) -> None:
    """Add a body on a hinge or slide for each wheel and appendage; wheels leave the satellite.

    Args:
        spec: written.
        base: with what it carries.
    """
    if not base.carried:
        return
    assert base.body is not None
    platform, inside = spec.body("platform"), np.array(base.body.inertia, float)
    for i, part in enumerate(base.carried, start=1):
        body = platform.add_body(name=f"carried_{i}")
        kind = mujoco.mjtJoint.mjJNT_HINGE
        if isinstance(part, Appendage):
            set_inertial(body, regularised_inertial(part.body))
            if part.joint == "slide":
                kind = mujoco.mjtJoint.mjJNT_SLIDE
            body.add_joint(
                name=f"carried_{i}", type=kind, axis=list(part.axis), pos=list(part.point)
            )
            stiffness, damping = part.stiffness, part.damping
        else:
            rotor = _DISC * rotor_inertia(part) + (1 - _DISC) * _about(part)
            inside -= rotor
            moments = Inertial(mass=LEAST, com=(0.0, 0.0, 0.0), inertia=matrix(rotor))
            set_inertial(body, moments)
            body.add_joint(name=f"carried_{i}", type=kind, axis=list(part.axis))
            stiffness, damping = 0.0, part.viscous
        tendon = spec.add_tendon(name=f"carried_{i}")
        tendon.wrap_joint(f"carried_{i}", 1.0)
        tendon.springlength = [0.0, 0.0]
        tendon.stiffness, tendon.damping = [stiffness, 0, 0], [damping, 0, 0]
    set_inertial(spec.body("satellite"), replace(base.body, inertia=matrix(inside)))


def _about(wheel: ReactionWheel) -> Any:
    axis = np.array(wheel.axis)
    return wheel.inertia * np.outer(axis, axis)


def add_jets(spec: mujoco.MjSpec) -> None:
    """Add six actuators, after the drives: force and moment in the platform's own axes."""
    spec.body("platform").add_site(name="jets")
    for i in range(6):
        gear = [0.0] * 6
        gear[i] = 1.0
        spec.add_actuator(
            name=f"jet_{i + 1}",
            trntype=mujoco.mjtTrn.mjTRN_SITE,
            target="jets",
            gear=gear,
            dyntype=mujoco.mjtDyn.mjDYN_INTEGRATOR,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            biastype=mujoco.mjtBias.mjBIAS_NONE,
            gainprm=[1.0] + [0.0] * 9,
        )
