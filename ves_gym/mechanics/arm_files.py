"""Arms from URDF and MJCF files, as text of both, and as a model of Pinocchio."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError
from ves_gym._util.reading import named, read_xml
from ves_gym.mechanics.arm import BANDWIDTH, Arm, Capsule, Inertial
from ves_gym.mechanics.arm_reader import ChainChoice, arm_of_tree
from ves_gym.mechanics.attitude import from_matrix
from ves_gym.mechanics.chain import angles_of, upright
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.mjcf_arm import MjcfTree
from ves_gym.mechanics.urdf import UrdfTree

if TYPE_CHECKING:
    import pinocchio

    from ves_gym.mechanics.base_model import BaseModel

_LEAST = 1e-13  # kg, kg m^2: what MuJoCo takes of a body that moves


class ExportWarning(UserWarning):
    """A file's format has no words for a part of the arm."""


def read_file(path: str | os.PathLike[str], choice: ChainChoice) -> Arm:
    """Read an arm from a URDF or MJCF file, see `Arm.from_file`."""
    path = Path(path)
    with named(path.name), np.errstate(all="ignore"):  # what overflows is refused
        top = read_xml(path).tag
        if top not in ("robot", "mujoco"):
            raise ParameterError(f"expected <robot> or <mujoco> at the top, got <{top}>")
        urdf = top == "robot"
        tree = UrdfTree(path, choice.allow_outside) if urdf else MjcfTree(path)
        return arm_of_tree(tree, choice)


def _joint_names(arm: Arm) -> list[str]:
    """Return the joints' names, numbers where they have none."""
    return [link.name or f"q_{i}" for i, link in enumerate(arm.links, start=1)]


def _require_rigid(arm: Arm, what: str) -> None:
    if arm.bends:
        raise ParameterError(f"{what} has no words for the {arm.bends} flexures of {arm.name}")
    if arm.geared:
        names = ", ".join(_joint_names(arm)[i] for i in arm.geared)
        raise ParameterError(f"{what} has no words for the gears of {names}, which give way")
    arm.require_alone(what)


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(k) + 0.0) for k in values)


def _written(top: Element) -> str:
    ElementTree.indent(top)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(top, encoding="unicode") + "\n"


def _bodies(arm: Arm) -> list[tuple[Inertial, tuple[Capsule, ...]]]:
    """Mass and shape of the base link and of each link, in the frame at its joint."""
    out = [(arm.base, arm.base_shape or ())]
    for link in arm.links:
        R, p = link.far_end
        capsules = tuple(
            Capsule(
                start=tuple((p + R @ np.array(k.start)).tolist()),
                end=tuple((p + R @ np.array(k.end)).tolist()),
                radius=k.radius,
            )
            for k in link.shape or ()
        )
        out.append((link.inertial_at_joint, capsules))
    return out


# ------------------------------------------------------------------------------- URDF


def urdf_text(arm: Arm) -> str:
    """Return an arm as URDF.

    Rotor inertias are written as Drake has them, in a <transmission> of each joint; an
    `ExportWarning` names what other readers leave out.

    Args:
        arm: without gears.
    """
    _require_rigid(arm, "URDF")
    _warn_of_losses(arm)
    robot = Element("robot", {"name": arm.name, "xmlns:drake": "http://drake.mit.edu"})
    names = ["base", *(f"link_{i}" for i in range(1, arm.n + 1))]
    for name, (inertial, shape) in zip(names, _bodies(arm), strict=True):
        _urdf_link(robot, name, inertial, shape)
    SubElement(robot, "link", name="tool")
    joints = [*_joint_names(arm), "tool_joint"]
    for i, (R, p) in enumerate(arm.placements):
        moves = i < arm.n
        kind = "revolute" if moves else "fixed"
        if moves and arm.links[i].slides:
            kind = "prismatic"
        joint = SubElement(robot, "joint", name=joints[i], type=kind)
        SubElement(joint, "parent", link=names[i])
        SubElement(joint, "child", link=names[i + 1] if moves else "tool")
        SubElement(joint, "origin", xyz=_text(p), rpy=_text(angles_of(R)))
        if not moves:
            continue
        link = arm.links[i]
        SubElement(joint, "axis", xyz="0 0 1")
        SubElement(
            joint,
            "limit",
            lower=repr(link.q_min),
            upper=repr(link.q_max),
            effort=repr(link.tau_max),
            velocity=repr(link.v_max),
            acceleration=repr(link.a_max),
        ).set("drake:acceleration", repr(link.a_max))
        SubElement(
            joint,
            "dynamics",
            damping=repr(link.damping or 0.0),
            friction=repr(link.friction or 0.0),
        )
        _transmission(robot, joints[i], link.rotor_inertia)
    return _written(robot)


