"""Arms from URDF and MJCF and out again: Pinocchio, MuJoCo and both engines judge them."""

import contextlib
import dataclasses
import math
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from tests.urdf_arms import body, chain, joint, slider_urdf, vector
from ves_gym._util.params import ParameterError
from ves_gym.effects.joint_friction import JointCoulomb, JointViscous
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_files import ExportWarning
from ves_gym.mechanics.arm_library import PUMA_560, arm_names, get_arm
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.kinematics import frames, tool_frame, tool_twists
from ves_gym.mechanics.link import BANDWIDTH, Capsule, Gear
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.planners.obstacles import Sphere, Surroundings, collisions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

GRAVITY = (1.0, -2.0, -9.81)


@pytest.fixture
def write(tmp_path):
    def written(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


# -------------------------------------------------------------------------- references


def account(arm, q, v):
    """Mass matrix, bias under gravity, pose (3, 4) and Jacobian (6, n) of the tool."""
    place, turn = tool_frame(arm, q)
    bias = inverse_dynamics(arm, q, v, 0 * q, GRAVITY)[0]
    return inertia(arm, q)[6:, 6:], bias, np.column_stack([turn, place]), tool_twists(arm, q)


def worst(arm, reference):
    """Largest relative difference of the account from that of a reference (q, v) -> account."""
    rng, out = np.random.default_rng(1), 0.0
    for _ in range(5):
        q, v = rng.uniform(-3, 3, arm.n), rng.normal(size=arm.n)
        for a, b in zip(account(arm, q, v), reference(q, v), strict=True):
            out = max(out, np.abs(a - b).max() / np.abs(b).max())
    return out


def by_pinocchio(path, arm, tip):
    """What Pinocchio makes of a URDF, with the arm's rotors."""
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear[:] = GRAVITY
    model.armature[:] = arm.column("rotor_inertia")
    data, frame = model.createData(), model.getFrameId(tip)

    def reference(q, v):
        turns = [
            [np.cos(x), np.sin(x)] if j.nq == 2 else [x]
            for x, j in zip(q, list(model.joints)[1:], strict=True)
        ]
        q = np.concatenate(turns)
        M = np.triu(pin.crba(model, data, q))
        bias = pin.nonLinearEffects(model, data, q, v)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        tool = data.oMf[frame]
        pose = np.column_stack([tool.rotation, tool.translation])
        return M + np.triu(M, 1).T, bias, pose, J

    return reference


def by_mujoco(path, arm, tool="tool"):
    """What MuJoCo makes of an MJCF file."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.gravity[:] = GRAVITY
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    joints = [model.joint(k.name or f"q_{i + 1}") for i, k in enumerate(arm.links)]
    dofs = [int(j.dofadr[0]) for j in joints]

    def reference(q, v):
        data.qpos[:], data.qvel[:] = model.qpos0, 0.0
        data.qpos[[int(j.qposadr[0]) for j in joints]] = q
        data.qvel[dofs] = v
        mujoco.mj_forward(model, data)
        full, J = np.zeros((model.nv, model.nv)), np.zeros((6, model.nv))
        mujoco.mj_fullM(model, data, full)
        site = model.site(tool).id
        mujoco.mj_jacSite(model, data, J[:3], J[3:], site)
        pose = np.column_stack([data.site_xmat[site].reshape(3, 3), data.site_xpos[site]])
        return full[np.ix_(dofs, dofs)], data.qfrc_bias[dofs], pose, J[:, dofs]

    return reference


# ------------------------------------------------------------------- there and back again


def hanging(tilt):
    """A URDF whose first axis points all but down, a half turn written in full."""
    rng = np.random.default_rng(0)
    hang = joint("first", "base", "upper", rpy=(math.pi - tilt, tilt, 0.1), axis=(0, 0, 1))
    then = joint("second", "upper", "fore", rpy=(0, math.pi - tilt, 0), axis=(0, 0, 1))
    bodies = "".join(body(rng, k) for k in ("base", "upper", "fore"))
    return f'<robot name="r">{bodies}{hang}{then}</robot>'


# URDF texts and their tools; a chain has a joint without an end, and axes all but parallel
TEXTS = {f"{n} joints": (chain(n, seed=n), "tcp") for n in (1, 4, 7)}
TEXTS |= {f"down but for {k}": (hanging(k), "fore") for k in (0.0, 1e-9, 3.7e-6)}
TEXTS["sliding"] = slider_urdf(), "l4"


@pytest.mark.parametrize("name", TEXTS)
def test_an_arm_is_what_pinocchio_reads(write, name):
    """Tolerance: rounding."""
    text, tip = TEXTS[name]
    path = write(text)
    arm = Arm.from_file(path)
    assert worst(arm, by_pinocchio(path, arm, tip)) < 1e-12
    assert arm.sliding == ((1, 3) if name == "sliding" else ())
    if tip == "tcp":
        assert [k.name for k in arm.links] == [f"j{i}" for i in range(arm.n)]


def furnished(arm):
    """The arm with what files keep beside masses and lengths."""
    rod = Capsule(start=(0.1, 0.0, -0.2), end=(0.0, 0.05, 0.1), radius=0.04)
    ball = Capsule(start=(0.0, 0.1, 0.0), end=(0.0, 0.1, 0.0), radius=0.07)
    links = tuple(
        dataclasses.replace(
            link,
            rotor_inertia=0.1 * i,
            damping=0.2,
            friction=0.01 + 0.001 * i,
            shape=(rod, ball) if i % 2 else (),
        )
        for i, link in enumerate(arm.links)
    )
    return dataclasses.replace(arm, links=links, base_shape=(rod,), bandwidth=3.0)


@pytest.mark.parametrize("form", ["urdf", "mjcf"])
@pytest.mark.parametrize("name", ["random", "slider", *arm_names()])
def test_an_arm_comes_back_from_the_file_it_is_written_to(write, tmp_path, form, name):
    """Tolerance: rounding; what is written is also what Pinocchio or MuJoCo reads."""
    if name == "random":
        arm = furnished(Arm.from_file(write(chain(7, seed=7), "first.urdf")))
    else:
        text = write(slider_urdf(), "slider.urdf")
        arm = Arm.from_file(text) if name == "slider" else get_arm(name)
    path = tmp_path / f"again.{form}"
    told = arm.column("rotor_inertia").any() or arm.bandwidth not in (None, BANDWIDTH)
    lost = form == "urdf" and told
    with pytest.warns(ExportWarning) if lost else contextlib.nullcontext():
        getattr(arm, f"to_{form}")(path)
    again = get_arm(path)
    assert again.sliding == arm.sliding
    assert worst(again, lambda q, v: account(arm, q, v)) < 1e-12
    reference = by_pinocchio(path, arm, "tool") if form == "urdf" else by_mujoco(path, arm)
    assert worst(arm, reference) < 1e-12
    for limit in ("q_min", "q_max", "v_max", "a_max", "tau_max", "rotor_inertia"):
        np.testing.assert_allclose(arm.column(limit), again.column(limit), rtol=1e-15)
    for a, b in zip(arm.links, again.links, strict=True):
        assert (a.damping or 0.0, a.friction or 0.0) == (b.damping or 0.0, b.friction or 0.0)
    if name == "random":
        require_same_shapes(arm, again)
        assert form == "urdf" or again.bandwidth == 3.0


def require_same_shapes(one, other):
    shapes = [(arm.base_shape, *(k.shape for k in arm.links)) for arm in (one, other)]
    for a, b in zip(*shapes, strict=True):
        assert len(a or ()) == len(b or ())
        for x, y in zip(a or (), b or (), strict=True):
            ends = [np.array([k.start, k.end]) for k in (x, y)]
            assert min(np.abs(ends[0] - k).max() for k in (ends[1], ends[1][::-1])) < 1e-12
            assert x.radius == pytest.approx(y.radius, rel=1e-14)


def test_what_urdf_has_no_words_for_is_named(tmp_path):
    arm = dataclasses.replace(PUMA_560, bandwidth=3.0)
    with pytest.warns(ExportWarning, match=r"rotors of q_1, q_2, q_3 .*bandwidth of 3 Hz"):
        arm.to_urdf(tmp_path / "arm.urdf")
    written = ElementTree.parse(tmp_path / "arm.urdf").getroot()
    drive = written.find("transmission/[@name='q_2_drive']/actuator")
    space = {"drake": "http://drake.mit.edu"}
    assert drive.find("drake:rotor_inertia", space).get("value") == "4.71"
    text = (
        (tmp_path / "arm.urdf")
        .read_text()
        .replace('<drake:gear_ratio value="1"', '<drake:gear_ratio value="-10"')
    )  # a rotor before its gear
    (tmp_path / "geared.urdf").write_text(text)
    again = Arm.from_file(tmp_path / "geared.urdf").column("rotor_inertia")
    np.testing.assert_allclose(again, 100 * PUMA_560.column("rotor_inertia"), rtol=1e-15)


def test_gears_have_no_words(tmp_path):
    gear = Gear(compliance=1e-4)
    links = (PUMA_560.links[0], dataclasses.replace(PUMA_560.links[1], gear=gear))
    arm = dataclasses.replace(PUMA_560, links=links)
    for write_to in (arm.to_urdf, arm.to_mjcf):
        with pytest.raises(ParameterError, match="no words for the gears of q_2"):
            write_to(tmp_path / "arm.xml")
    assert list(tmp_path.iterdir()) == []


def test_an_arm_is_asked_by_name_or_file(write):
    assert get_arm("puma560") is PUMA_560
    with pytest.raises(ParameterError, match=r"arm must be one of puma560.* got 'puma'; did"):
        get_arm("puma")
    with pytest.raises(ParameterError, match="cannot be read"):
        get_arm("nowhere.urdf")
    path = write(chain(2), "arm.xml")  # a URDF by another name
    assert get_arm(path).n == 2


def test_limits_are_kept_and_what_is_derived_is_said(write):
    text = chain(2).replace(
        'effort="50" velocity="1.5"/>',
        'effort="50" velocity="1.5"/><dynamics damping="0.3" friction="0.2"/>',
        1,
    )
    arm = Arm.from_file(write(text))
    first = arm.links[0]
    assert (first.q_min, first.q_max, first.v_max, first.tau_max) == (-2.5, 2.0, 1.5, 50.0)
    assert (first.damping, first.friction) == (0.3, 0.2)
    assert arm.links[1].damping is None
    assert "a_max not given, taken: tau_max over the largest inertia" in arm.source
    q = np.random.default_rng(5).uniform(-2.5, 2.0, size=(50, 2))
    J = inertia(arm, q)[:, 6, 6].max()
    assert first.a_max == pytest.approx(50 / J, rel=0.3)


# ------------------------------------------------------------------------- shapes

BOX = '<collision><geometry><box size="0.1 0.2 0.6"/></geometry></collision>'
MESH = '<collision><geometry><mesh filename="package://x/f.stl"/></geometry></collision>'


def single(rng, shapes, **options):
    """A URDF of one joint, with shapes on what it moves."""
    moved = joint("j", "base", "l", axis=(0, 0, 1), **options)
    return f'<robot name="r">{body(rng, "base")}{body(rng, "l", shapes)}{moved}</robot>'


def test_a_capsule_holds_the_shape_it_stands_for(write):
    shapes = (
        BOX
        + '<collision><origin xyz="0.1 0 0" rpy="0 1.2 0"/><geometry><cylinder radius="0.05"'
        ' length="0.4"/></geometry></collision>'
        '<collision><geometry><sphere radius="0.07"/></geometry></collision>'
    )
    rng = np.random.default_rng(0)
    text = single(rng, shapes)
    arm = Arm.from_file(write(text))
    box, rod, ball = arm.links[0].shape
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * [0.1, 0.2, 0.6]
    for point in corners:
        assert distance(box, point) <= box.radius + 1e-12
    assert math.hypot(0.05, 0.1) <= box.radius < 0.15 and math.dist(box.start, box.end) < 0.61
    assert rod.radius == 0.05 and math.dist(rod.start, rod.end) == pytest.approx(0.4)
    assert ball.start == ball.end and ball.radius == 0.07
    assert Arm.from_file(write(text), collision=False).links[0].shape is None


def distance(capsule, point):
    a, b = np.array(capsule.start), np.array(capsule.end)
    t = np.clip((point - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return np.linalg.norm(point - a - t * (b - a))


def mesh_file(kind, corners):
    """A mesh as bytes."""
    if kind == "stl":
        rows = np.zeros(3, dtype=[("n", "<f4", 3), ("p", "<f4", (3, 3)), ("c", "<u2")])
        rows["p"] = corners.reshape(3, 3, 3)
        return b"\0" * 80 + (3).to_bytes(4, "little") + rows.tobytes()
    if kind == "ascii.stl":
        rows = "".join(f"vertex {vector(p)}\n" for p in corners)
        return f"solid a\n{rows}endsolid a\n".encode()
    if kind.endswith("ply"):
        order = {"ascii.ply": "ascii", "big.ply": "binary_big_endian"}
        kinds = "property float x\nproperty double y\nproperty uchar red\nproperty float z\n"
        head = (
            f"ply\nformat {order.get(kind, 'binary_little_endian')} 1.0\ncomment by a program\n"
        )
        head += f"element vertex {len(corners)}\n{kinds}element face 1\n"
        head += "property list uchar int vertex_indices\nend_header\n"
        sign = ">" if kind == "big.ply" else "<"
        types = zip("xyrz", (f"{sign}f4", f"{sign}f8", "u1", f"{sign}f4"), strict=True)
        rows = np.zeros(len(corners), dtype=list(types))
        rows["x"], rows["y"], rows["z"] = corners.T
        text = "".join(f"{float(x)!r} {float(y)!r} 7 {float(z)!r}\n" for x, y, z in corners)
        if kind == "ascii.ply":
            return f"{head}{text}3 0 1 2\n".encode()
        face = b"\3" + np.arange(3, dtype=f"{sign}i4").tobytes()
        return head.encode() + rows.tobytes() + face
    if kind == "obj":
        return (
            "".join(f"v {vector(p)}\n" for p in corners) + "f 1 2 3\nf 4 5 6 7 8 9\n"
        ).encode()
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        '<unit meter="0.01"/></asset><library_geometries><geometry id="g"><mesh><source id="s">'
        f'<float_array id="a" count="{corners.size}">'
        f"{' '.join(map(vector, 100 * corners - (0, 0, 7)))}</float_array><technique_common>"
        f'<accessor source="#a" count="{len(corners)}" stride="3"><param name="X"'
        ' type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>'
        '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#s"/>'
        '</vertices><triangles count="3"><input semantic="VERTEX" source="#v" offset="0"/>'
        "<p>0 1 2 3 4 5 6 7 8</p></triangles></mesh></geometry></library_geometries>"
        '<library_visual_scenes><visual_scene id="w"><node id="n"><translate>0 0 7</translate>'
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes><scene>'
        '<instance_visual_scene url="#w"/></scene></COLLADA>'
    ).encode()


KINDS = ["stl", "ascii.stl", "obj", "dae", "ply", "ascii.ply", "big.ply"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_mesh_becomes_a_capsule_that_holds_it(write, tmp_path, kind):
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(9, 3)).astype(np.float32) * [0.05, 0.1, 0.4]
    (tmp_path / f"mesh.{kind}").write_bytes(mesh_file(kind, corners))
    shape = MESH.replace("package://x/f.stl", f"package://pack/mesh.{kind}")
    shape = shape.replace("<mesh", '<mesh scale="2 2 2"')
    (capsule,) = Arm.from_file(write(single(rng, shape, xyz=(0, 0, 0)))).links[0].shape
    assert max(distance(capsule, point) for point in 2 * corners) <= capsule.radius + 1e-6
    assert capsule.radius < 0.6


@pytest.mark.parametrize(
    "name", ["../../m.stl", "{root}/m.stl", "file://{root}/m.stl", "package://robot/../m.stl"]
)
def test_a_mesh_outside_the_files_folder_is_asked_for(tmp_path, name):
    """Claim: a URDF reads no mesh outside its folder and its package unless it is told to."""
    rng, folder = np.random.default_rng(0), tmp_path / "robot" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "m.stl").write_bytes(mesh_file("stl", rng.normal(size=(9, 3))))
    shape = MESH.replace("package://x/f.stl", name.format(root=tmp_path))
    file = folder / "arm.urdf"
    file.write_text(single(rng, shape, xyz=(0, 0, 0)))
    with pytest.raises(ParameterError, match=r"lies outside .*allow_outside=True"):
        Arm.from_file(file)
    assert Arm.from_file(file, collision=False).n == 1
    assert len(Arm.from_file(file, allow_outside=True).links[0].shape) == 1
    if name.startswith(".."):  # a package's files are its own; the folder beside is near
        (tmp_path / "package.xml").write_text("<package/>")
        assert len(Arm.from_file(file).links[0].shape) == 1
        (tmp_path / "package.xml").unlink()
        (tmp_path / "m.stl").rename(tmp_path / "robot" / "m.stl")
        file.write_text(file.read_text().replace("../../", "../"))
        assert len(Arm.from_file(file).links[0].shape) == 1


# ------------------------------------------------------------------ URDF that is refused


def two(first="", second="", kind="revolute", extra="", **options):
    rng = np.random.default_rng(0)
    parts = (
        body(rng, "base"),
        first or body(rng, "upper"),
        joint("shoulder", "base", "upper", axis=(0, 0, 1)),
        second or body(rng, "fore"),
        joint("elbow", "upper", "fore", kind, extra, axis=(0, 1, 0), **options),
    )
    return f'<robot name="two">{"".join(parts)}</robot>'


def inertial(mass=2.0, moments=(0.1, 0.1, 0.1)):
    xx, yy, zz = moments
    return (
        f'<link name="fore"><inertial><mass value="{mass}"/><inertia ixx="{xx}" iyy="{yy}"'
        f' izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def fore(*args):
    return two(second=inertial(*args))


RANGE = 'lower="-2.5" upper="2.0"'
TWO, HEAVY = two(), inertial(4000, (1, 1, 1))
MESHED = inertial().replace("</link>", f"{MESH}</link>")
ENDLESS = "<limits".join(two(kind="prismatic").rsplit("<limit", 1))
BAD_URDF = {  # what is said of each
    "link 'fore' has a shape, but no <inert": two(second=f'<link name="fore">{BOX}</link>'),
    "nothing that joint 'elbow' moves has an inertia": two(second='<link name="fore"/>'),
    "joint 'elbow' mimics 'hip', which is not there: hold it": two(
        extra='<mimic joint="hip"/>'
    ),
    "joint 'elbow' is prismatic and has no <limit": ENDLESS,
    "joint 'elbow' to link 'fore' is planar": two(kind="planar"),
    "joint 'elbow' to link 'fore' is floating": two(kind="floating"),
    "joint 'elbow': no such type of joint: 'ball'": two(kind="ball"),
    "link fore: no rigid body of .* kg has principal moments 0.1, 0.1, 0.3": fore(
        2, (0.1, 0.1, 0.3)
    ),
    "link 'fore': its mass: value must be a number >= 0, got '-1'": fore(-1),
    "link fore: no rigid body of 0 kg has": fore(0),
    "link 'fore': its mass: .* number >= 0, got 'x'": fore("x"),
    "what joint 'shoulder' moves is 432 m long .* look like mm": two(xyz=(0, 0, 432)),
    "joint 'shoulder' goes to -143 rad, 22.8 turns: .* look like degrees": TWO.replace(
        RANGE, 'lower="-143" upper="115"', 1
    ),
    "link 'upper' has 4000 kg .* look like g ": two(HEAVY.replace("fore", "upper"), HEAVY),
    r"link 'fore' of 2 kg has an inertia of 1e\+05 .*kg mm\^2": fore(2, (1e5, 1e5, 1e5)),
    "link 'fore': its mesh 'package://x/f.stl' is not there": two(second=MESHED),
    "joint 'shoulder': its lower limit must": TWO.replace('lower="-2.5"', 'lower="3"'),
    "joint 'shoulder' has a range of 0 to 0": TWO.replace(RANGE, 'lower="0" upper="0"', 1),
    "joint 'elbow': its axis must not be zero": TWO.replace('xyz="0.0 1.0 0.0"', 'xyz="0 0 0"'),
    "is a xacro, not yet a URDF": '<robot xmlns:xacro="http://xacro"><xacro:a/></robot>',
    "is a xacro, not yet a URDF: run": TWO.replace('lower="-2.5"', 'lower="${-pi}"'),
    "expected <robot> or <mujoco> at the top, got <sdf>": "<sdf/>",
    "cannot be read": "<robot",
    "must have one root link": TWO.replace("</robot>", '<link name="x"/></robot>'),
    "joint 'elbow': its parent link 'x' is": TWO.replace(
        'parent link="upper', 'parent link="x'
    ),
}


@pytest.mark.parametrize("message", BAD_URDF)
def test_a_bad_file_is_named_with_its_link(write, message):
    with pytest.raises(ParameterError, match=rf"arm\.urdf: {message}"):
        Arm.from_file(write(BAD_URDF[message]))


def test_limits_in_degrees_may_be_meant_and_an_absent_end_is_said(write):
    """Two turns of a wrist and 1e16 for no limit are no degrees; URDF's absent end is 0."""
    for text, check in (("12.566", True), ("1e16", True), ("143", False)):
        path = write(TWO.replace(RANGE, f'lower="-{text}" upper="{text}"', 1))
        assert Arm.from_file(path, check=check).links[0].q_max == float(text)
    arm = Arm.from_file(write(TWO.replace(RANGE, 'lower="-2.5"', 1)))
    assert (arm.links[0].q_min, arm.links[0].q_max) == (-2.5, 0.0)
    assert "no upper limit of shoulder, 0 taken, as URDF says" in arm.source


def test_several_ends_ask_for_the_tip_and_what_is_beside_the_chain_stands_still(write):
    rng = np.random.default_rng(0)
    fingers = "".join(
        body(rng, f"finger{k}")
        + joint(f"grip{k}", "fore", f"finger{k}", "prismatic", extra, axis=(0, 1, 0))
        for k, extra in ((1, ""), (2, '<mimic joint="grip1" multiplier="-1"/>'))
    )
    path = write(two().replace("</robot>", fingers + "</robot>"))
    with pytest.raises(ParameterError, match=r"has 2 ends: finger1, finger2; name the link"):
        Arm.from_file(path)
    open_, shut = (
        Arm.from_file(path, tip="fore", locked=locked) for locked in ({"grip1": 0.02}, None)
    )
    assert shut.n == open_.n == 2 and shut.mass == open_.mass
    assert "stand still: grip1 at 0.02, grip2 at -0.02" in open_.source
    assert "stand still: grip1 at 0, grip2 at 0" in shut.source
    assert open_.links[1].inertial.inertia != shut.links[1].inertial.inertia
    with pytest.raises(ParameterError, match="tip: no link 'hand'; there are base, upper"):
        Arm.from_file(path, tip="hand")
    with pytest.raises(ParameterError, match="locked: no joint 'wrist'"):
        Arm.from_file(path, tip="fore", locked={"wrist": 0.0})


def test_a_locked_joint_is_merged_at_its_angle(write):
    path = write(chain(4, seed=2))
    whole = Arm.from_file(path)
    part = Arm.from_file(path, locked={"j1": 0.7})
    assert [k.name for k in part.links] == ["j0", "j2", "j3"]
    H = inertia(whole, [0.1, 0.7, -0.4, 0.9])
    keep = [*range(6), 6, 8, 9]
    np.testing.assert_allclose(
        inertia(part, [0.1, -0.4, 0.9]), H[np.ix_(keep, keep)], atol=1e-12
    )


def test_friction_that_no_step_resolves_is_left_out_and_said(write):
    light = inertial(0.01, (1e-6, 1e-6, 1e-6))
    rub = '<dynamics damping="10" friction="1"/>'
    text = two(second=light, extra=rub, xyz=(0, 0, 432))  # looks like mm
    arm = Arm.from_file(write(text), check=False)
    assert arm.links[0].d == pytest.approx(432)
    assert arm.links[1].damping is None and arm.links[1].friction is None
    assert "damping and friction left out of elbow" in arm.source
    rotor = rub.replace("/>", ' armature="2"/>')
    kept = Arm.from_file(write(two(second=light, extra=rotor)))
    assert (kept.links[1].damping, kept.links[1].friction) == (10.0, 1.0)


def test_a_rotor_may_be_given_for_links_without_an_inertia_of_their_own(tmp_path):
    """As identified models have them: the last link has mass and no inertia."""
    last = (
        '<link name="tip"><inertial><origin xyz="0 0 0.04"/><mass value="0.2"/><inertia ixx="0"'
        ' iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    rng = np.random.default_rng(0)
    parts = [
        body(rng, "base"), body(rng, "arm"), last, joint("turn", "base", "arm", axis=(0, 0, 1)),
        joint("wrist", "arm", "tip", axis=(0, 0, 1), xyz=(0.3, 0, 0)),
    ]  # fmt: skip
    path = tmp_path / "identified.urdf"
    path.write_text(f'<robot name="identified">{"".join(parts)}</robot>')
    with pytest.raises(
        ParameterError, match=r"joint 'wrist' moves .* rotors=\{'wrist': 0.01\}"
    ):
        Arm.from_file(path)
    arm = Arm.from_file(path, rotors={"wrist": 0.0105})
    bare = Arm.from_file(path, rotors={"wrist": 1.0})
    assert [link.rotor_inertia for link in arm.links] == [0.0, 0.0105]
    assert "rotor inertia given beside the file: wrist 0.0105 kg m^2" in arm.source
    mass = [inertia(k, np.zeros(2))[6:, 6:] for k in (arm, bare)]
    np.testing.assert_allclose(mass[1] - mass[0], np.diag([0, 1 - 0.0105]), atol=1e-12)
    arm.to_mjcf(tmp_path / "arm.xml")
    again = Arm.from_file(tmp_path / "arm.xml", rotors={"wrist": 0.02})
    assert again.links[1].rotor_inertia == 0.02
    for rotors, why in (({"elbow": 0.1}, "no moving joint 'elbow'; there are turn, wrist"),
                        ({"wrist": -1.0}, "joint 'wrist' must be >= 0 kg")):  # fmt: skip
        with pytest.raises(ParameterError, match=why):
            Arm.from_file(path, rotors=rotors)


# ------------------------------------------------------------------------------- MJCF

MODEL = """
<mujoco model="crooked">
  <compiler angle="degree" autolimits="true"/>
  <default><joint armature="0.02" damping="0.4"/><geom density="700"/></default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="stand" pos="0.2 0.1 0.3" euler="10 20 30">
      <geom type="box" size="0.1 0.1 0.1"/>
      <body name="upper" pos="0 0 0.1" euler="0 40 0">
        <joint name="pan" axis="0.2 0.1 1" range="-120 100"/>
        <joint name="lift" axis="0 1 0" pos="0 0 0.05" range="-90 90" frictionloss="0.3"/>
        <geom type="capsule" fromto="0 0 0 0.1 0.05 0.5" size="0.05"/>
        <body name="fore" pos="0.1 0.05 0.5" quat="0.9 0.1 0.3 0.2">
          <joint name="elbow" axis="1 0 0" ref="20"/>
          <geom type="cylinder" fromto="0 0 0 0 0.4 0" size="0.04"/>
          <site name="pen" pos="0 0.4 0.02" euler="30 0 10"/>
          <body name="finger" pos="0 0.4 0">
            <joint name="grip" type="slide" axis="0 0 1" ref="0.1"/>
            <geom type="sphere" size="0.03"/></body>
        </body>
      </body>
    </body>
    <body name="ball" pos="2 0 0"><freejoint/><geom size="0.1"/></body>
  </worldbody>
  <actuator>
    <motor joint="pan" ctrlrange="-50 60" gear="2"/>
    <position joint="lift" kp="100" forcerange="-80 80" gear="1.5"/>
  </actuator>
</mujoco>
"""


def test_an_mjcf_is_what_mujoco_makes_of_it(write):
    """Tolerance: 1e-12, rounding; the issue asks for 1e-10."""
    path = write(MODEL, "arm.xml")
    arm = Arm.from_file(path, tip="pen")
    assert [k.name for k in arm.links] == ["pan", "lift", "elbow"]
    assert worst(arm, by_mujoco(path, arm, "pen")) < 1e-12
    pan, lift, elbow = arm.links
    assert np.rad2deg([pan.q_min, pan.q_max]) == pytest.approx([-120, 100])
    assert elbow.q_max == -elbow.q_min == pytest.approx(2 * np.pi)
    assert (pan.tau_max, lift.tau_max) == (120.0, 120.0)
    assert (pan.rotor_inertia, pan.damping, lift.friction) == (0.02, 0.4, 0.3)
    assert "tau_max of elbow not given" in arm.source and "grip at 0.1" in arm.source
    assert [len(k.shape) for k in arm.links] == [0, 1, 2]
    stand, q = Arm.from_file(path, tip="pen", root="stand"), np.array([0.3, -0.5, 0.8])
    pairs = [
        (inertia(k, q)[6:, 6:], tool_frame(k, q)[0] - frames(k, q).origin[0])
        for k in (arm, stand)
    ]
    np.testing.assert_allclose(pairs[1][0], pairs[0][0], atol=1e-12)
    lengths = [np.linalg.norm(way) for _, way in pairs]
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-12)
    assert get_arm(f"{path}#pen") == arm


ELBOW = 'name="elbow" axis="1 0 0" ref="20"'
BAD_MJCF = [  # old text, new text, what is said
    (ELBOW, 'name="elbow" type="ball"', "'elbow' of body"),
    (ELBOW, 'name="elbow" type="slide"', "locked="),
    (
        "</mujoco>",
        '<equality><joint joint1="elbow" joint2="lift" polycoef="0 0 1 0 0"/></equality>'
        "</mujoco>",
        "joint 'elbow' follows 'lift', but not in proportion",
    ),
    (
        "</mujoco>",
        '<equality><connect body1="fore" body2="stand" anchor="0 0 0"/></equality></mujoco>',
        "bodies 'fore' and 'stand' are held together by <equality>, which closes a loop over",
    ),
    ('type="sphere" size="0.03"', 'type="mesh" mesh="m"', "MuJoCo cannot compile it: .*mesh"),
    ('pos="0.1 0.05 0.5"', 'pos="100 50 500"', "lengths must be in m, these look like mm"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_MJCF)
def test_a_bad_mjcf_is_named(write, old, new, message):
    assert old in MODEL
    path = write(MODEL.replace(old, new), "arm.xml")
    with pytest.raises(ParameterError, match=rf"arm\.xml: .*({message})"):
        Arm.from_file(path, tip="pen")


def test_several_ends_and_unknown_names(write):
    path = write(MODEL, "arm.xml")
    with pytest.raises(ParameterError, match="tip: no body 'hand'; there are world, stand"):
        Arm.from_file(path, tip="hand")
    with pytest.raises(ParameterError, match=r"has 2 ends: finger, ball; name the body"):
        Arm.from_file(path)
    with pytest.raises(ParameterError, match=r"joint 'grip' of body 'finger' is a slide"):
        Arm.from_file(path, root="stand")
    held = Arm.from_file(path, root="stand", locked={"grip": 0.01})
    assert held.n == 3 and "grip at 0.01" in held.source


# ------------------------------------------------------------------- in both engines


def runs(system, seconds=0.25):
    """State after some time under a torque that swings, on both engines."""
    n = system.arm.n
    rng = np.random.default_rng(n)
    low, high = system.arm.column("q_min"), system.arm.column("q_max")
    q = np.clip(rng.uniform(-0.5, 0.5, n), low, high)
    torque = 0.05 * system.arm.column("tau_max") * rng.uniform(-1, 1, n)
    out = []
    for backend in ("kernel", "mujoco"):
        sim = Simulator(system, backend=backend)
        sim.reset(q=q, y=1e-3 * np.ones(6))
        hold = sim.servo_command(q[None], np.zeros((1, n)))
        for _ in range(round(seconds / system.control_dt)):
            sim.step(hold + torque)
        out.append(
            np.concatenate([sim.state.q, sim.state.y, sim.state.v, sim.state.yd], axis=1)
        )
    return out


@pytest.mark.parametrize("name", ["chain", "a massless link", *arm_names()])
def test_kernel_is_mujoco(write, name):
    """The figure asked for is 1e-9, of angles [rad], rates [rad/s] and the base's pose."""
    if name == "chain":
        system = System(arm=Arm.from_file(write(chain(9, seed=9))), vehicle=FREE_FLOATING)
    elif name == "a massless link":
        arm = Arm.from_file(write(MODEL, "arm.xml"), tip="pen").without_friction()
        assert arm.links[0].inertial.mass == 0
        system = System(arm=arm)
    else:
        system = System(vehicle=BENT_THESIS, arm=get_arm(name))
    kernel, engine = runs(system, 0.1)
    assert np.isfinite(kernel).all()
    np.testing.assert_allclose(kernel, engine, atol=1e-9)


def test_damping_and_friction_of_links_are_those_of_the_effects():
    arm = get_arm("ur5e")
    damping, friction = (250.0, 2.0, 1.0, 0.1, 0.1, 0.0), (2.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    links = zip(arm.links, damping, friction, strict=True)
    rubbing = dataclasses.replace(
        arm, links=tuple(dataclasses.replace(k, damping=d, friction=f) for k, d, f in links)
    )
    thirds = JointViscous(damping=tuple(k / 3 for k in damping))
    system = System(vehicle=BENT_THESIS, arm=rubbing)
    assert system.actual.arm == arm
    assert system.actual.effects == (*[thirds] * 3, JointCoulomb(torque=friction))
    assert system.actual.actual is system.actual
    by_hand = System(
        vehicle=BENT_THESIS, arm=arm, effects=(*[thirds] * 3, JointCoulomb(torque=friction))
    )
    for one, other in zip(runs(system, 0.05), runs(by_hand, 0.05), strict=True):
        np.testing.assert_array_equal(one, other)


def test_an_obstacle_meets_the_shape_that_the_file_gives():
    """A wide capsule on the UR5e's forearm: a sphere is met at its radius, from the axis."""
    arm = get_arm("ur5e")
    wide = Capsule(start=(0.05, 0.0, 0.0), end=(0.3, 0.0, 0.0), radius=0.2)
    links = list(arm.links)
    links[2] = dataclasses.replace(links[2], shape=(wide,))
    shaped = dataclasses.replace(arm, links=tuple(links))
    q = np.array([0.3, -1.0, 0.8, 0.0, 0.0, 0.0])
    turn, at = (part[2] for part in (frames(arm, q).rotation, frames(arm, q).position))
    middle, aside = at + turn @ [0.2, 0.0, 0.0], turn @ [0.0, 0.0, -1.0]
    for gap, clear in ((0.01, True), (-0.01, False)):
        ball = Sphere(centre=tuple(middle + (0.2 + 0.05 + gap) * aside), radius=0.05)
        around = Surroundings(obstacles=(ball,), clearance=0.0)
        found = collisions(System(vehicle=BENT_THESIS, arm=shaped), around)
        assert found.is_clear(q) is clear
    assert collisions(System(vehicle=BENT_THESIS, arm=arm), around).is_clear(
        q
    )  # thin capsules along the links
