"""The simulated system as a MuJoCo model.

The base moves on three slides and three hinges in Z-Y-X order. A symmetric 6x6 M, D or
K becomes six fixed tendons, one per eigenvector, with the eigenvalue as armature,
damping or stiffness (`docs/physics.md`), so the engine integrates the vehicle natively.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.mujoco_loader import mujoco
from ves_gym._util.params import Array, Index, Vector
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.vehicle import (
    Appendage,
    BaseModel,
    InternalModes,
    ReactionWheel,
    rotor_inertia,
)

# Base joints in the engine's order; Y[i] is engine coordinate TO_Y[i], and back.
BASE_JOINTS = ("x", "y", "z", "phi_z", "phi_y", "phi_x")
TO_Y = np.array([0, 1, 2, 5, 4, 3])

_STIFF = 0.9999  # of a tie, the most that MuJoCo takes: it gives way by what is left of 1

LEAST = 1e-13  # kg, kg m^2: what MuJoCo takes of a body that moves

_INTEGRATORS = {
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
INTEGRATORS = tuple(_INTEGRATORS)


def build_spec(
    arm: Arm,
    base: BaseModel,
    *,
    gravity: tuple[float, float, float],
    integrator: str,
    physics_dt: float,
    whole: bool = False,
) -> mujoco.MjSpec:
    """Return an editable MuJoCo model of the arm on its base.

    Joint drives are one affine actuator per joint, force = act - kp q - kd v, with kp
    and kd zero until a controller sets them. The command is the actuator's activation
    and `ctrl` its slope, so a command can run linearly through a physics step instead of
    jumping between steps.

    Args:
        arm: the arm.
        base: M, D, K or a body.
        gravity: [m/s^2].
        integrator: MuJoCo's name of it.
        physics_dt: [s].
        whole: M, D and K as six tendons each, all on all six axes, whatever their numbers
            are, so that every model of one structure has one layout.
    """
    spec, platform = _empty_spec(arm.name, gravity, integrator, physics_dt)
    set_inertial(platform, regularised_inertial(expand(arm).arm.base))
    if base.body is not None:
        set_inertial(platform.add_body(name="satellite"), base.body)
    _add_tendons(spec, base, whole)
    _add_links(spec, platform, arm)
    return spec


def add_hidden(spec: mujoco.MjSpec, arm: Arm, base: BaseModel | None) -> None:
    """Add springs of gears and flexures, drag and internal modes: last tendons and joints.

    Args:
        spec: written.
        arm: with its gears and flexures.
        base: the vehicle, None on a platform.
    """
    if base is not None:
        add_drag(spec, base)
        if base.internal is not None:
            _add_internal(spec, base.internal)
    for i in arm.geared:
        gear = arm.links[i].gear
        assert gear is not None
        tendon = spec.add_tendon(name=f"gear_{i + 1}")
        tendon.wrap_joint(f"d_{i + 1}", 1.0)
        tendon.springlength = [-gear.gap / 2, gear.gap / 2]  # none within
        tendon.stiffness, tendon.damping = [gear.stiffness, 0, 0], [gear.damping, 0, 0]
    for k, follower in enumerate(arm.followers or (), start=1):
        _add_tie(spec, f"follows_{k}", follower.ratios)
    chain = expand(arm)
    for k, (stiffness, loss) in enumerate(zip(chain.stiffness, chain.damping, strict=True), 1):
        tendon = spec.add_tendon(name=f"flexure_{k}")
        tendon.wrap_joint(f"f_{k}", 1.0)
        tendon.springlength = [0.0, 0.0]
        tendon.stiffness, tendon.damping = [float(stiffness), 0, 0], [float(loss), 0, 0]


def _add_tie(spec: mujoco.MjSpec, joint: str, ratios: Vector) -> None:
    """Hold a joint at the sum of those that it follows, as stiffly as the engine can."""
    tendon = spec.add_tendon(name=joint)
    tendon.springlength = [0.0, 0.0]
    tendon.wrap_joint(joint, 1.0)
    for i, ratio in enumerate(ratios, start=1):
        if ratio:
            tendon.wrap_joint(f"q_{i}", -ratio)
    spec.option.tolerance = 0.0  # it is relative to the mean inertia, 1e10 of prescribed joints
    tie = spec.add_equality(type=mujoco.mjtEq.mjEQ_TENDON, name1=joint)
    tie.solref, tie.solimp = [2 * spec.option.timestep, 1.0], [_STIFF, _STIFF, 1e-3, 0.5, 2.0]


def places(arm: Arm) -> tuple[Index, Index, Index]:
    """Return the engine's coordinates of the motors, of gears and then flexures, and of joints
    that follow others."""
    chain = expand(arm)
    motors, gears, flexures, at = [], [], [], 6
    followers: dict[str, int] = {}
    for k in chain.arm.depth_first():
        part = chain.arm.parts[k]
        if part.ratios is not None:
            followers[part.joint] = at
        elif k in chain.passive:
            flexures.append(at)
        else:
            motors.append(at)
            if part.link.gear is not None:
                at += 1
                gears.append(at)
        at += 1
    following = [followers[f"follows_{i + 1}"] for i in range(len(followers))]
    return (
        np.array(motors, np.intp),
        np.array([*gears, *flexures], np.intp),
        np.array(following, np.intp),
    )


def _add_internal(spec: mujoco.MjSpec, internal: InternalModes) -> None:
    """Slides of unit mass, a spring from each to the base, and damping over all of them."""
    names = [f"u_{k + 1}" for k in range(internal.m)]
    for k, name in enumerate(names):
        body = spec.worldbody.add_body(name=f"internal_{k + 1}")
        body.mass, body.ipos, body.inertia = 1.0, [0, 0, 0], [1.0] * 3
        body.explicitinertial = True
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
        tendon = spec.add_tendon(name=f"internal_stiffness_{k + 1}")
        tendon.wrap_joint(name, 1.0)
        for joint, part in zip(BASE_JOINTS, internal.coupling[TO_Y, k], strict=True):
            tendon.wrap_joint(joint, -float(part))
        tendon.springlength = [0.0, 0.0]
        tendon.stiffness = [float(internal.omega[k] ** 2), 0.0, 0.0]
    order = np.r_[TO_Y, 6 + np.arange(internal.m)]
    damping = internal.damping[np.ix_(order, order)]
    eigenvalues, vectors = np.linalg.eigh(damping)
    least = 1e-15 * np.abs(damping).max()
    for k, (value, vector) in enumerate(zip(eigenvalues, vectors.T, strict=True), start=1):
        tendon = spec.add_tendon(name=f"internal_damping_{k}")
        for joint, part in zip((*BASE_JOINTS, *names), vector, strict=True):
            tendon.wrap_joint(joint, float(part))
        tendon.springlength = [0.0, 0.0]
        tendon.damping = [float(value) if value > least else 0.0, 0.0, 0.0]


def add_drag(spec: mujoco.MjSpec, base: BaseModel) -> None:
    """Add damping c |Y'| Y' of each axis: the second term of the engine's polynomial.

    Args:
        spec: written.
        base: with its drag.
    """
    if base.drag is None:
        return
    for name, drag in zip(BASE_JOINTS, base.drag[TO_Y], strict=True):
        tendon = spec.add_tendon(name=f"drag_{name}")
        tendon.wrap_joint(name, 1.0)
        tendon.springlength, tendon.damping = [0.0, 0.0], [0.0, float(drag), 0.0]


# The platform's: the arm's 1 kN then moves it by 1e-7 m/s^2.
PLATFORM_INERTIA = 1e10  # kg, kg m^2


def build_laboratory_spec(
    arm: Arm,
    *,
    gravity: tuple[float, float, float],
    balance: bool,
    integrator: str,
    physics_dt: float,
) -> mujoco.MjSpec:
    """Return the arm on a platform that moves as commanded, a wrench sensor under its base.

    Six actuators `platform_x` ... come first; their command is the acceleration of the
    base coordinate. Sensors `force` and `moment`: the wrench of the arm on the platform, at
    the platform-top origin in platform axes.

    Args:
        arm, gravity, integrator, physics_dt: see `build_spec`.
        balance: the links' weight is carried outside the motors; the sensors measure it all
            the same.
    """
    spec, platform = _empty_spec(arm.name, gravity, integrator, physics_dt)
    platform.mass, platform.ipos, platform.inertia = 1.0, [0, 0, 0], [1.0, 1.0, 1.0]
    platform.explicitinertial = True
    for name in BASE_JOINTS:
        spec.joint(name).armature = PLATFORM_INERTIA
        _add_drive(spec, f"platform_{name}", name, PLATFORM_INERTIA)
    mount = platform.add_body(name="arm_base")
    set_inertial(mount, regularised_inertial(expand(arm).arm.base))
    mount.add_site(name="mount")
    for name, kind in (
        ("force", mujoco.mjtSensor.mjSENS_FORCE),
        ("moment", mujoco.mjtSensor.mjSENS_TORQUE),
    ):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="mount")
    _add_links(spec, mount, arm)
    for i in range(arm.n):
        spec.body(f"link_{i + 1}").gravcomp = float(balance)
    return spec


def _empty_spec(
    name: str, gravity: tuple[float, float, float], integrator: str, physics_dt: float
) -> tuple[mujoco.MjSpec, Any]:
    """A model with nothing but the platform body on its six joints."""
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    option = spec.option
    option.timestep = physics_dt
    option.integrator = _INTEGRATORS[integrator]
    option.gravity = list(gravity)
    # Keep a diverged state visible instead of resetting it behind the user's back.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT

    platform = spec.worldbody.add_body(name="platform")
    for joint in BASE_JOINTS:
        slide = len(joint) == 1
        kind = mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE
        axis = [float(k == joint[-1]) for k in "xyz"]
        platform.add_joint(name=joint, type=kind, axis=axis)
    return spec, platform


def _add_links(spec: mujoco.MjSpec, root: Any, arm: Arm) -> None:
    """The arm's links, joints and drives on a body at the platform-top frame."""
    chain = expand(arm)
    bodies, bent, driven = {-1: root}, 0, 0
    *frames, (tool, tip) = chain.arm.placements
    for place in chain.arm.depth_first():
        part, (rotation, position) = chain.arm.parts[place], frames[place]
        link, name, joint = part.link, part.body, part.joint
        if place in chain.passive:
            bent += 1
            name, joint = f"part_{bent}", f"f_{bent}"
        elif part.ratios is None:
            driven += 1
            name, joint = f"link_{driven}", f"q_{driven}"
        bodies[place] = body = bodies[part.on].add_body(
            name=name, pos=position.tolist(), quat=quaternion(rotation)
        )
        body.add_joint(
            name=joint,
            type=mujoco.mjtJoint.mjJNT_SLIDE if link.slides else mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            armature=link.rotor_inertia,
        )
        if link.gear is not None:  # the link turns on, the rotor does not
            body.add_joint(name=f"d_{driven}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        set_inertial(body, regularised_inertial(link.inertial_at_joint))
        if joint.startswith("q_"):
            _add_drive(spec, f"drive_{driven}", joint, 1.0, link.tau_max)
    last = bodies[chain.arm.parts.index(chain.arm.ordered[-1])]
    last.add_site(name="tool", pos=tip.tolist(), quat=quaternion(tool))


def _add_drive(
    spec: mujoco.MjSpec, name: str, joint: str, gain: float, limit: float | None = None
) -> None:
    """An actuator whose command (its activation) runs linearly through a physics step."""
    drive = spec.add_actuator(
        name=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        target=joint,
        dyntype=mujoco.mjtDyn.mjDYN_INTEGRATOR,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        gainprm=[gain] + [0.0] * 9,
        biasprm=[0.0] * 10,
    )
    if limit is not None:
        drive.forcerange = [-limit, limit]


def _add_tendons(spec: mujoco.MjSpec, base: BaseModel, whole: bool) -> None:
    """Add six fixed tendons for each of M, D and K, which reproduce the matrix on Y.

    Those of a diagonal matrix lie on one axis, all others on all six, also where a component
    of the eigenvector is zero. Which components come out as exactly zero depends on LAPACK's
    rounding, hence on the processor, and the engine's sums depend on how many there are: a
    simulation would change when a neighbour's vehicle makes its batch take the layout that
    holds every matrix (`whole`, see `Simulator.assign`).
    """
    for what, values in (("armature", base.M), ("damping", base.D), ("stiffness", base.K)):
        diagonal = not (whole or (values - np.diag(np.diag(values))).any())
        eigenvalues, vectors = np.linalg.eigh(values)
        least = 1e-15 * np.abs(values).max()
        for k in range(6):
            value = float(eigenvalues[k]) if eigenvalues[k] > least else 0.0
            if not (whole or value):
                continue
            tendon = spec.add_tendon(name=f"{what}_{k + 1}")
            for name, weight in zip(BASE_JOINTS, vectors[TO_Y, k].tolist(), strict=True):
                if weight != 0.0 or not diagonal:
                    tendon.wrap_joint(name, weight)
            tendon.springlength = [0.0, 0.0]
            # stiffness and damping are polynomials in the engine; the first term is linear
            setattr(tendon, what, value if what == "armature" else [value, 0.0, 0.0])


def regularised_inertial(inertial: Inertial) -> Inertial:
    """The same where MuJoCo takes it for a body that moves: not without mass or inertia.

    A joint next to another, without a link between them, has neither.
    """
    I = np.array(inertial.inertia)
    if inertial.mass >= LEAST and np.linalg.eigvalsh(I)[0] >= LEAST:
        return inertial
    mass = max(inertial.mass, LEAST)
    return replace(inertial, mass=mass, inertia=matrix(I + LEAST * np.eye(3)))


def set_inertial(body: Any, inertial: Inertial) -> None:
    """Give a body of the model mass properties.

    Args:
        body: written.
        inertial: in the body's frame.
    """
    body.mass = inertial.mass
    body.ipos = list(inertial.com)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia
    body.fullinertia = [xx, yy, zz, xy, xz, yz]
    body.explicitinertial = True


def quaternion(rotation: Array) -> list[float]:
    """Attitude of a rotation (3, 3), as MuJoCo's elements take it."""
    out = np.zeros(4)
    mujoco.mju_mat2Quat(out, np.ascontiguousarray(rotation).ravel())
    return [float(k) for k in out]


# ----------------------------------------------------- what a satellite carries

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
