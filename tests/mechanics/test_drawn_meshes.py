"""Meshes that an arm is drawn with: kept from its file, placed as MuJoCo places them."""

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.three_links import CHAIN, robot
from ves_gym._util.params import content_hash, from_plain, to_plain
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import frames
from ves_gym.mechanics.meshes import read_mesh
from ves_gym.rendering.drawing import Drawing
from ves_gym.system.system import System

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
FACES = np.array([[1, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]])
OBJ = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in CORNERS)
OBJ += "".join(f"f {a} {b} {c}\n" for a, b, c in FACES)
SEEN = (
    '<visual><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.2 0.5"/><geometry><mesh'
    ' filename="piece.obj" scale="0.1 0.1 -0.1"/></geometry></visual>'
)


@pytest.fixture
def path(tmp_path):
    """The second link has a mesh, turned, moved and mirrored; so has one that is not there."""
    text = robot(CHAIN)
    for name, seen in (("l2", SEEN), ("l3", SEEN.replace("piece", "lost"))):
        head, link, rest = text.partition(f'<link name="{name}">')
        text = head + link + seen + rest
    (tmp_path / "piece.obj").write_text(OBJ)
    (tmp_path / "arm.urdf").write_text(text)
    return tmp_path / "arm.urdf"


def in_space(arm, q, i):
    """Corners of the mesh of link i from its file, on a base that stands still."""
    (mesh,) = arm.links[i].meshes
    points = mesh.points_at(read_mesh(Path(mesh.file)).points)
    at = frames(arm, q)
    return points @ at.rotation[i].T + at.position[i]


def sorted_rows(x):
    return x[np.lexsort(x.round(9).T)]


def test_a_urdf_s_mesh_is_where_pinocchio_has_it(path):
    pin = pytest.importorskip("pinocchio")
    arm, q = Arm.from_file(path, tip="tool"), np.array([0.4, -0.7, 0.9])
    assert [bool(link.meshes) for link in arm.links] == [False, True, False]
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    link = data.oMf[model.getFrameId("l2")]
    turn = pin.rpy.rpyToMatrix(0.3, -0.2, 0.5)
    there = CORNERS * [0.1, 0.1, -0.1] @ turn.T + [0.1, 0.2, 0.3]
    there = there @ link.rotation.T + link.translation
    np.testing.assert_allclose(in_space(arm, q, 1), there, rtol=0, atol=1e-12)


def test_an_mjcf_s_mesh_is_where_mujoco_has_it(path):
    """MuJoCo moves a mesh to its centre and main axes."""
    text = """<mujoco><asset><mesh name="m" file="piece.obj" scale="0.1 0.2 0.1"/></asset>
      <worldbody><body name="a"><joint name="j" axis="0 1 0" range="-1 1"/>
      <geom type="mesh" mesh="m" pos="0.1 0 0.2" euler="10 20 30" mass="1" contype="0"
       conaffinity="0"/></body></worldbody></mujoco>"""
    file = path.with_name("arm.xml")
    file.write_text(text)
    arm, q = Arm.from_file(file, tip="a"), np.array([0.5])
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    there = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    here = in_space(arm, q, 0)
    np.testing.assert_allclose(sorted_rows(here), sorted_rows(there), rtol=0, atol=1e-7)


def test_meshes_are_for_views_alone(path):
    arm = Arm.from_file(path, tip="tool")
    bare = dataclasses.replace(
        arm, links=tuple(dataclasses.replace(k, meshes=None) for k in arm.links)
    )
    assert arm == bare and content_hash(arm) == content_hash(bare)
    again = from_plain(Arm, to_plain(arm))
    assert again.links[1].meshes == arm.links[1].meshes


def test_a_drawing_has_the_mesh_or_capsules_where_it_is_gone(path):
    system = System(arm=Arm.from_file(path, tip="tool"))
    model = Drawing(system, 64, 48).model
    assert (
        model.nmesh == 1
        and model.body("link_2").id
        in model.geom_bodyid[model.geom_type == mujoco.mjtGeom.mjGEOM_MESH]
    )
    path.with_name("piece.obj").unlink()
    model = Drawing(system, 64, 48).model
    assert model.nmesh == 0 and model.body("link_2").id in model.geom_bodyid
