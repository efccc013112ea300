"""Arms from URDF files: the file's own dynamics, and every bad file named with its link."""

import math

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.gravity import GravityModel, mass_parameters, moment_regressor
from ves_gym.mechanics.kinematics import frames

GRAVITY = (1.0, -2.0, -9.81)


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


@pytest.fixture
def write(tmp_path):
    def written(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return written


def with_pinocchio(path, arm, tip):
    """Largest differences of mass matrix, bias, tool pose and Jacobian, relative."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear[:] = GRAVITY
    data, rng = model.createData(), np.random.default_rng(1)
    frame = model.getFrameId(tip)
    worst = np.zeros(4)
    for _ in range(5):
        q, v = rng.uniform(-3, 3, arm.n), rng.normal(size=arm.n)
        theirs = np.concatenate(
            [
                [np.cos(x), np.sin(x)] if j.nq == 2 else [x]
                for x, j in zip(q, list(model.joints)[1:], strict=True)
            ]
        )
        M = pin.crba(model, data, theirs)
        M = np.triu(M) + np.triu(M, 1).T
        bias = pin.nonLinearEffects(model, data, theirs, v)
        pin.computeJointJacobians(model, data, theirs)
        pin.updateFramePlacements(model, data)
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        tool = data.oMf[frame]
        at = frames(arm, q)
        place, turn = at.position[-1], at.rotation[-1] @ arm.tool_rotation
        ours = np.concatenate([np.cross(at.axis, place - at.origin), at.axis], axis=1).T
        pairs = (
            (inertia(arm, q)[6:, 6:] - np.diag(arm.column("rotor_inertia")), M),
            (inverse_dynamics(arm, q, v, 0 * q, GRAVITY)[0], bias),
            (
                np.column_stack([turn, place]),
                np.column_stack([tool.rotation, tool.translation]),
            ),
            (ours, J),
        )
        worst = np.maximum(worst, [np.abs(a - b).max() / np.abs(b).max() for a, b in pairs])
    return worst


@pytest.mark.parametrize("n", [1, 3, 4, 7])
def test_a_chain_is_what_pinocchio_reads(write, n):
    """Tolerance: 1e-12, rounding; the issue asks for 1e-10."""
    path = write(chain(n, seed=n))
    arm = Arm.from_file(path)
    assert arm.n == n
    assert [k.name for k in arm.links] == [f"j{i}" for i in range(n)]
    assert with_pinocchio(path, arm, "tcp").max() < 1e-12


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 3.7e-6, 1e-3])
def test_a_first_axis_that_points_all_but_down(write, tilt):
    """Tolerance: 1e-12, rounding, also where a half turn is written as 3.1416."""
    rng = np.random.default_rng(0)
    hang = joint("first", "base", "upper", rpy=(math.pi - tilt, tilt, 0.1), axis=(0, 0, 1))
    then = joint("second", "upper", "fore", rpy=(0, math.pi - tilt, 0), axis=(0, 0, 1))
    bodies = "".join(body(rng, k) for k in ("base", "upper", "fore"))
    path = write(f'<robot name="r">{bodies}{hang}{then}</robot>')
    assert with_pinocchio(path, Arm.from_file(path), "fore").max() < 1e-12


def test_the_weight_s_minimal_parameters_hold_for_any_axes(write):
    arm = Arm.from_file(write(chain(7, seed=3)))
    q = np.random.default_rng(0).normal(size=(5, 7))
    model = GravityModel.of(arm)
    full = moment_regressor(arm, q) @ mass_parameters(arm)
    from ves_gym.mechanics.gravity import minimal_model

    np.testing.assert_allclose(minimal_model(arm).regressor(q) @ model.P, full, atol=1e-12)


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


@pytest.mark.parametrize("kind", ["stl", "ascii.stl", "obj", "dae"])
def test_a_mesh_becomes_a_capsule_that_holds_it(write, tmp_path, kind):
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(9, 3)).astype(np.float32) * [0.05, 0.1, 0.4]
    file = tmp_path / f"mesh.{kind}"
    if kind == "stl":
        cell = [("n", "<f4", 3), ("p", "<f4", (3, 3)), ("c", "<u2")]
        rows = np.zeros(3, dtype=cell)
        rows["p"] = corners.reshape(3, 3, 3)
        file.write_bytes(b"\0" * 80 + (3).to_bytes(4, "little") + rows.tobytes())
    elif kind == "ascii.stl":
        file.write_text("solid\n" + "".join(f"vertex {vector(p)}\n" for p in corners))
    elif kind == "obj":
        file.write_text("".join(f"v {vector(p)}\n" for p in corners))
    else:
        file.write_text(
            '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><unit'
            ' meter="0.01"/></asset><library_geometries><geometry id="g"><mesh><source id="s">'
            f"<float_array>{' '.join(map(vector, 100 * corners - (0, 0, 7)))}</float_array>"
            '</source><vertices><input semantic="POSITION" source="#s"/></vertices></mesh>'
            "</geometry></library_geometries><visual_scene><node><translate>0 0 7</translate>"
            '<instance_geometry url="#g"/></node></visual_scene></COLLADA>'
        )
    shape = MESH.replace("package://x/f.stl", f"package://pack/mesh.{kind}")
    shape = shape.replace("<mesh", '<mesh scale="2 2 2"')
    text = single(rng, shape, xyz=(0, 0, 0))
    (capsule,) = Arm.from_file(write(text)).links[0].shape
    for point in 2 * corners:
        assert distance(capsule, point) <= capsule.radius + 1e-6
    assert capsule.radius < 0.6


# ------------------------------------------------------------------------- bad files


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


HEAVY = inertial(4000, (1, 1, 1))
MESH = '<collision><geometry><mesh filename="package://x/f.stl"/></geometry></collision>'
NO_BODY = two(second=f'<link name="fore">{BOX}</link>')
BAD = {
    "no inertia": (NO_BODY, "link 'fore' has a shape, but no <inertial>"),
    "no inertia beyond": (
        two(second='<link name="fore"/>'),
        "nothing that joint 'elbow' moves has an inertia",
    ),
    "mimic": (
        two(extra='<mimic joint="shoulder"/>'),
        "joint 'elbow' to link 'fore' mimics 'shoulder'",
    ),
    "prismatic": (
        "<limits".join(two(kind="prismatic").rsplit("<limit", 1)),
        "joint 'elbow' is prismatic and has no <limit",
    ),
    "planar": (two(kind="planar"), "joint 'elbow' to link 'fore' is planar"),
    "floating": (two(kind="floating"), "joint 'elbow' to link 'fore' is floating"),
    "spherical": (two(kind="ball"), "joint 'elbow': no such type of joint: 'ball'"),
    "triangle": (
        two(second=inertial(moments=(0.1, 0.1, 0.3))),
        "link 'fore': Inertial.inertia must be that of a rigid body",
    ),
    "negative mass": (
        two(second=inertial(mass=-1)),
        "link 'fore': its mass: value must be a number >= 0, got '-1'",
    ),
    "no mass": (two(second=inertial(mass=0)), "link 'fore' has an inertia, but no mass"),
    "text": (two(second=inertial(mass="x")), "link 'fore': its mass: .* number >= 0, got 'x'"),
    "mm": (two(xyz=(0, 0, 432)), "what joint 'shoulder' moves is 432 m long .* look like mm"),
    "g": (
        two(first=HEAVY.replace("fore", "upper"), second=HEAVY),
        "link 'upper' has 4000 kg .* look like g ",
    ),
    "kg mm^2": (
        two(second=inertial(moments=(1e5, 1e5, 1e5))),
        r"link 'fore' of 2 kg has an inertia of 1e\+05 .*kg mm\^2",
    ),
    "mesh": (
        two(second=inertial().replace("</link>", f"{MESH}</link>")),
        "link 'fore': its mesh 'package://x/f.stl' is not there",
    ),
    "limits": (
        two().replace('lower="-2.5"', 'lower="3"'),
        "joint 'shoulder': its lower limit must be below",
    ),
    "no limit": (
        two().replace('lower="-2.5" upper="2.0"', ""),
        "joint 'shoulder' is revolute and has no <limit",
    ),
    "axis": (
        two().replace('axis xyz="0.0 1.0 0.0"', 'axis xyz="0 0 0"'),
        "joint 'elbow': its axis must not be zero",
    ),
    "xacro": (
        '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:a/></robot>',
        "is a xacro, not yet a URDF",
    ),
    "neither": ("<sdf/>", "expected <robot> or <mujoco> at the top, got <sdf>"),
    "no xml": ("<robot", "cannot be read"),
    "two roots": (
        two().replace("</robot>", '<link name="x"/></robot>'),
        "must have one root link, got base, x",
    ),
    "nowhere": (
        two().replace('parent link="upper"', 'parent link="uper"'),
        "joint 'elbow': its parent link 'uper' is not there",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_named_with_its_link(write, case):
    text, message = BAD[case]
    with pytest.raises(ParameterError, match=rf"arm\.urdf: {message}"):
        Arm.from_file(write(text))


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


def test_numbers_that_look_wrong_can_be_taken_all_the_same(write):
    arm = Arm.from_file(write(two(xyz=(0, 0, 432))), check=False)
    assert arm.links[0].d == pytest.approx(432)


def test_friction_that_no_step_resolves_is_left_out_and_said(write):
    light = inertial(0.01, (1e-6, 1e-6, 1e-6))
    rub = '<dynamics damping="10" friction="1"/>'
    arm = Arm.from_file(write(two(second=light, extra=rub)))
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
