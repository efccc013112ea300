"""Arms as URDF text: as makers publish them, with meshes and fingers, and random chains."""

import math

import numpy as np

# name, xyz and rpy of the joint, kind, +-range [rad], effort [N m], speed [rad/s], damping
# [N m s/rad], friction [N m]; mass [kg], its centre [m], radius and length of a cylinder [m]
_JOINTS = (
    ("shoulder_pan", (0, 0, 0.16), (0, 0, 0), "continuous", 0, 150, 2.0, 2.0, 3.0,
     4.2, (0, -0.02, 0.03), 0.07, 0.16),
    ("shoulder_lift", (0, 0.13, 0), (0, math.pi / 2, 0), "revolute", 2.4, 150, 2.0, 2.0, 3.0,
     7.9, (0, 0, 0.22), 0.06, 0.44),
    ("elbow", (0, -0.12, 0.43), (0, 0, 0), "revolute", 2.6, 100, 2.5, 1.0, 2.0,
     3.1, (0, 0, 0.2), 0.05, 0.39),
    ("wrist_1", (0, 0, 0.39), (0, math.pi / 2, 0), "revolute", 3.1, 28, 3.0, 0.3, 0.6,
     1.4, (0, 0.09, 0), 0.04, 0.1),
    ("wrist_2", (0, 0.1, 0), (0, 0, 0), "revolute", 3.1, 28, 3.0, 0.3, 0.6,
     1.4, (0, 0, 0.09), 0.04, 0.1),
    ("wrist_3", (0, 0, 0.1), (0, 0, 0), "revolute", 3.1, 28, 3.0, 0.2, 0.4,
     0.4, (0, 0.05, 0), 0.04, 0.05),
)  # fmt: skip


def six_joint_urdf(path, armature=0.0):
    """Write the arm.

    Args:
        path: of the file.
        armature: inertia of the motors' rotors, seen at the joints [kg m^2].
    """
    parts = [_body("base_link", 4.0, (0, 0, 0.05), 0.08, 0.1)]
    before = "base_link"
    for name, xyz, rpy, kind, reach, effort, speed, damping, dry, *body in _JOINTS:
        child = f"{name}_link"
        ends = f'lower="{-reach}" upper="{reach}" ' if kind == "revolute" else ""
        rubs = f'<dynamics damping="{damping}" friction="{dry}" armature="{armature}"/>'
        parts += [
            f'<joint name="{name}_joint" type="{kind}"><parent link="{before}"/>'
            f'<child link="{child}"/>{_origin(xyz, rpy)}'
            f'<axis xyz="0 {int(name != "shoulder_pan")} {int(name == "shoulder_pan")}"/>'
            f'<limit {ends}effort="{effort}" velocity="{speed}"/>{rubs}'
            "</joint>",
            _body(child, *body),
        ]
        before = child
    for side in (-1, 1):
        finger = f"finger{side:+d}"
        parts += [
            f'<joint name="{finger}_joint" type="fixed"><parent link="{before}"/>'
            f'<child link="{finger}"/>{_origin((0.03 * side, 0.08, 0), (0, 0, 0))}</joint>',
            _body(finger, 0.08, (0, 0.02, 0), 0.01, 0.05),
        ]
    parts += [
        f'<joint name="tool_joint" type="fixed"><parent link="{before}"/>'
        f'<child link="tool0"/>{_origin((0, 0.12, 0), (-math.pi / 2, 0, 0))}</joint>',
        '<link name="tool0"/>',
    ]
    path.write_text(f'<?xml version="1.0"?>\n<robot name="maker6">{"".join(parts)}</robot>')
    return path


def _origin(xyz, rpy):
    return f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'


def _body(name, mass, com, radius, length):
    """A link with the inertia of a cylinder along z, and a mesh that is not there."""
    across, along = mass * (3 * radius**2 + length**2) / 12, mass * radius**2 / 2
    return (
        f'<link name="{name}"><visual><geometry><mesh filename="package://maker/{name}.dae"/>'
        f"</geometry></visual><inertial>{_origin(com, (0, 0, 0))}"
        f'<mass value="{mass}"/><inertia ixx="{across}" iyy="{across}" izz="{along}" ixy="0"'
        ' ixz="0" iyz="0"/></inertial></link>'
    )


