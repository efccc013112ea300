"""Several arms on one base: computed and simulated as Pinocchio and MuJoCo do, or refused."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from tests.two_engines import require_alike
from ves_gym._util.params import ParameterError
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.gravity import GRAVITY
from ves_gym.mechanics.kinematics import joint_positions, tool_frame, tool_twists
from ves_gym.mechanics.link import Gear, Limb
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.side_by_side import side_by_side
from ves_gym.mechanics.tool_pose import joints_for
from ves_gym.mechanics.vehicle import BENT, Satellite, get_vehicle
from ves_gym.planners.obstacles import Surroundings, collisions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

UR5E = get_arm("ur5e")
LEFT = UR5E.at((0.0, 0.5, 0.1), (0.3, 0.2, 0.5))
RIGHT = UR5E.at((0.1, -0.4, 0.0), (0.0, -0.4, 1.5))
TWO = side_by_side([LEFT, RIGHT])
SATELLITE = get_vehicle("servicer")


@pytest.mark.parametrize(
    "arm", [TWO, side_by_side([UR5E.at((0.0, 1.0, 0.0)), PUMA_560, LEFT])], ids=["two", "three"]
)
def test_kinematics_and_dynamics_are_pinocchios(arm):
    model = arm.to_pinocchio()
    model.gravity.linear[:] = 0.0
    data, tool = model.createData(), model.getFrameId("tool")
    for q, v, a in np.random.default_rng(0).normal(size=(5, 3, arm.n)):
        tau, _ = inverse_dynamics(arm, q, v, a)
        np.testing.assert_allclose(tau, pin.rnea(model, data, q, v, a), rtol=0, atol=1e-11)
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        np.testing.assert_allclose(inertia(arm, q)[6:, 6:], H, rtol=0, atol=1e-12)
        J = pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(tool_twists(arm, q), J, rtol=0, atol=1e-13)
        pin.framesForwardKinematics(model, data, q)
        place, turn = tool_frame(arm, q)
        np.testing.assert_allclose(place, data.oMf[tool].translation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(turn, data.oMf[tool].rotation, rtol=0, atol=1e-13)


def test_each_arm_apart_is_the_one_that_was_given():
    for arm, given in zip(TWO.apart, (LEFT, RIGHT), strict=True):
        assert arm.mount == given.mount and arm.n == 6 and not arm.beside
    q = np.random.default_rng(1).normal(size=(4, 12))
    points = joint_positions(TWO, q)
    for arm, span in zip(TWO.apart, TWO.spans, strict=True):
        alone = joint_positions(arm, q[:, span])[:, 1:]
        np.testing.assert_allclose(points[:, 1:][:, span], alone, rtol=0, atol=1e-15)
    masses = (LEFT.mass, RIGHT.mass, TWO.mass)
    assert masses[0] + masses[1] == pytest.approx(masses[2], rel=1e-12)
    # a whole arm that stands elsewhere is the same arm
    moved = inertia(LEFT, q[:, :6])[:, 6:, 6:]
    np.testing.assert_allclose(moved, inertia(UR5E, q[:, :6])[:, 6:, 6:], rtol=0, atol=1e-13)


def test_accelerations_on_a_satellite_are_pinocchios():
    system = System(arms=[LEFT, RIGHT], vehicle=Satellite(body=SATELLITE.body))
    model = pinocchio_model(system.arm, system.base)
    data = model.createData()
    rng = np.random.default_rng(5)
    order = np.r_[TO_Y, 6 + np.arange(12)]
    for backend in ("kernel", "mujoco"):
        sim = Simulator(system, 4, backend=backend, servo=None)
        y, yd = 0.3 * rng.normal(size=(2, 4, 6))
        q, v = rng.normal(size=(2, 4, 12))
        tau = rng.normal(size=(4, 12))
        sim.reset(q=q, v=v, y=y, yd=yd)
        _, z, zd = sim.backend.read()
        _, found = sim.backend.evaluate(tau)
        for k in range(4):
            true = pin.aba(model, data, z[k][order], zd[k][order], np.r_[np.zeros(6), tau[k]])
            error = np.abs(found[k] - true[np.argsort(order)]).max()
            assert error <= 1e-9 * max(1.0, np.abs(true).max())


@pytest.mark.parametrize(
    ("vehicle", "geared"),
    [(SATELLITE, False), (BENT, False), (BENT, True)],
    ids=["satellite", "bent", "bent and geared"],
)
def test_a_run_is_the_same_on_both_engines_and_its_ledger_closes(vehicle, geared):
    arms = [LEFT, RIGHT]
    if geared:
        gear = Gear(compliance=1e-4, damping=5.0)
        links = list(UR5E.links)
        links[1] = replace(links[1], gear=gear, rotor_inertia=2.0)
        arms = [replace(arm, links=tuple(links)) for arm in arms]
    system = System(arms=arms, vehicle=vehicle)
    rng = np.random.default_rng(3)
    start = rng.uniform(-1, 1, 12)
    motion = Motion.straight(start, start + rng.uniform(-0.3, 0.3, 12), 1.0)
    log = require_alike(system, motion)
    if not geared:
        assert EnergyBalance.of(log).relative <= 1e-5


def test_in_the_laboratory_both_engines_agree_and_the_weight_of_both_arms_is_taken_off():
    start = np.random.default_rng(3).uniform(-1, 1, 12)
    motion = Motion.straight(start, start + 0.2, 0.5)
    system = System(arms=[LEFT, RIGHT], vehicle=BENT, mode="emulated")
    log, space = require_alike(system, motion), require_alike(system.ideal(), motion)
    assert np.abs(log.w[:, :3]).max() > 0.99 * TWO.mass * GRAVITY  # the sensor feels it
    in_space = space.y[:: round(system.control_dt / system.physics_dt)]
    off, swing = np.abs(log.y - in_space).max(), np.abs(in_space).max()
    print(f"{off / swing:.3f} of a swing of {swing:.2e}")
    assert off <= 0.15 * swing


def test_a_system_of_two_arms_is_written_and_read(tmp_path):
    system = System(arms=[LEFT, RIGHT])
    system.save(tmp_path / "two.toml")
    assert System.load(tmp_path / "two.toml") == system
    named = System.from_dict({"arms": [LEFT, "ur5e"]})
    assert named == System(arms=[LEFT, UR5E])
    assert system.replace(vehicle=SATELLITE).arm == system.arm


def test_arms_that_meet_collide():
    system = System(arms=[UR5E.at((0.0, 0.3, 0.0)), UR5E.at((0.0, -0.3, 0.0))])
    checker = collisions(system, Surroundings())
    q = np.zeros(12)
    q[1] = q[7] = -1.57
    assert checker.contact_names(q) == []
    q[0], q[6] = np.pi / 2, -np.pi / 2
    q[1] = q[7] = 0.0
    assert checker.contact_names(q)


def test_two_arms_that_share_a_link_and_other_refusals(tmp_path):
    two, six = System(arms=[LEFT, RIGHT]).arm, Limb(name="a", joints=6)
    for message, refused in (
        ("ur5e-1 and ur5e-2 share a link", lambda: System(arms=[UR5E, UR5E])),
        ("at least one arm", lambda: System(arms=[])),
        ("must be of Arm, got 'ur5e'", lambda: System(arms=["ur5e"])),
        ("arm or arms, got both", lambda: System(arm=UR5E, arms=[LEFT, RIGHT])),
        ("each of several arms takes one arm", lambda: System(arms=[two, UR5E])),
        ("URDF takes one arm", lambda: two.to_urdf(tmp_path / "two.urdf")),
        ("Arm.to_mjcf takes one arm", lambda: two.to_mjcf(tmp_path / "two.xml")),
        ("Arm.at takes one arm", lambda: two.at((0.0, 0.0, 0.0))),
        ("leave the last arm a link", lambda: replace(UR5E, beside=(six,))),
    ):
        with pytest.raises(ParameterError, match=message):
            refused()


def test_inverse_kinematics_moves_the_arm_whose_tool_it_is():
    rng = np.random.default_rng(4)
    near = rng.uniform(-1, 1, (3, 12))
    aim = near.copy()
    aim[:, 6:] += rng.uniform(-0.5, 0.5, (3, 6))
    points = tool_frame(TWO, aim)[0]
    found, miss = joints_for(TWO, points, near)
    assert miss.max() < 1e-6
    np.testing.assert_array_equal(found[:, :6], near[:, :6])


# ------------------------------------------------------------------- one file, two chains


def two_chains(path, arms=(LEFT, RIGHT), torso=False):
    """Write a URDF of two arms on one base link, or on a torso that turns on it."""
    robot = ElementTree.Element("robot", name="two")
    foot = ElementTree.SubElement(robot, "link", name="foot")
    if torso:
        turn = ElementTree.fromstring(
            '<joint name="torso" type="revolute"><parent link="foot"/><child link="chest"/>'
            '<limit lower="-1" upper="1" effort="50" velocity="1"/></joint>'
        )
        robot.append(turn)
        foot = ElementTree.SubElement(robot, "link", name="chest")
    for prefix, arm in zip("ab", arms, strict=True):
        arm.to_urdf(path)
        for part in ElementTree.parse(path).getroot():
            for element in part.iter():
                for key in ("link", "name"):
                    if (
                        element.tag in ("link", "joint", "parent", "child")
                        and key in element.attrib
                    ):
                        element.set(key, f"{prefix}_{element.get(key)}")
            if part.tag in ("link", "joint"):
                robot.append(part)
        fixed = f'<joint name="{prefix}_foot" type="fixed"><parent link="{foot.get("name")}"/>'
        robot.append(ElementTree.fromstring(f'{fixed}<child link="{prefix}_base"/></joint>'))
    ElementTree.ElementTree(robot).write(path)
    return path


def test_two_chains_of_a_file_are_two_arms(tmp_path):
    """Against Pinocchio's own reading of the file; without rotors, which it has none of."""
    arms = [
        replace(k, links=tuple(replace(link, rotor_inertia=0.0) for link in k.links))
        for k in (LEFT, RIGHT)
    ]
    path = two_chains(tmp_path / "two.urdf", arms)
    arm = get_arm(path, tip=["a_tool", "b_tool"])
    assert arm.n == 12 and [k.name for k in arm.beside] == ["a_tool"] and arm.name == "two"
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    total = sum(k.mass for k in model.inertias)
    assert arm.mass == pytest.approx(total, rel=1e-12)
    for q in np.random.default_rng(0).uniform(-1, 1, (5, 12)):
        H = pin.crba(model, data, q)
        H = np.triu(H) + np.triu(H, 1).T
        np.testing.assert_allclose(inertia(arm, q)[6:, 6:], H, atol=1e-10)
        pin.framesForwardKinematics(model, data, q)
        place = data.oMf[model.getFrameId("b_tool")].translation
        np.testing.assert_allclose(tool_frame(arm, q)[0], place, atol=1e-12)
    again = get_arm(path, tip=["b_tool", "a_tool"])
    assert again.beside[0].name == "b_tool" and again.mass == pytest.approx(total, rel=1e-12)
    mine = get_arm(path, tip="a_tool")
    assert mine.n == 6 and mine.mass == pytest.approx(total, rel=1e-12)


def test_chains_that_share_a_joint_are_refused_by_name(tmp_path):
    path = two_chains(tmp_path / "two.urdf", torso=True)
    with pytest.raises(
        ParameterError, match="share joint 'torso' and its link 'chest': hold it"
    ):
        get_arm(path, tip=["a_tool", "b_tool"])
    assert get_arm(path, tip=["a_tool", "b_tool"], locked={"torso": 0.2}).n == 12
    with pytest.raises(ParameterError, match="tips must be different"):
        get_arm(path, tip=["a_tool", "a_tool"])
