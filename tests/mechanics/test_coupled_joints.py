"""Joints that follow others, judged by Pinocchio and MuJoCo on the files they come from."""

import warnings
from xml.etree import ElementTree

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import ves_gym as vg
from tests.three_links import BALANCED, CHAIN, LIMIT, joint, link, mimic, robot, three_links
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.arm_files import ExportWarning
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.kinematics import tool_frame, tool_twists
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.obstacles import Sphere, Surroundings, collisions
from ves_gym.rendering.drawing import Drawing
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

pin = pytest.importorskip("pinocchio")

SLIDE = '<limit lower="0" upper="0.3" effort="90" velocity="1"/>'
URDF = {
    "beside the chain": BALANCED,
    "in the chain, from an offset": [
        k.replace("</joint>", f"{mimic('j2', 0.5, 0.1)}</joint>") if 'name="j3"' in k else k
        for k in CHAIN
    ],
    "a telescope": (
        *CHAIN[:4],
        link("l4", 0.7),
        joint("j1", "base", "l1", axis="0 0 1"),
        joint("s2", "l1", "l2", axis="1 0 0", kind="prismatic", limit=SLIDE),
        joint("s3", "l2", "l3", 0.3, "1 0 0", "prismatic", SLIDE, mimic("s2")),
        joint("j4", "l3", "l4", 0.3),
        '<link name="tool"/>',
        joint("flange", "l4", "tool", 0.3, kind="fixed"),
    ),
    "the rods of a palletiser": (
        *CHAIN,
        link("rod", 3.0, 0.1),
        joint("k_rod", "l1", "rod", 0.1, extra=mimic("j2", 1.0, 0.3)),
        link("coupler", 2.0, 0.15),
        joint("k_coupler", "rod", "coupler", 0.4, extra=mimic("j2", -1.0, 0.2)),
        link("knee", 1.0, 0.05),
        joint("k_knee", "l3", "knee", 0.1, "1 0 0", extra=mimic("j3", -2.0)),
        link("drum", 4.0, 0.02),
        joint("k_drum", "base", "drum", 0.3, "0.6 0 0.8", extra=mimic("j1", 3.0)),
    ),
}
TENDONS = (
    '<tendon><fixed name="a"><joint joint="j2" coef="2"/></fixed><fixed name="b"><joint'
    ' joint="j3" coef="1"/></fixed><fixed name="c"><joint joint="j1" coef="0.5"/><joint'
    ' joint="j2" coef="1"/><joint joint="j3" coef="-2"/></fixed></tendon>'
)
MJCF = {  # what couples, and the ratios of j1, j2 and j3
    "an equality": (
        '<equality><joint joint1="j3" joint2="j2" polycoef="0.1 -0.5 0 0 0"/></equality>',
        [[1, 0], [0, 1], [0, -0.5]], [0, 0, 0.1]),
    "two tendons": (
        f'{TENDONS}<equality><tendon tendon1="a" tendon2="b" polycoef="0.2 3 0 0 0"/>'
        "</equality>", [[1, 0], [0, 1.5], [0, 1]], [0, 0.1, 0]),
    "a differential": (
        f'{TENDONS}<equality><tendon tendon1="c"/></equality>',
        [[1, 0], [0, 1], [0.25, 0.5]], [0, 0, 0]),
}  # fmt: skip


