"""Arms from files as others write them: couplings, gaps and habits, judged by other readers."""

import numpy as np
import pytest

from tests.three_links import BALANCED, CHAIN, LIMIT, joint, link, mimic, robot, three_links
from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia


@pytest.fixture
def urdf(tmp_path):
    def write(parts, old="", new="", name="arm.urdf"):
        text = robot(parts)
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new) if old else text)
        return tmp_path / name

    return write


@pytest.fixture
def mjcf(tmp_path):
    def write(extra="", beside=""):
        (tmp_path / "arm.xml").write_text(three_links(extra, beside))
        return tmp_path / "arm.xml"

    return write


# ------------------------------------------------------------------------ coupled joints


def test_a_follower_is_not_frozen_in_silence(urdf):
    """Pinocchio with mimic: the counterweight of 20 kg turns with joint 2, unless it is held
    by those who ask for it."""
    pin = pytest.importorskip("pinocchio")
    path = urdf(BALANCED)
    arm = Arm.from_file(path, tip="tool")
    held = Arm.from_file(path, tip="tool", locked={"k_balance": 0.0})
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    coupled = pin.crba(model, model.createData(), np.zeros(model.nq))
    of_links, of_all = (inertia(k, np.zeros(3))[6:, 6:] for k in (held, arm))
    assert of_all[1, 1] == pytest.approx(coupled[1, 1], rel=1e-12)
    assert coupled[1, 1] - of_links[1, 1] == pytest.approx(0.3 + 20 * 0.5**2)


def test_a_fixed_joint_follows_nothing(urdf):
    """Whatever its <mimic> says: as Pinocchio has it."""
    pin = pytest.importorskip("pinocchio")
    path = urdf(BALANCED, 'name="k_balance" type="revolute"', 'name="k_balance" type="fixed"')
    arm = Arm.from_file(path, tip="tool")
    assert arm.followers is None
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    theirs = pin.crba(model, model.createData(), np.zeros(3))
    ours = inertia(arm, np.zeros(3))[6:, 6:]
    np.testing.assert_allclose(np.triu(ours), np.triu(theirs), rtol=1e-12, atol=1e-14)


def test_a_follower_stands_still_with_its_leader(urdf):
    """As Pinocchio has it at the leader's angle, also on the chain."""
    pin = pytest.importorskip("pinocchio")
    on_chain = [k.replace(LIMIT, mimic("j2", 0.5, 0.1) + LIMIT) if 'name="j3"' in k else k
                for k in BALANCED]  # fmt: skip
    path = urdf(on_chain)
    arm = Arm.from_file(path, tip="tool", locked={"j2": 0.6})
    assert "j2 at 0.6, j3 at 0.4" in arm.source and "k_balance at -0.6" in arm.source
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    coupled = pin.crba(model, model.createData(), np.array([0.0, 0.6]))
    assert inertia(arm, np.zeros(1))[6, 6] == pytest.approx(coupled[0, 0], rel=1e-12)


TENDONS = (
    '<tendon><fixed name="a"><joint joint="j2" coef="2"/></fixed>'
    '<fixed name="b"><joint joint="j3" coef="1"/></fixed></tendon>'
)
ROD = '<body name="rod"><joint name="jr"/><geom size="0.05" mass="1"/></body>'
COUPLED = {  # what is said of it
    r"tendon 'a' and 'b', but not in proportion, and 'j3' would move.*--lock j2=0": (
        f'{TENDONS}<equality><tendon tendon1="a" tendon2="b" polycoef="0 1 2 0 0"/></equality>',
        ""),
    r"joint 'j3' follows 'j2', but not in proportion": (
        '<equality><joint joint1="j3" joint2="j2" polycoef="0 1 1 0 0"/></equality>', ""),
    r"ties tendon 's', but not in proportion, and 'j2', 'j1', 'j3' would move.*--lock j3=0": (
        '<tendon><spatial name="s"><site site="foot"/><site site="tcp"/></spatial></tendon>'
        '<equality><tendon tendon1="s"/></equality>', '<site name="foot"/>'),
    r"joint 'j3' follows 'j2', and follows others too": (
        '<equality><joint joint1="j3" joint2="j2"/><joint joint1="j2" joint2="j1"/>'
        '<joint joint1="j3" joint2="j2"/></equality>', ""),
    r"joints 'j3', 'j2' follow each other in a ring": (
        '<equality><joint joint1="j3" joint2="j2"/><joint joint1="j2" joint2="j3"/></equality>',
        ""),
    r"actuator 'both' pulls 'j2', 'j3' together by a tendon": (
        '<tendon><fixed name="t"><joint joint="j2" coef="1"/><joint joint="j3" coef="1"/>'
        '</fixed></tendon><actuator><motor name="both" tendon="t"/></actuator>', ""),
    r"'l3' and 'rod' are held together .* loop over 'j2', 'j3'.*--lock j2=0 --lock j3=0": (
        '<equality><connect body1="l3" body2="rod" anchor="0.3 0 0"/></equality>', ROD),
    r"'l3' and 'rod' are held together": (
        '<equality><weld site1="tcp" site2="end"/></equality>',
        ROD.replace("</body>", '<site name="end"/></body>')),
}  # fmt: skip


