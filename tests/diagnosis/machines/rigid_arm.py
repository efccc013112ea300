"""A small arm in URDF and its measured motion, forces by MuJoCo's inverse dynamics."""

import mujoco
import numpy as np

LINKS = (  # mass, centre, joint's place, axis
    (4.0, "0 0.02 0.1", "0 0 0.3", "0 0 1"),
    (3.0, "0.15 0 0.03", "0 0 0.1", "0 1 0"),
    (1.5, "0.12 0.01 0", "0.35 0 0", "0 1 0"),
)
JOINTS = ("waist", "shoulder", "elbow")


BASE = (
    '<link name="base"><inertial><mass value="20"/><origin xyz="0 0 0.1"/>'
    '<inertia ixx="0.5" iyy="0.6" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)


def urdf(mesh="", base='<link name="base"/>'):
    """The arm on a base; `mesh` is a file that need not be there."""
    text = [f'<robot name="small">{base}']
    parent = "base"
    shape = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>' if mesh else ""
    for name, (mass, centre, place, axis) in zip(JOINTS, LINKS, strict=True):
        i = 0.01 * mass
        text.append(
            f'<link name="{name}_link">{shape}<inertial><mass value="{mass}"/>'
            f'<origin xyz="{centre}"/><inertia ixx="{i}" iyy="{1.2 * i}" izz="{0.9 * i}"'
            ' ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="9"/></joint>'
        )
        parent = f"{name}_link"
    return "".join(text) + "</robot>"


def on_six_joints():
    """A base with mass on slides and hinges about z, y, x, for engines that weld it else."""
    tiny = (
        '<inertial><mass value="1e-9"/><inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0"'
        ' ixz="0" iyz="0"/></inertial>'
    )
    text, parent = ['<link name="ground"/>'], "ground"
    for name in ("x", "y", "z", "rz", "ry", "rx"):
        kind = "revolute" if name[0] == "r" else "prismatic"
        axis = " ".join(str(int(k == name[-1])) for k in "xyz")
        child = "base" if name == "rx" else f"at_{name}"
        text.append(BASE if name == "rx" else f'<link name="{child}">{tiny}</link>')
        text.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-1" upper="1" effort="1e6" velocity="1e3"/></joint>'
        )
        parent = child
    return urdf(base="".join(text))


def mjcf():
    """The same arm as a compiled MuJoCo model."""
    return mujoco.MjModel.from_xml_string(urdf())


def motion(seed, seconds=20.0, rate=100.0):
    """Stamps (T,), and positions, rates, accelerations (T, 3) of a few sines."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    w, phase = 2 * np.pi * rng.uniform(0.1, 1.0, (4, 3)), rng.uniform(0, 6, (4, 3))
    angle = t[:, None, None] * w + phase
    size = 0.35
    return (
        t,
        size * np.sin(angle).sum(axis=1),
        size * (w * np.cos(angle)).sum(axis=1),
        -size * (w**2 * np.sin(angle)).sum(axis=1),
    )


def load(q, v, a, mass=0.0, centre=(0.0, 0.0, 0.0)):
    """Forces (T, 3) of the motion, a point mass on the last link."""
    spec = mujoco.MjSpec.from_string(urdf())
    if mass:
        body = spec.body("elbow_link").add_body(pos=centre)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-4, 0, 0], mass=mass)
    model = spec.compile()
    data = mujoco.MjData(model)
    out = np.empty_like(q)
    for k in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        out[k] = data.qfrc_inverse
    return out


def friction(v, viscous, coulomb):
    """Torque (T, 3) that friction takes."""
    return np.array(viscous) * v + np.array(coulomb) * np.sign(v)