@pytest.fixture
def write(tmp_path):
    def write(text, name="arm.urdf"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def gears(text, names, leaders):
    """G and c of the joints in this order, from the text of a URDF."""
    ratios, shift = np.zeros((len(names), len(leaders))), np.zeros(len(names))
    found = {k.get("name"): k.find("mimic") for k in ElementTree.fromstring(text).iter("joint")}
    for i, name in enumerate(names):
        tie = found[name]
        leader = name if tie is None else tie.get("joint")
        ratios[i, leaders.index(leader)] = 1.0 if tie is None else float(tie.get("multiplier"))
        shift[i] = 0.0 if tie is None else float(tie.get("offset", "0"))
    return ratios, shift


def configurations(arm, n=10):
    return np.random.default_rng(0).uniform(*map(arm.column, ("q_min", "q_max")), (n, arm.n))


@pytest.mark.parametrize("name", URDF)
def test_the_inertia_is_pinocchios(name, write):
    """G^T M G of its model of all joints, on a free base; and where the tool is."""
    path = write(robot(URDF[name]))
    arm = Arm.from_file(path, tip="tool")
    model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
    leaders = [k.name for k in arm.links]
    G, c = gears(path.read_text(), list(model.names)[2:], leaders)
    wide, data = np.eye(6 + len(G), 6 + arm.n), model.createData()
    wide[6:, 6:] = G
    for q in configurations(arm):
        at = np.r_[np.zeros(6), 1.0, G @ q + c]
        H = pin.crba(model, data, at)
        H = np.triu(H) + np.triu(H, 1).T
        np.testing.assert_allclose(inertia(arm, q), wide.T @ H @ wide, rtol=0, atol=1e-10)
        pin.framesForwardKinematics(model, data, at)
        tool = data.oMf[model.getFrameId("tool")]
        place, turn = tool_frame(arm, q)
        np.testing.assert_allclose(place, tool.translation, atol=1e-12)
        np.testing.assert_allclose(turn, tool.rotation, atol=1e-12)
        J = pin.computeFrameJacobian(
            model, data, at, model.getFrameId("tool"), pin.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(tool_twists(arm, q), J[:, 6:] @ G, atol=1e-12)


@pytest.mark.parametrize("name", URDF)
def test_torques_are_those_of_pinocchio_with_mimic(name, write):
    """Newton-Euler with gravity, base at rest; so is the model that the arm itself gives."""
    path = write(robot(URDF[name]))
    arm = Arm.from_file(path, tip="tool")
    for model in (pin.buildModelFromUrdf(str(path), mimic=True), arm.to_pinocchio()):
        data, rng = model.createData(), np.random.default_rng(1)
        for _ in range(10):
            q, v, a = rng.normal(size=(3, arm.n))
            tau, _ = inverse_dynamics(arm, q, v, a, (0.0, 0.0, -9.81))
            np.testing.assert_allclose(tau, pin.rnea(model, data, q, v, a), atol=1e-10)


@pytest.mark.parametrize("name", MJCF)
def test_a_coupled_mjcf_is_mujocos(name, write):
    """G^T M G and G^T (bias) of MuJoCo's joints; the offset lies in the geometry."""
    text, G, c = MJCF[name]
    path, G = write(three_links(text), "arm.xml"), np.array(G, float)
    arm, model = Arm.from_file(path, tip="tcp"), mujoco.MjModel.from_xml_path(str(path))
    data, H = mujoco.MjData(model), np.zeros((3, 3))
    for q in configurations(arm):
        v = np.random.default_rng(2).normal(size=2)
        data.qpos[:], data.qvel[:] = G @ q + c, G @ v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, H)
        np.testing.assert_allclose(inertia(arm, q)[6:, 6:], G.T @ H @ G, atol=1e-10)
        tau, _ = inverse_dynamics(arm, q, v, 0 * q, (0.0, 0.0, -9.81))
        np.testing.assert_allclose(tau, G.T @ data.qfrc_bias, atol=1e-10)
        np.testing.assert_allclose(tool_frame(arm, q)[0], data.site("tcp").xpos, atol=1e-12)


def test_the_limits_of_a_follower_are_its_leaders(write):
    """j3 = 0.5 j2 + 0.1 within -0.4 to 0.6 and 0.5 rad/s."""
    limit = '<limit lower="-0.4" upper="0.6" effort="50" velocity="0.5"/>'
    third = joint("j3", "l2", "l3", limit=limit, extra=mimic("j2", 0.5, 0.1))
    arm = Arm.from_file(write(robot([third if 'name="j3"' in k else k for k in CHAIN])))
    link = arm.links[1]
    assert (link.q_min, link.q_max, link.v_max) == pytest.approx((-1.0, 1.0, 1.0))
    assert link.tau_max == 50.0  # a follower has no motor


def test_limits_that_leave_no_range_are_named(write):
    """As grippers have them whose fingers turn the other way within the same limits."""
    limit = '<limit lower="0.1" upper="2" effort="50" velocity="0.5"/>'
    parts = [k.replace(LIMIT, limit) for k in BALANCED]
    path = write(robot(parts))
    with pytest.raises(ParameterError, match=r"'k_balance' follows 'j2', whose .*--repair"):
        Arm.from_file(path, tip="tool")
    arm = Arm.from_file(path, tip="tool", repair=True)
    assert "limits of k_balance, a follower, left out" in arm.source
    assert arm.links[1].q_max == 2.0


@pytest.mark.parametrize(
    "motors",
    [
        '<motor tendon="b" forcerange="-30 30"/>',
        '<motor joint="j2" forcerange="-20 20"/><motor joint="j3" forcerange="-6 6"/>',
        '<motor tendon="c" forcerange="-10 10"/>',
    ],
)
def test_motors_of_coupled_joints_add_up(motors, write):
    """MuJoCo's actuator forces on the joints, through G^T; j2 = 1.5 j3."""
    text, G, _ = MJCF["two tendons"]
    text = f"{text}<actuator>{motors}</actuator>".replace(
        'joint="j1" coef="0.5"', 'joint="j1" coef="0"'
    )
    path = write(three_links(text), "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1e3
    mujoco.mj_forward(model, data)
    tau = np.array(G).T @ data.qfrc_actuator
    assert Arm.from_file(path, tip="tcp").links[1].tau_max == pytest.approx(abs(tau[1]))


@pytest.mark.parametrize("name", [*URDF, *MJCF])
def test_a_coupled_arm_goes_out_and_comes_back(name, write, tmp_path):
    """As TOML, MJCF and URDF, to rounding; URDF has no words for a sum of joints."""
    urdf = name in URDF
    text = robot(URDF[name]) if urdf else three_links(MJCF[name][0])
    arm = Arm.from_file(
        write(text, "arm.urdf" if urdf else "arm.xml"), tip="tool" if urdf else "tcp"
    )
    System(arm=arm).save(tmp_path / "system.toml")
    assert System.load(tmp_path / "system.toml").arm == arm
    arm.to_mjcf(tmp_path / "out.xml")
    back = [Arm.from_file(tmp_path / "out.xml")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExportWarning)
        if name == "a differential":
            with pytest.raises(
                ParameterError, match="URDF has no words for j3, which follows j1"
            ):
                arm.to_urdf(tmp_path / "out.urdf")
        else:
            arm.to_urdf(tmp_path / "out.urdf")
            back.append(Arm.from_file(tmp_path / "out.urdf", tip="tool"))
    q, v, a = np.random.default_rng(3).normal(size=(3, arm.n))
    for other in back:
        assert [k.link.name for k in other.followers] == [k.link.name for k in arm.followers]
        np.testing.assert_allclose(inertia(other, q), inertia(arm, q), atol=1e-10)
        for mine, theirs in zip(
            inverse_dynamics(arm, q, v, a), inverse_dynamics(other, q, v, a), strict=True
        ):
            np.testing.assert_allclose(theirs, mine, atol=1e-10)
        for column in ("q_min", "q_max", "v_max", "a_max", "tau_max"):
            np.testing.assert_allclose(other.column(column), arm.column(column), rtol=1e-12)


@pytest.mark.parametrize("drive", ["motor", "prescribed"])
@pytest.mark.parametrize("name", [*URDF, "a differential"])
def test_a_run_is_that_of_mujoco_with_the_equality(name, drive, write):
    """The kernel has the joint exactly, MuJoCo as a soft constraint as stiff as it takes.

    What MuJoCo leaves of the constraint's acceleration is 1e-4 of what it would be without,
    and the constraint's own spring (two steps of 1.25 ms) takes it back: 1e-4 * 20 rad/s^2
    / (400/s)^2 is 1e-8 rad. Measured: 8e-9 rad, 4e-7 rad/s. The account of energy closes.
    """
    text = robot(URDF[name]) if name in URDF else three_links(MJCF[name][0])
    path = write(text, "arm.urdf" if name in URDF else "arm.xml")
    arm = Arm.from_file(path, tip="tool" if name in URDF else "tcp")
    system = System(arm=arm, vehicle="bent", drive=drive)
    motion = Motion.straight(arm.home, arm.home + 0.5 * (arm.column("q_max") - arm.home), 2.0)
    exact, soft = (
        play_motions(
            system, [motion], settle=0.5, record_dt=system.physics_dt, backend=engine
        ).log(0)
        for engine in ("kernel", "mujoco")
    )
    for quantity, most in (("q", 1e-7), ("v", 1e-6), ("y", 1e-7), ("yd", 1e-6)):
        mine, theirs = getattr(exact, quantity), getattr(soft, quantity)
        assert np.abs(mine - theirs).max() < most * max(1.0, np.abs(mine).max()), quantity
    assert drive == "prescribed" or EnergyBalance.of(exact).relative < 1e-4


@pytest.fixture
def balanced(write):
    """With a capsule along the counterweight, which hangs 0.5 m behind joint 2."""
    shape = (
        '<collision><origin xyz="-0.5 0 0" rpy="0 1.5708 0"/><geometry><cylinder radius="0.05"'
        ' length="0.3"/></geometry></collision></link>'
    )
    parts = [
        k.replace("</link>", shape) if "counterweight" in k and "<link name" in k else k
        for k in BALANCED
    ]
    return Arm.from_file(write(robot(parts)), tip="tool")


def test_a_plan_of_a_coupled_arm_keeps_its_limits(balanced):
    """Joint 2 goes no further than its follower may, and the played plan keeps all limits."""
    system = System(arm=balanced, vehicle="bent")
    with pytest.raises(ParameterError, match="joint 2 must be within"):
        vg.plan([0.0, -0.5, 0.4], [1.0, 2.5, -0.4], system=system, duration=3.0)
    plan = vg.plan([0.0, -0.5, 0.4], [1.0, 0.7, -0.4], system=system, duration=3.0)
    log = vg.simulate(plan)
    assert (np.abs(log.v) <= balanced.column("v_max")).all()
    assert (np.abs(log.tau) <= balanced.column("tau_max")).all()
    assert np.abs(log.q[-1] - [1.0, 0.7, -0.4]).max() < 0.02


def test_a_follower_is_seen_by_collisions(balanced):
    """The counterweight meets a ball where j2 turns it to, and the slope is that by j2."""
    q = np.array([0.0, 0.5, 0.0])
    ball = Sphere(centre=(0.4 - 0.6 * np.cos(0.5), 0.0, -0.6 * np.sin(0.5)), radius=0.05)
    checker = collisions(System(arm=balanced, vehicle="bent"), Surroundings(obstacles=(ball,)))
    assert any("k_balance" in pair for pair in checker.contact_names(q))
    assert not any("k_balance" in pair for pair in checker.contact_names([0.0, -0.5, 0.0]))
    at = np.array([0.05, 0.1, 0.0])
    slope = checker.proximity(at, 0.5).slope
    for k, way in enumerate(1e-6 * np.eye(3)):
        ahead, behind = (checker.proximity(at + s * way, 0.5).distance for s in (1, -1))
        np.testing.assert_allclose(slope[:, k], (ahead - behind) / 2e-6, atol=1e-4)


def test_an_environment_runs_on_a_coupled_arm(balanced):
    env = gym.make("ves_gym:ves/PumaReach-v0", arm=balanced)
    env.reset(seed=0)
    for _ in range(100):
        observation, *_ = env.step(env.action_space.sample())
        assert np.isfinite(observation).all()
    env.close()


def test_a_drawing_has_followers_where_they_are(balanced):
    """How the counterweight turns between two configurations, against Pinocchio."""
    drawing, model = (
        Drawing(System(arm=balanced, vehicle="bent"), 64, 64),
        balanced.to_pinocchio(),
    )
    drawn, true, data = [], [], model.createData()
    for q in np.array([[0.2, 0.7, 0.1], [-0.4, -0.3, 0.6]]):
        drawing.pose(np.zeros(6), q)
        mujoco.mj_kinematics(drawing.model, drawing.data)
        drawn.append(drawing.data.body("follower_1").xmat.reshape(3, 3).copy())
        pin.forwardKinematics(model, data, q)
        true.append(data.oMi[model.getJointId("k_balance")].rotation.copy())
    np.testing.assert_allclose(drawn[1] @ drawn[0].T, true[1] @ true[0].T, atol=1e-12)


def test_what_takes_driven_joints_alone_says_so(balanced):
    for refused in (
        lambda: System(arm=balanced, mode="emulated"),
        lambda: System(arms=[balanced, balanced.at((1.0, 0.0, 0.0))]),
    ):
        with pytest.raises(ParameterError, match="k_balance follow: hold them"):
            refused()


def test_an_arm_that_stands_elsewhere_takes_its_followers_along(write):
    """A drum on the base link turns with joint 1: M is that of before in the new frame."""
    arm = Arm.from_file(write(robot(URDF["the rods of a palletiser"])), tip="tool")
    moved, q = arm.at((0.3, -0.2, 0.1), (0.2, 0.5, -0.4)), np.array([0.3, 0.4, -0.2])
    np.testing.assert_allclose(inertia(moved, q)[6:, 6:], inertia(arm, q)[6:, 6:], atol=1e-12)
    assert moved.mass == pytest.approx(arm.mass)
    whole, before = inertia(moved, q)[:6, :6], inertia(arm, q)[:6, :6]
    com = [-k[:3, 3:][[2, 0, 1], [1, 2, 0]] / k[0, 0] for k in (whole, before)]
    R, p = arm.at((0.0, 0.0, 0.0), (0.2, 0.5, -0.4)).mount.rotation, (0.3, -0.2, 0.1)
    np.testing.assert_allclose(com[0], R @ arm.feet[0].rotation.T @ com[1] + p, atol=1e-12)
