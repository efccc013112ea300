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
from ves_gym.mechanics.arm import Arm, ArmPart
from ves_gym.mechanics.arm_reader import arm_of_tree
from ves_gym.mechanics.arm_tree import ChainChoice
from ves_gym.mechanics.attitude import from_matrix
from ves_gym.mechanics.chain import upright
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.link import BANDWIDTH, Capsule, Inertial, angles_of
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
    """Return the joints' names, numbers where they have none; followers' among them."""
    return [part.link.name or part.joint for part in arm.parts]


def _leaders(arm: Arm, part: ArmPart) -> dict[str, float]:
    """Names of the joints that one follows, and their ratios; none: it is driven."""
    links = zip(arm.links, part.ratios or (), strict=part.ratios is not None)
    return {link.name or f"q_{i}": r for i, (link, r) in enumerate(links, start=1) if r}


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
    for link in (part.link for part in arm.parts):
        capsules = tuple(k.placed(*link.far_end) for k in link.shape or ())
        out.append((link.inertial_at_joint, capsules))
    return out


# ------------------------------------------------------------------------------- URDF


def urdf_text(arm: Arm) -> str:
    """Return an arm without gears as URDF, its rotors in a <transmission> each, as Drake has
    them; an `ExportWarning` names what other readers leave out."""
    _require_rigid(arm, "URDF")
    _warn_of_losses(arm)
    robot = Element("robot", {"name": arm.name, "xmlns:drake": "http://drake.mit.edu"})
    names = ["base", *(part.body for part in arm.parts)]
    for name, (inertial, shape) in zip(names, _bodies(arm), strict=True):
        _urdf_link(robot, name, inertial, shape)
    SubElement(robot, "link", name="tool")
    joints, *places = _joint_names(arm), *arm.placements
    for i, (part, (R, p)) in enumerate(zip(arm.parts, places, strict=False)):
        kind = "prismatic" if part.link.slides else "revolute"
        ends = names[part.on + 1], part.body
        link, joint = part.link, _urdf_joint(robot, joints[i], kind, *ends, R, p)
        _mimic(arm, part, joint)
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
        if part.ratios is None or link.rotor_inertia:
            _transmission(robot, joints[i], link.rotor_inertia)
    _urdf_joint(robot, "tool_joint", "fixed", arm.ordered[-1].body, "tool", *places[-1])
    return _written(robot)


def _urdf_joint(
    robot: Element, name: str, kind: str, parent: str, child: str, R: Array, p: Array
) -> Element:
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    SubElement(joint, "origin", xyz=_text(p), rpy=_text(angles_of(R)))
    return joint


def _mimic(arm: Arm, part: ArmPart, joint: Element) -> None:
    """Add the <mimic> of a follower; URDF has it for one leader."""
    leaders = _leaders(arm, part)
    if len(leaders) > 1:
        names = ", ".join(leaders)
        raise ParameterError(
            f"URDF has no words for {joint.get('name')}, which follows {names}"
        )
    for name, ratio in leaders.items():
        SubElement(joint, "mimic", joint=name, multiplier=repr(ratio))