def vector(values):
    return " ".join(repr(float(k)) for k in values)


def body(rng, name, shape=""):
    """A link with the inertia of a random box."""
    size, mass = rng.uniform(0.05, 0.5, 3), rng.uniform(0.5, 8)
    mass, (xx, yy, zz) = float(mass), (mass / 12 * (size @ size - size**2)).tolist()
    return (
        f'<link name="{name}"><inertial><origin xyz="{vector(rng.normal(size=3) / 5)}"'
        f' rpy="{vector(rng.normal(size=3))}"/><mass value="{mass!r}"/><inertia ixx="{xx!r}"'
        f' iyy="{yy!r}" izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>'
    )


def joint(
    name, parent, child, kind="revolute", extra="", xyz=(0, 0, 0.3), rpy=(0, 0, 0), axis=None
):
    turn = "" if axis is None else f'<axis xyz="{vector(axis)}"/>'
    limit = '<limit lower="-2.5" upper="2.0" effort="50" velocity="1.5"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{vector(xyz)}" rpy="{vector(rpy)}"/>{turn}'
        f"{limit if kind in ('revolute', 'prismatic') else ''}{extra}</joint>"
    )


def chain(n, seed=0, upright=False):
    """A URDF of n joints: any axes and places, some parallel, some all but parallel."""
    rng = np.random.default_rng(seed)
    parts = [body(rng, "base")]
    before = "base"
    for i in range(n):
        plate, name = f"plate{i}", f"link{i}"
        rpy, axis = rng.normal(size=3), rng.normal(size=3)
        xyz = rng.normal(size=3) / 3
        if i % 3 == 1:  # all but parallel: 1.5708 there, 1.57079632679 back
            rpy, axis = (1.5708, 0, 0), (0, 0, -1)
        elif i % 3 == 2:
            rpy, axis, xyz = (-math.pi / 2, 0, 0), (0, 0, 1), (0, 0, 0.2)
        parts += [
            body(rng, plate),
            joint(
                f"fix{i}",
                before,
                plate,
                "fixed",
                xyz=rng.normal(size=3) / 5,
                rpy=rng.normal(size=3),
            ),
            body(rng, name),
            joint(
                f"j{i}",
                plate,
                name,
                "continuous" if i == 3 else "revolute",
                xyz=xyz,
                rpy=rpy,
                axis=axis,
            ),
        ]
        before = name
    parts += [
        '<link name="tcp"/>',
        joint("tool", before, "tcp", "fixed", rpy=rng.normal(size=3)),
    ]
    return f'<robot name="chain{n}">{"".join(parts)}</robot>'


_INERTIA = '<inertia ixx="0.2" iyy="0.3" izz="0.25" ixy="0.01" ixz="-0.02" iyz="0.03"/>'
# turn, slide along an oblique axis, turn, slide
_SLIDER = (
    ("revolute", "0 0 1", "0 0 0.3", "0.1 0 0", -2.0, 2.0),
    ("prismatic", "0.6 0 0.8", "0.2 0.1 0.1", "0 0.2 0", -0.4, 0.5),
    ("revolute", "0 1 0", "0.4 0 0", "0 0 0.4", -2.0, 2.0),
    ("prismatic", "1 0 0", "0.3 -0.1 0", "0.1 0.1 0.1", 0.0, 0.6),
)


def slider_urdf() -> str:
    """Two joints that turn and two that slide; the tool is l4."""
    parts = [f'<link name="l0"><inertial><mass value="5"/>{_INERTIA}</inertial></link>']
    for i, (kind, axis, xyz, rpy, low, high) in enumerate(_SLIDER, 1):
        parts.append(
            f'<link name="l{i}"><inertial><origin xyz="0.1 0.02 -0.03" rpy="0.3 0 0.1"/>'
            f'<mass value="{5 - i}"/>{_INERTIA}</inertial></link>'
            f'<joint name="j{i}" type="{kind}"><parent link="l{i - 1}"/><child link="l{i}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit lower="{low}" upper="{high}" effort="80" velocity="1"/></joint>'
        )
    return f'<robot name="slider">{"".join(parts)}</robot>'