def _warn_of_losses(arm: Arm) -> None:
    """Say what URDF itself has no words for."""
    names = _joint_names(arm)
    rotors = [k for k, link in zip(names, arm.links, strict=True) if link.rotor_inertia]
    lost = [f"the rotors of {', '.join(rotors)} (read by Drake and ves_gym)"] if rotors else []
    if arm.bandwidth not in (None, BANDWIDTH):
        lost.append(f"the servos' bandwidth of {arm.bandwidth:g} Hz (read by none)")
    if lost:
        warnings.warn(f"{arm.name}: URDF itself has no words for {' and '.join(lost)}",
                      ExportWarning, stacklevel=4)  # fmt: skip


def _transmission(robot: Element, joint: str, rotor: float) -> None:
    """A motor without a gear of its own: the rotor's inertia is that about the joint."""
    drive = SubElement(robot, "transmission", name=f"{joint}_drive")
    SubElement(drive, "type").text = "transmission_interface/SimpleTransmission"
    interface = SubElement(SubElement(drive, "joint", name=joint), "hardwareInterface")
    interface.text = "hardware_interface/EffortJointInterface"
    motor = SubElement(drive, "actuator", name=joint)
    SubElement(motor, "mechanicalReduction").text = "1"
    SubElement(motor, "drake:gear_ratio", value="1")
    SubElement(motor, "drake:rotor_inertia", value=repr(rotor))