def _warn_of_losses(arm: Arm) -> None:
    """Say what URDF itself has no words for."""
    names = _joint_names(arm)
    parts = zip(names, arm.parts, strict=True)
    rotors = [name for name, part in parts if part.link.rotor_inertia]
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
    custom, links = SubElement(top, "custom"), [part.link for part in arm.parts]
    SubElement(custom, "numeric", name="ves_v_max", data=_text(k.v_max for k in links))
    SubElement(custom, "numeric", name="ves_a_max", data=_text(k.a_max for k in links))
    if arm.bandwidth is not None:
        SubElement(custom, "numeric", name="ves_bandwidth", data=_text([arm.bandwidth]))
    base = SubElement(SubElement(top, "worldbody"), "body", name="base")
    names, inertials, places = _joint_names(arm), _bodies(arm), arm.placements
    _mjcf_body(base, *inertials[0], moves=False)
    bodies, actuators, ties = {-1: base}, Element("actuator"), Element("equality")
    tendons = Element("tendon")
    for i, part in enumerate(arm.parts):
        link, (R, p) = part.link, places[i]
        bodies[i] = body = SubElement(
            bodies[part.on], "body", name=part.body, pos=_text(p), quat=_text(from_matrix(R))
        )
        _mjcf_body(body, *inertials[i + 1], moves=True)
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
        if part.ratios is not None:
            _tie(ties, tendons, names[i], _leaders(arm, part))
            continue
        most = _text((-link.tau_max, link.tau_max))
        SubElement(
            actuators, "motor", name=names[i], joint=names[i], ctrlrange=most, forcerange=most
        )
    R, p = places[-1]
    tool = bodies[arm.parts.index(arm.ordered[-1])]
    SubElement(tool, "site", name="tool", pos=_text(p), quat=_text(from_matrix(R)))
    top.extend([k for k in (tendons, ties, actuators) if len(k)])
    return _written(top)


def _tie(ties: Element, tendons: Element, name: str, leaders: dict[str, float]) -> None:
    """A joint as the sum of others: of one by their equality, of several by a tendon's."""
    if len(leaders) == 1:
        ((leader, ratio),) = leaders.items()
        SubElement(
            ties, "joint", joint1=name, joint2=leader, polycoef=_text((0, ratio, 0, 0, 0))
        )
        return
    tendon = SubElement(tendons, "fixed", name=f"tie_{name}")
    for other, coef in (*((k, -ratio) for k, ratio in leaders.items()), (name, 1.0)):
        SubElement(tendon, "joint", joint=other, coef=repr(coef))
    SubElement(ties, "tendon", tendon1=f"tie_{name}")


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
    """Return the arm in Pinocchio, its rotors as armature; flexures are joints of their own,
    and a joint that follows one other is a mimic joint.

    On a base that stands still (None), gravity Pinocchio's; or without gravity on the base's
    six joints, in MuJoCo's order. The constant M of a base is not a body: add it to the base
    block of the inertia matrix in Y.
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
    *places, tool = (pin.SE3(R, p) for R, p in chain.arm.placements)
    moving = range(len(arm.parts)) if arm.followers else chain.driven
    names = dict(zip(moving, _joint_names(arm), strict=True))
    names |= {place: f"f_{k}" for k, place in enumerate(chain.passive, start=1)}
    joints = {-1: joint}
    for i in chain.arm.depth_first():
        part, place = chain.arm.parts[i], places[i]
        link = part.link
        limits = [np.array([k]) for k in (link.tau_max, link.v_max, link.q_min, link.q_max)]
        moves = pin.JointModelPZ() if link.slides else pin.JointModelRZ()
        joint = joints[i] = model.addJoint(joints[part.on], moves, place, names[i], *limits)
        append(link.inertial_at_joint)
        model.armature[model.joints[joint].idx_v] = link.rotor_inertia
    joint = joints[chain.arm.parts.index(chain.arm.ordered[-1])]
    model.addFrame(pin.Frame("tool", joint, tool, pin.FrameType.OP_FRAME))
    return _with_mimic(arm, model)


def _with_mimic(arm: Arm, model: pinocchio.Model) -> pinocchio.Model:
    """The model whose followers are mimic joints, with their rotors at what they follow."""
    import pinocchio as pin

    for part, name in zip(arm.parts, _joint_names(arm), strict=True):
        leaders = [(model.getJointId(k), r) for k, r in _leaders(arm, part).items()]
        joint = model.getJointId(name)
        if len(leaders) > 1 or any(leader > joint for leader, _ in leaders):
            raise ParameterError(
                f"Pinocchio has no words for {name}, which follows several joints or one"
                " beyond it"
            )
        for leader, ratio in leaders:
            rotor = ratio**2 * part.link.rotor_inertia
            model.armature[model.joints[leader].idx_v] += rotor
            model = pin.transformJointIntoMimic(model, leader, joint, ratio, 0.0)
    return model