@pytest.mark.parametrize("said", COUPLED)
def test_what_ties_joints_is_refused_by_name(mjcf, said):
    with pytest.raises(ParameterError, match=said):
        Arm.from_file(mjcf(*COUPLED[said]), tip="tcp")


def test_what_ties_bodies_that_do_not_move_against_each_other_is_no_loop(mjcf):
    tie = '<equality><weld body1="l1" body2="rod"/></equality>'
    assert Arm.from_file(mjcf(tie, ROD), tip="tcp").n == 3


def test_an_equality_is_kept_where_its_leader_stands_still(mjcf):
    """MuJoCo: q3 = 0.1 + 0.5 q2 + q2^2."""
    for bent, at in ((0, 0.4), (1, 0.76)):
        poly = f'polycoef="0.1 0.5 {bent} 0 0"'
        tie = f'<equality><joint joint1="j3" joint2="j2" {poly}/></equality>'
        arm = Arm.from_file(mjcf(tie), locked={"j2": 0.6})
        assert f"j2 at 0.6, j3 at {at}" in arm.source


def test_the_torque_of_a_tendons_motor_is_that_at_the_joint(mjcf):
    """MuJoCo: an actuator's moment on a joint is the tendon's coefficient."""
    import mujoco

    path = mjcf(f'{TENDONS}<actuator><motor tendon="a" forcerange="-30 30"/></actuator>')
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.ctrl[:] = 30.0
    mujoco.mj_forward(model, data)
    assert Arm.from_file(path).links[1].tau_max == data.qfrc_actuator[1] == 60.0


# ------------------------------------------------------- what is unknown, and who decides


SHAPE = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'


def test_a_shape_without_mass_on_a_body_that_has_one_weighs_nothing(urdf):
    """As others read it, and the source says so."""
    path = urdf(CHAIN, '<link name="tool"/>', f'<link name="tool">{SHAPE}</link>')
    arm = Arm.from_file(path)
    assert arm.links == Arm.from_file(urdf(CHAIN)).links
    assert "no mass in the file, so none: tool" in arm.source


def test_links_that_move_without_any_mass_are_named_at_once(urdf):
    beyond = f'<link name="eye">{SHAPE}</link>', f'<link name="ear">{SHAPE}</link>'
    joints = joint("k", "l3", "eye"), joint("h", "eye", "ear", kind="fixed")
    path = urdf([*CHAIN, *beyond, *joints])
    said = r"'eye', 'ear' have a shape, .* is unknown \(--massless eye --massless ear"
    with pytest.raises(ParameterError, match=said):
        Arm.from_file(path, tip="ear")
    arm = Arm.from_file(path, tip="ear", massless=["eye", "ear"], rotors={"k": 0.1})
    assert "taken to weigh nothing: eye, ear" in arm.source
    with pytest.raises(ParameterError, match="massless: no link 'hand'"):
        Arm.from_file(path, tip="ear", massless=["hand"])


