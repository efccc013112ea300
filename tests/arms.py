"""Arms other than the thesis's, to test that nothing depends on three joints."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import ToolPose, frames, joint_positions, tool_frame
from ves_gym.mechanics.link import Inertial, Link, diagonal, matrix
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.vehicle import BENT_THESIS, MatrixVehicle
from ves_gym.planners.obstacles import link_radius
from ves_gym.system.system import System


def planar_arm() -> Arm:
    """Two slender rods of 1 m turning about vertical axes."""
    rod = Inertial(mass=6.0, com=(-0.5, 0.0, 0.0), inertia=diagonal(0.01, 0.5, 0.5))
    link = Link(
        d=0.0,
        a=1.0,
        alpha=0.0,
        inertial=rod,
        rotor_inertia=0.2,
        q_min=-2.5,
        q_max=2.5,
        v_max=2.0,
        a_max=8.0,
        tau_max=80.0,
    )
    base = Inertial(mass=20.0, com=(0.0, 0.0, 0.1), inertia=diagonal(1.0, 1.0, 1.0))
    return Arm(name="planar", base=base, links=(link, link), source="test: two 1 m rods")


# PUMA 560 with its wrist: masses, centres and inertias as in Armstrong, Khatib and Burdick
# (1986) to their order of magnitude.
# d, a, alpha, mass, com, diagonal inertia, rotor, +-q, v_max, a_max, tau_max
_WRIST = (
    (0.90, 0.0, pi / 2, 12.8, (0, 0, -0.056), (0.615, 0.615, 0.081), 1.14, 2.8, 1.4, 10, 97.6),
    (0, 0.4318, 0, 17.4, (-0.36, 0.006, 0.2), (0.13, 0.524, 0.539), 4.71, 1.9, 0.9, 15, 186),
    (0.15, 0.02, -pi / 2, 4.8, (-0.02, 0, 0.07), (0.066, 0.086, 0.03), 0.83, 2.3, 2.1, 40, 89),
    (0.43, 0.0, pi / 2, 0.82, (0, 0, -0.02), (1.8e-3, 1.8e-3, 1.3e-3), 0.2, 1.9, 4.0, 60, 24.2),
    (0.0, 0.0, -pi / 2, 0.34, (0, 0, 0), (0.3e-3, 0.3e-3, 0.4e-3), 0.18, 1.7, 4.0, 60, 20.1),
    (0.06, 0.0, 0.0, 0.09, (0, 0, 0.03), (0.15e-3, 0.15e-3, 0.04e-3), 0.19, 4.6, 4.0, 60, 21.3),
)  # fmt: skip


def six_joint_arm() -> Arm:
    """A PUMA 560 with its wrist; two joints have an angle offset."""
    links = tuple(
        Link(
            d=d,
            a=a,
            alpha=alpha,
            offset=0.3 if i in (2, 4) else 0.0,
            inertial=Inertial(mass=mass, com=com, inertia=diagonal(*moments)),
            rotor_inertia=rotor,
            q_min=-reach,
            q_max=reach,
            v_max=v_max,
            a_max=float(a_max),
            tau_max=tau_max,
        )
        for i, (d, a, alpha, mass, com, moments, rotor, reach, v_max, a_max, tau_max) in (
            enumerate(_WRIST)
        )
    )
    base = Inertial(mass=54.5, com=(0.0, 0.0, 0.283), inertia=diagonal(6.686, 6.465, 1.815))
    return Arm(name="puma560-wrist", base=base, links=links, source="test: after AKB 1986")


def seven_joint_arm() -> Arm:
    """The six-joint arm with a second forearm behind the first: a redundant PUMA."""
    six = six_joint_arm()
    forearm = six.links[2]
    links = (*six.links[:3], replace(forearm, d=0.25, alpha=pi / 2), *six.links[3:])
    return replace(six, name="puma560-seven", links=links)


PLANAR_GAINS = JointServo(kp=(800.0, 500.0), kd=(60.0, 40.0), source="test")
WRIST_GAINS = JointServo(
    kp=(3000.0, 2000.0, 1000.0, 100.0, 100.0, 100.0),
    kd=(50.0, 40.0, 30.0, 5.0, 5.0, 5.0),
    source="test",
)
SEVEN_GAINS = JointServo(
    kp=(3000.0, 2000.0, 1000.0, 1000.0, 100.0, 100.0, 100.0),
    kd=(50.0, 40.0, 30.0, 30.0, 5.0, 5.0, 5.0),
    source="test",
)


def heavier(system: System, share: float, link: int = 2) -> System:
    """The system with one link's mass times a share."""
    links = list(system.arm.links)
    body = replace(links[link].inertial, mass=share * links[link].inertial.mass)
    links[link] = replace(links[link], inertial=body)
    return system.replace(arm=replace(system.arm, links=tuple(links)))


def capsules(arm: Arm, q: Array) -> tuple[Array, Array, Array]:
    """Ends a, b (k, 3) and radii (k,) of a PUMA 560's links and tool at one configuration.

    A link is a capsule along its joint's axis, then one along its length.
    """
    points, axes = joint_positions(arm, q), frames(arm, q).axis
    a, b, r = [points[0]], [points[1]], [link_radius(arm, 0)]
    for i in (1, 2):
        knee = points[i] + arm.links[i].d * axes[i]
        a += [points[i], knee]
        b += [knee, points[i + 1]]
        r += [link_radius(arm, i)] * 2
    a.append(points[-1])
    b.append(points[-1])
    r.append(1.1 * link_radius(arm, 2))
    return np.array(a), np.array(b), np.array(r)


def pinocchio_terms(model: Any, data: Any, z: Array, zd: Array) -> tuple[Array, Array]:
    """Inertia matrix and bias force by Pinocchio, both in its order of coordinates."""
    import pinocchio as pin

    upper = np.triu(pin.crba(model, data, z))
    return upper + np.triu(upper, 1).T, pin.nonLinearEffects(model, data, z, zd).copy()


def with_modes(coupling: float) -> System:
    """The PUMA on the bent beam with two internal modes tied to its pose, or to nothing."""
    bent = System(vehicle=BENT_THESIS).base
    vehicle = MatrixVehicle(
        **{name: matrix(getattr(bent, name)) for name in "MDK"},
        coupling=matrix(coupling * np.eye(6)[:, [0, 4]]),
        omega=(2.0, 5.0),
    )
    return System(vehicle=vehicle)


def tool_pose(arm: Arm, q: Array) -> ToolPose:
    """Pose of the tool at one configuration (n,) [rad], base at rest."""
    place, turn = tool_frame(arm, np.asarray(q, float))
    z, y, x = Rotation.from_matrix(turn).as_euler("ZYX")
    return ToolPose(position=tuple(place.tolist()), angles=(float(x), float(y), float(z)))


def pose_error(arm: Arm, pose: ToolPose, q: Array) -> Array:
    """What is missing to a pose at angles (..., n) [rad], as a twist; a place has no turn."""
    place, turn = tool_frame(arm, np.asarray(q, float))
    if pose.rotation is None:
        return pose.position - place
    turned = pose.rotation @ np.swapaxes(turn, -1, -2)
    return np.concatenate([pose.position - place, Rotation.from_matrix(turned).as_rotvec()], -1)
