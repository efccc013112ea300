"""Arms as data: bodies that can exist, limits that name the joint, any number of joints."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

import ves_gym as vg
from tests.arms import PLANAR_GAINS, WRIST_GAINS, planar_arm, six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.link import Inertial, diagonal, matrix
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS, OWN_GAINS, own_gains
from ves_gym.mechanics.spatial import skew
from ves_gym.mechanics.vehicle import BENT, BENT_THESIS, STRAIGHT_VERTICAL, MatrixVehicle
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

# ------------------------------------------------------------------------- bodies


def body(*moments, mass=1.0, com=(0.0, 0.0, 0.0)):
    return Inertial(mass=mass, com=com, inertia=diagonal(*moments))


@pytest.mark.parametrize("moments", [(1, 1, 2.01), (5, 1, 1), (-0.1, 1, 1)])
def test_an_inertia_no_body_has_is_refused(moments):
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for axes in (np.eye(3), turn):
        crooked = axes @ np.diag(moments) @ axes.T
        with pytest.raises(ParameterError, match=r"Inertial\.inertia .*rigid body.*kg m\^2"):
            Inertial(mass=1.0, com=(0.0, 0.0, 0.0), inertia=matrix((crooked + crooked.T) / 2))
    assert body(1, 1, 2).inertia == diagonal(1, 1, 2)  # a plate is one
    with pytest.raises(ParameterError, match="must be symmetric"):
        Inertial(mass=1.0, com=(0.0,) * 3, inertia=((1.0, 0.1, 0.0), (0.0, 1, 0), (0, 0, 1)))
    with pytest.raises(ParameterError, match=r"Inertial\.mass must be >= 0 kg"):
        body(1, 1, 1, mass=-1.0)


def test_spatial_inertia_gives_the_kinetic_energy_of_the_body():
    b = body(0.3, 0.4, 0.5, mass=7.0, com=(0.2, -0.1, 0.4))
    v, w = np.array([0.3, -0.2, 0.5]), np.array([1.0, -2.0, 0.7])
    at_com = v + np.cross(w, b.com)
    energy = 0.5 * 7 * at_com @ at_com + 0.5 * w @ np.array(b.inertia) @ w
    twist = np.r_[v, w]
    assert 0.5 * twist @ b.spatial() @ twist == pytest.approx(energy, rel=1e-13)
    assert (skew(v) @ w == np.cross(v, w)).all()


# ------------------------------------------------------------------------- limits


def link(**changes):
    return dataclasses.replace(PUMA_560.links[1], **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q_min": 1.0, "q_max": 1.0}, "q_min < q_max, got 1.0 and 1.0"),
        ({"v_max": 0.0}, r"Link.v_max must be > 0 rad/s, got 0.0"),
        ({"rotor_inertia": -1e-9}, r"Link.rotor_inertia must be >= 0 kg m\^2"),
        ({"alpha": np.nan}, "Link must be finite"),
        ({"d": "0"}, "Link must be numbers"),
    ],
)
def test_a_link_out_of_range_is_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        link(**changes)


def test_limits_name_the_joint_its_range_and_the_value():
    arm = PUMA_560
    assert (arm.require_within_limits([2.79, -1.9, 2.35]) == [2.79, -1.9, 2.35]).all()
    message = r"start: joint 3 must be within -135.0 to 135.0 deg, got 143.2 deg"
    with pytest.raises(ParameterError, match=message):
        arm.require_within_limits([0, 0, 2.5], "start")
    for bad in ([0, 0], [0, 0, np.nan], "000"):
        with pytest.raises(ParameterError, match="q must"):
            arm.require_within_limits(bad)


# --------------------------------------------- other numbers of joints, the whole chain

ARMS = {"planar": (planar_arm(), PLANAR_GAINS), "six joints": (six_joint_arm(), WRIST_GAINS)}


@pytest.fixture(params=ARMS)
def case(request):
    return case_of(request.param)


def case_of(name):
    """Arm, servo, and two configurations well inside the limits."""
    arm, servo = ARMS[name]
    rng = np.random.default_rng(3)
    low, high = arm.column("q_min"), arm.column("q_max")
    start = 0.4 * (low + (high - low) * rng.uniform(size=arm.n))
    return arm, servo, start, start + 0.1 * (high - low)


def test_inertia_equals_the_engine_s(case):
    """Tolerance: rounding, 1e-12 of the largest entry. MuJoCo compiles the same data."""
    arm, _, start, goal = case
    system = System(vehicle=BENT_THESIS, arm=arm)
    model = compile_model(system)
    data = mujoco.MjData(model)
    for q in (start, goal, 0 * start):
        data.qpos[6:] = q
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        order = [0, 1, 2, 5, 4, 3, *range(6, 6 + arm.n)]
        found = inertia(arm, q)
        found[:6, :6] += system.base.M
        np.testing.assert_allclose(full[np.ix_(order, order)], found, atol=1e-12 * found.max())
        np.testing.assert_allclose(
            data.site("tool").xpos, joint_positions(arm, q)[-1], atol=1e-12
        )


def test_gains_are_for_the_arm_s_joints():
    arm = six_joint_arm()
    system = System(vehicle=BENT_THESIS, arm=arm)
    with pytest.raises(ParameterError, match="servo must have gains for 6 joints, got 3"):
        Simulator(system, servo=HIGH_GAINS)  # the PUMA's three
    own = Simulator(system).servo
    assert own == own_gains(arm, BENT_THESIS) and f"inertia of {arm.name}" in own.source
    assert len(own.kp) == len(own.kd) == 6


# ------------------------------------------------------------------------ servo gains

HEAVY = MatrixVehicle(  # as good as no base at all
    M=diagonal(*[1e9] * 6), D=diagonal(*[0.0] * 6), K=diagonal(*[0.0] * 6)
)


def test_the_thesis_s_arm_keeps_the_thesis_s_gains():
    assert OWN_GAINS.for_arm(PUMA_560, BENT) == HIGH_GAINS
    plain = dataclasses.replace(OWN_GAINS, feedforward=False).for_arm(PUMA_560, BENT)
    assert plain == dataclasses.replace(HIGH_GAINS, feedforward=False)
    assert HIGH_GAINS.for_arm(PUMA_560, BENT) is HIGH_GAINS


@pytest.mark.parametrize("bandwidth", [1.0, 2.0, 4.0])
def test_own_gains_have_the_bandwidth_that_the_arm_states(bandwidth):
    """Each joint alone, the others held, at its largest inertia: w = 2 pi f, zeta = 0.7."""
    arm = dataclasses.replace(six_joint_arm(), bandwidth=bandwidth)
    gains = own_gains(arm, HEAVY)
    q = np.random.default_rng(1).uniform(arm.column("q_min"), arm.column("q_max"), (500, 6))
    J = np.diagonal(inertia(arm, q)[:, 6:, 6:], axis1=1, axis2=2).max(axis=0)
    w = np.sqrt(gains.kp / J)
    np.testing.assert_allclose(w / (2 * np.pi), bandwidth, rtol=0.03)
    np.testing.assert_allclose(gains.kd / (2 * w * J), 0.7, rtol=0.03)


def test_own_gains_of_light_wrists_do_not_outrun_the_physics_step():
    """Without rotors the wrist is light: at its pure bandwidth some way would be fast."""
    light = [dataclasses.replace(k, rotor_inertia=0.0) for k in six_joint_arm().links]
    for link in (3, 4, 5):
        thin = dataclasses.replace(light[link].inertial, inertia=diagonal(1e-6, 1e-6, 1e-6))
        light[link] = dataclasses.replace(light[link], inertial=thin)
    arm = dataclasses.replace(six_joint_arm(), links=tuple(light), bandwidth=4.0)
    gains = own_gains(arm, HEAVY)
    for q in np.random.default_rng(1).uniform(-1.5, 1.5, (100, 6)):
        fast = np.linalg.eigvals(np.linalg.solve(inertia(arm, q)[6:, 6:], np.diag(gains.kd)))
        assert np.abs(fast).max() < 1.5 * 600


@pytest.mark.parametrize("vehicle", [BENT, STRAIGHT_VERTICAL], ids=["bent", "straight"])
def test_own_gains_are_those_of_the_base_that_the_arm_stands_on(vehicle):
    """1.5 t of arm on a beam's end of some kg: from the gains on a wall, 5033/s on `bent`."""
    arm = get_arm("canadarm2")
    held, own = (own_gains(arm, base) for base in (HEAVY, vehicle))
    assert own.kd[0] < held.kd[0] / 5
    Simulator(System(arm=arm, vehicle=vehicle))
    with pytest.raises(
        ParameterError, match=r"physics_dt must be <= .* canadarm2 .*/s"
    ) as told:
        Simulator(System(arm=arm, vehicle=vehicle), servo=held)
    step = float(str(told.value).split("<= ")[1].split(" s")[0])
    assert step < 1.25e-3
    steps = math.ceil(12.5e-3 / step)
    system = System(arm=arm, vehicle=vehicle, physics_dt=12.5e-3 / steps)
    with pytest.raises(ParameterError, match="physics_dt"):
        sim = Simulator(System(arm=arm, vehicle=vehicle))
        sim.set_gains(held.kp, held.kd)
    motion = Motion.straight(arm.home, np.add(arm.home, 0.02), 1.0)
    log = vg.simulate(motion, system, servo=held, settle=1.0)
    assert EnergyBalance.of(log).relative < 1e-2