def test_an_inertia_is_judged_with_what_moves_along(urdf):
    """A camera of no rigid body's inertia on a link: together as Pinocchio has them."""
    pin = pytest.importorskip("pinocchio")
    eye = link("eye", 0.05, moments=(1e-5, 1e-5, 1e-4)), joint("k", "l3", "eye", kind="fixed")
    path = urdf([*CHAIN, *eye])
    arm = Arm.from_file(path, tip="tool")
    assert "inertia of eye, which no rigid body has, taken as it is" in arm.source
    model = pin.buildModelFromUrdf(str(path))
    theirs = pin.crba(model, model.createData(), np.zeros(3))
    np.testing.assert_allclose(
        inertia(arm, np.zeros(3))[6:, 6:], theirs, rtol=1e-12, atol=1e-15
    )


def test_a_shape_in_millimetres_is_asked_about(urdf, tmp_path):
    box = '<collision><geometry><box size="300 200 200"/></geometry></collision>'
    path = urdf(CHAIN, CHAIN[2], link("l2", 1.5, shape=box))
    with pytest.raises(
        ParameterError, match=r"'l2' has a shape of .* like mm .*--no-collision"
    ):
        Arm.from_file(path)
    assert Arm.from_file(path, collision=False).n == 3


REPAIRED = {  # what the source says of it
    "principal moments of l2 0.01, 0.02, 0.05 taken as 0.02, 0.03, 0.05": (
        CHAIN[2], link("l2", 1.5, moments=(0.01, 0.02, 0.05))),
    "principal moments of base 0.1, 0.1, 0.1 taken as 0, 0, 0": (
        CHAIN[0], link("base", 0.0, moments=(0.1, 0.1, 0.1))),
    "range of j1 0 to 0 taken as 2 pi either way": (
        LIMIT, '<limit lower="0" upper="0" effort="50" velocity="2"/>'),
}  # fmt: skip


@pytest.mark.parametrize("said", REPAIRED)
def test_a_repair_is_asked_for_and_listed(urdf, said):
    path = urdf(CHAIN, *REPAIRED[said])
    with pytest.raises(ParameterError, match=r"--repair, in Python repair=True"):
        Arm.from_file(path)
    assert said in Arm.from_file(path, repair=True).source


def test_options_of_a_file_are_those_of_python(urdf, capsys):
    words = ["simulate", "--duration", "0.1", "--settle", "0", "--goal", "1,1,0"]
    words += ["--arm", str(urdf(BALANCED))]
    assert main([*words, "--tip", "tool"]) == 0
    assert "joints that follow others: k_balance" in capsys.readouterr().err
    assert main([*words, "--tip", "tool", "--lock", "k_balance=90"]) == 0
    assert "k_balance at 1.5708" in capsys.readouterr().err  # degrees, as elsewhere there
    for more, said in (
        (["--lock", "k_balance"], "--lock must be JOINT=ANGLE"),
        (["--lock", "rope=1"], "no joint 'rope'; there are j1"),
        (["--root", "hand"], "root: no link 'hand'"),
    ):
        assert main([*words, "--tip", "tool", *more]) == 2
        assert said in capsys.readouterr().err
    assert main(["simulate", "--tip", "tool"]) == 2
    assert "--tip goes with --arm FILE" in capsys.readouterr().err
    assert main(["simulate", "--arm", "ur5e", "--repair"]) == 2
    assert "goes with a URDF or MJCF file" in capsys.readouterr().err


def test_an_environment_takes_a_file_with_its_options(urdf, tmp_path, capsys):
    words = ["evaluate", "BeamLQR-v0", "--controller", "zero", "--episodes", "1"]
    words += ["--out", str(tmp_path), "--arm", str(urdf(BALANCED)), "--tip", "tool"]
    assert main([*words, "--lock", "k_balance=0"]) == 0
    assert "k_balance at 0" in capsys.readouterr().err


# -------------------------------------------------------------- as others read them, too