def _urdf_link(
    robot: Element, name: str, inertial: Inertial, shape: tuple[Capsule, ...]
) -> None:
    link = SubElement(robot, "link", name=name)
    if inertial.mass:
        element = SubElement(link, "inertial")
        SubElement(element, "origin", xyz=_text(inertial.com), rpy="0 0 0")
        SubElement(element, "mass", value=repr(inertial.mass))
        I = np.array(inertial.inertia)
        keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2)}
        keys |= {"iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        SubElement(element, "inertia", {k: repr(float(I[i])) for k, i in keys.items()})
    for k, capsule in enumerate(shape, start=1):
        a, b = np.array(capsule.start), np.array(capsule.end)
        length = float(np.linalg.norm(b - a))
        if length > 0:
            turn = upright((b - a) / length)
            element = _shape(link, f"capsule_{k}", (a + b) / 2, turn)
            SubElement(element, "cylinder", radius=repr(capsule.radius), length=repr(length))
        for end, point in (("_start", a), ("_end", b)) if length > 0 else (("", a),):
            element = _shape(link, f"capsule_{k}{end}", point, np.eye(3))
            SubElement(element, "sphere", radius=repr(capsule.radius))


def _shape(link: Element, name: str, p: Array, R: Array) -> Element:
    element = SubElement(link, "collision", name=name)
    SubElement(element, "origin", xyz=_text(p), rpy=_text(angles_of(R)))
    return SubElement(element, "geometry")


# ------------------------------------------------------------------------------- MJCF


def mjcf_text(arm: Arm) -> str:
    """Return an arm without gears as MJCF: motors, the tool a site, speeds as <numeric>."""
    _require_rigid(arm, "Arm.to_mjcf")
    top = Element("mujoco", model=arm.name)
    SubElement(top, "compiler", angle="radian", autolimits="true")
    custom = SubElement(top, "custom")
    SubElement(custom, "numeric", name="ves_v_max", data=_text(arm.column("v_max")))
    SubElement(custom, "numeric", name="ves_a_max", data=_text(arm.column("a_max")))
    if arm.bandwidth is not None:
        SubElement(custom, "numeric", name="ves_bandwidth", data=_text([arm.bandwidth]))
    body = SubElement(SubElement(top, "worldbody"), "body", name="base")
    names, bodies, places = _joint_names(arm), _bodies(arm), arm.placements
    _mjcf_body(body, *bodies[0], moves=False)
    actuators = Element("actuator")
    for i, link in enumerate(arm.links):
        R, p = places[i]
        body = SubElement(
            body, "body", name=f"link_{i + 1}", pos=_text(p), quat=_text(from_matrix(R))
        )
        _mjcf_body(body, *bodies[i + 1], moves=True)
        SubElement(
            body,
            "joint",
            name=names[i],
            type="slide" if link.slides else "hinge",
            axis="0 0 1",
            range=_text((link.q_min, link.q_max)),
            armature=repr(link.rotor_inertia),
            damping=repr(link.damping or 0.0),
            frictionloss=repr(link.friction or 0.0),
        )
        most = _text((-link.tau_max, link.tau_max))
        SubElement(
            actuators, "motor", name=names[i], joint=names[i], ctrlrange=most, forcerange=most
        )
    R, p = places[-1]
    SubElement(body, "site", name="tool", pos=_text(p), quat=_text(from_matrix(R)))
    top.append(actuators)
    return _written(top)


def _mjcf_body(
    body: Element, inertial: Inertial, shape: tuple[Capsule, ...], moves: bool
) -> None:
    I = np.array(inertial.inertia)
    mass = inertial.mass
    if moves:  # a joint without a link of its own
        mass = max(mass, _LEAST)
        I = I + _LEAST * np.eye(3) * (np.linalg.eigvalsh(I)[0] < _LEAST)
    if mass:
        moments = I[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        SubElement(
            body,
            "inertial",
            pos=_text(inertial.com),
            mass=repr(mass),
            fullinertia=_text(moments),
        )
    for capsule in shape:
        ends = np.array([capsule.start, capsule.end])
        if np.ptp(ends, axis=0).any():
            SubElement(
                body,
                "geom",
                type="capsule",
                fromto=_text(ends.ravel()),
                size=repr(capsule.radius),
                mass="0",
            )
        else:
            options: dict[str, str] = {"type": "sphere", "size": repr(capsule.radius)}
            SubElement(body, "geom", options, pos=_text(ends[0]), mass="0")


# -------------------------------------------------------------------------- Pinocchio


def pinocchio_model(arm: Arm, base: BaseModel | None = None) -> pinocchio.Model:
    """Return the arm in Pinocchio, its rotors as armature; flexures are joints of their own.

    On a base that stands still, gravity Pinocchio's; or without gravity on the base's six
    joints, in MuJoCo's order. The constant M of a base is not a body: add it to the base block
    of the inertia matrix in Y.

    Args:
        arm: the arm.
        base: the vehicle; None: it stands still.

    Raises:
        MissingPackageError: Pinocchio is not installed.
    """
    require("Arm.to_pinocchio" if base is None else "pinocchio_model", "pinocchio")
    import pinocchio as pin

    def append(body: Inertial) -> None:
        inertia = pin.Inertia(body.mass, np.array(body.com), np.array(body.inertia))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())

    model, joint, chain = pin.Model(), 0, expand(arm)
    model.name = arm.name
    if base is not None:
        if base.carried:
            raise ParameterError("a Pinocchio model has no wheels and appendages of the base")
        model.gravity.linear[:] = 0.0
        for name in ("x", "y", "z", "phi_z", "phi_y", "phi_x"):
            kind = getattr(pin, f"JointModel{'R' if '_' in name else 'P'}{name[-1].upper()}")
            joint = model.addJoint(joint, kind(), pin.SE3.Identity(), name)
        if base.body is not None:
            append(base.body)
    append(chain.arm.base)
    foot, firsts = joint, {root.first for root in chain.arm.roots}
    *places, tool = (pin.SE3(R, p) for R, p in chain.arm.placements)
    names = dict(zip(chain.driven, _joint_names(arm), strict=True))
    names |= {place: f"f_{k}" for k, place in enumerate(chain.passive, start=1)}
    for i, (link, place) in enumerate(zip(chain.arm.links, places, strict=True)):
        limits = [np.array([k]) for k in (link.tau_max, link.v_max, link.q_min, link.q_max)]
        moves = pin.JointModelPZ() if link.slides else pin.JointModelRZ()
        parent = foot if i in firsts else joint
        joint = model.addJoint(parent, moves, place, names[i], *limits)
        append(link.inertial_at_joint)
    model.armature[model.nv - chain.arm.n :] = chain.arm.column("rotor_inertia")
    model.addFrame(pin.Frame("tool", joint, tool, pin.FrameType.OP_FRAME))
    return model