def test_joints_without_an_end_turn_twice_either_way(urdf):
    """MuJoCo reads all of these as joints without limits."""
    plain = Arm.from_file(urdf(CHAIN))
    for limit in (
        '<limit effort="50" velocity="2"/>',
        '<limit lower="-inf" upper="inf" effort="50" velocity="2"/>',
    ):
        arm = Arm.from_file(urdf(CHAIN, LIMIT, limit))
        assert arm.column("q_max") == pytest.approx([2 * np.pi] * 3)
        assert arm.column("tau_max").tolist() == plain.column("tau_max").tolist()
    free = Arm.from_file(urdf(CHAIN, LIMIT, ""))
    assert "tau_max not given" in free.source
    endless = '<limit lower="-2" upper="2" effort="inf" velocity="2"/>'
    assert "tau_max not given" in Arm.from_file(urdf(CHAIN, LIMIT, endless)).source


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("<robot name", '<robot xmlns="http://www.ros.org" name'),
        ("</robot>", "<gazebo><sensor:camera name='rgb'/></gazebo></robot>"),
        ("<robot name", '\n  <?xml version="1.0"?><robot name'),
        ('<link name="tool"/>', '<link name="tool"/><!-- d\xe9j\xe0 -->'),
    ],
)
def test_xml_as_it_is_written(tmp_path, urdf, old, new):
    plain = Arm.from_file(urdf(CHAIN))
    text = urdf(CHAIN).read_text().replace(old, new)
    (tmp_path / "arm.urdf").write_bytes(text.encode("latin-1"))
    assert Arm.from_file(tmp_path / "arm.urdf").links == plain.links


def test_two_point_masses_are_a_body(urdf):
    """Pinocchio's inertia; rounding once left -8.6e-16 kg m^2 about their line."""
    pin = pytest.importorskip("pinocchio")
    rng, none = np.random.default_rng(0), (0.0, 0.0, 0.0)
    for _ in range(20):
        x, y = rng.normal(size=2).round(7)
        parts = [link("l1", 0.3, x, none), link("p", 0.7, y, none), *CHAIN[2:5], CHAIN[0],
                 joint("f", "l1", "p", round(rng.normal(), 7), kind="fixed", limit=""),
                 joint("j2", "p", "l2"), CHAIN[6]]  # fmt: skip
        turn = ' rpy="2.8574 -0.9381 -0.1255"/>'
        path = urdf(
            parts, '0 0"/><axis xyz="0 0 1"/>', f'0.31 1.363393"{turn}<axis xyz="0 0 1"/>'
        )
        arm, model = Arm.from_file(path), pin.buildModelFromUrdf(str(path))
        H = pin.crba(model, model.createData(), np.zeros(3))
        np.testing.assert_allclose(inertia(arm, np.zeros(3))[6:, 6:], H, atol=1e-12)


def test_a_mesh_is_found_and_read_as_others_do(tmp_path, urdf):
    """An STL with bytes after its triangles; a name with %20; a name of another system."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4") / 10
    faces = b"".join(bytes(12) + corners[list(k)].tobytes() + bytes(2)
                     for k in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)))  # fmt: skip
    (tmp_path / "meshes").mkdir()
    data = bytes(80) + (4).to_bytes(4, "little") + faces
    (tmp_path / "meshes" / "l 3.stl").write_bytes(data + b"made by a program")
    capsules = []
    for name in ("meshes/l 3.stl", "meshes\\l 3.stl", "file://meshes/l%203.stl"):
        mesh = f'<collision><geometry><mesh filename="{name}"/></geometry></collision></link>'
        path = urdf(CHAIN, "</link><joint", f"{mesh}<joint")
        capsules.append(Arm.from_file(path).links[2].shape)
    assert capsules[0] and capsules[0] == capsules[1] == capsules[2]
    path = urdf(CHAIN, "</link><joint", mesh.replace("203", "204") + "<joint")
    with pytest.raises(ParameterError, match=r"is not there \(--no-collision, in Python"):
        Arm.from_file(path)


def test_commas_stand_between_numbers_or_are_refused(urdf):
    """ "0.4, 0, 0" is three numbers; "0,4 0" may be two with decimal commas."""
    arm = Arm.from_file(urdf(CHAIN))
    assert Arm.from_file(urdf(CHAIN, '"0.4 0 0"', '"0.4, 0, 0"')).links == arm.links
    for other in ('"0,4 0"', '"0,4 0,1"'):
        with pytest.raises(ParameterError, match="three numbers"):
            Arm.from_file(urdf(CHAIN, '"0.4 0 0"', other))


def test_a_shape_without_a_size_is_left_out_and_told(urdf):
    sphere = '<collision><geometry><sphere radius="0"/></geometry></collision></link>'
    arm = Arm.from_file(urdf(CHAIN, "</link><joint", f"{sphere}<joint"))
    assert not arm.links[2].shape and "a shape without a size left out: l3" in arm.source
