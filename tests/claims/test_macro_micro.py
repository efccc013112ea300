"""Claims: a small arm on a flexible boom with joints is one system, on every engine alike.

References: MuJoCo, which has the flexures as hinges with springs of its own; Pinocchio's
inertia and bias of the same chain; the ordinary arm in the rigid limit; the linear base that
the braked boom is near rest.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import scipy

from tests.arms import pinocchio_terms
from ves_gym.engine.linear import linearise_ideal
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.boom import REACHING_OUT, SHUTTLE_LIKE, Boom
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS, JointServo, own_gains
from ves_gym.mechanics.spatial import rate_matrix, rotation
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy import base_energy
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

PUMA = get_arm("puma560")
HOST = Satellite(
    body=Inertial(mass=1e5, com=(0.0, 0.0, -3.0), inertia=diagonal(1.3e6, 1e7, 1e7)),
    source="test: a host of 100 t",
)
GROUND = Satellite(
    body=Inertial(mass=1e9, com=(0.0,) * 3, inertia=diagonal(1e11, 1e11, 1e11)),
    source="test: as good as the ground",
)
DRIVEN = System(arm=SHUTTLE_LIKE.carry(PUMA), vehicle=HOST)
BRAKED = System(arm=SHUTTLE_LIKE.braked(REACHING_OUT, PUMA), vehicle=HOST)
SYSTEMS = {"driven": DRIVEN, "braked": BRAKED, "prescribed": DRIVEN.replace(drive="prescribed")}
MOTIONS = {
    "driven": Motion.straight(
        [*REACHING_OUT, 0.0, -0.8, 0.5], [0.31, -1.11, 1.68, 1.2, 0.2, -0.3], 2.0
    ),
    "braked": Motion.straight([0.0, -0.8, 0.5], [1.2, 0.2, -0.3], 2.0),
}
MOTIONS["prescribed"] = MOTIONS["driven"]


@pytest.mark.parametrize(
    "name", ["driven", pytest.param("braked", marks=pytest.mark.slow), "prescribed"]
)
def test_engines_agree_on_a_boom_with_joints(name):
    """Everything a run records, one motion of 2 s and a second after it."""
    runs = {
        k: play_motions(SYSTEMS[name], [MOTIONS[name]], settle=1.0, backend=k)
        for k in ("kernel", "mujoco")
    }
    a, b = runs["kernel"], runs["mujoco"]
    assert a.u.shape[-1] == SYSTEMS[name].arm.bends
    assert np.abs(a.u).max() > 1e-4
    apart = {}
    for part in ("q", "v", "y", "yd", "u", "ud", "tau", "w"):
        mine, theirs = getattr(a, part), getattr(b, part)
        apart[part] = np.abs(mine - theirs).max() / np.abs(theirs).max()
    print(name, {part: f"{k:.0e}" for part, k in apart.items()})
    # MuJoCo's prescribed joints follow by an inertia, and their torque is rounded
    most = 1e-8 if name == "prescribed" else 1e-9
    assert apart.pop("tau") <= (1e-5 if name == "prescribed" else most)
    assert max(apart.values()) <= most, apart


def random_state(system: System, seed: int):
    rng, p = np.random.default_rng(seed), system.arm.bends
    q, d = rng.uniform(-1, 1, system.arm.n), rng.uniform(-0.05, 0.05, p)
    y = rng.uniform(-0.3, 0.3, 6)
    return y, q, d, rng.uniform(-0.3, 0.3, 6 + system.arm.n + p)


@pytest.mark.parametrize("name", ["driven", "braked"])
def test_the_chain_is_pinocchios(name):
    """Inertia over (Y, chain), and the acceleration that the kernel finds."""
    system = SYSTEMS[name]
    chain, n, p = expand(system.arm), system.arm.n, system.arm.bends
    model = pinocchio_model(system.arm, system.base)
    data = model.createData()
    for seed in range(20):
        y, q, d, rate = random_state(system, seed)
        where = np.r_[y[TO_Y], chain.angles(q, d)]
        moving = np.r_[rate[:6][TO_Y], chain.angles(rate[6 : 6 + n], rate[6 + n :])]
        M, _ = pinocchio_terms(model, data, where, moving)
        H = chain.inertia(q, d)
        H[:6, :6] += system.base.body.spatial()
        order = np.r_[:6, 6 + np.array(chain.passive), 6 + np.array(chain.driven)]
        T = np.eye(len(H))
        T[:6, :6] = rate_matrix(y)[:, TO_Y]
        found = T.T @ H @ T
        assert found == pytest.approx(M[order[:, None], order], rel=1e-9, abs=1e-7)

        push = np.zeros(6 + n + p)
        springs = -chain.stiffness * d - chain.damping * rate[6 + n :]
        push[6 + np.array(chain.passive)] = springs
        expected = pin.aba(model, data, where, moving, push)
        sim = Simulator(system, backend="kernel", servo=None)
        sim.reset(q=q, v=rate[6 : 6 + n], y=y, yd=rate[:6])
        sim.backend.set_gear_state(d[None], rate[None, 6 + n :])
        found = sim.evaluate(np.zeros((1, n)))[1][0]
        assert found == pytest.approx(
            expected[:6][TO_Y], rel=1e-9, abs=1e-9 * np.abs(expected).max()
        )


def test_the_energy_account_closes():
    """Driven joints and brakes; residual over the work through the base port, as elsewhere."""
    for name in ("driven", "braked"):
        system, motion = SYSTEMS[name], MOTIONS[name]
        log = play_motions(system, [motion], settle=0.0, record_dt=system.physics_dt).log(0)
        found = EnergyBalance.of(log)
        assert found.strain.max() > 0.1
        print(name, f"{found.relative:.1e}", np.abs(found.residual).max() / found.kinetic.max())
        assert found.relative <= 1e-5  # measured 3e-6 driven, 2e-7 braked
        assert np.abs(found.residual).max() <= 1e-6 * found.kinetic.max()  # 1e-7, 9e-9


@pytest.mark.slow
def test_a_released_boom_keeps_its_energy():
    """Undamped, joints locked by a prescribed drive: E of the base is constant, as stated."""
    stiff = replace(SHUTTLE_LIKE, members=tuple(undamped(k) for k in SHUTTLE_LIKE.members))
    system = System(arm=stiff.braked(REACHING_OUT, PUMA), vehicle=HOST, drive="prescribed")
    system = system.replace(physics_dt=0.625e-3)
    chain, q = expand(system.arm), np.array([0.3, -0.5, 0.4])
    pull = np.array([300.0, -200.0, 400.0])  # N at the tool: deflects the slow modes
    ways = (chain.tool(q, 1e-6 * np.eye(13)) - chain.tool(q, np.zeros(13))) / 1e-6
    sim = Simulator(system)
    sim.reset(q=q, yd=[0.002, -0.001, 0.003, 0.0, 0.001, 0.0])
    sim.backend.set_gear_state((ways @ pull / chain.stiffness)[None], np.zeros((1, 13)))
    E = []
    for _ in range(200):
        E.append(base_energy(system, sim.state.q, sim.state.y, sim.state.yd, sim.base_modes))
        sim.step(np.zeros((1, 3)))
    total, strain = (np.array([getattr(k, n)[0] for k in E]) for n in ("total", "strain"))
    assert np.ptp(strain) > 0.5
    assert np.ptp(total) <= 1e-6 * np.ptp(strain)


def undamped(member):
    joints = tuple(replace(joint, damping=0.0) for joint in member.joints)
    return replace(member, joints=joints, loss=0.0)


def harder(boom: Boom, factor: float) -> Boom:
    """Members and brakes stiffer by a factor, in the same mass."""
    members, moduli = [], ("youngs_modulus", "shear_modulus")
    for member in boom.members:
        stiffer = {k: factor * getattr(member.material, k) for k in moduli}
        material = replace(member.material, **stiffer)
        joints = tuple(replace(k, stiffness=factor * k.stiffness) for k in member.joints)
        members.append(replace(member, material=material, joints=joints))
    return replace(boom, members=tuple(members))


@pytest.mark.slow
def test_a_stiff_boom_is_a_rigid_arm():
    """The distance to the ordinary n-joint arm falls as compliance does: by four each time."""
    motion, q = MOTIONS["driven"], []
    for factor in (4.0, 16.0, None):
        boom = harder(SHUTTLE_LIKE, factor or 1.0)
        arm = boom.carry(PUMA)
        if factor is None:
            arm = replace(arm, links=tuple(replace(k, flexures=None) for k in arm.links))
        dt = 1.25e-3 / 12
        system = System(arm=arm, vehicle=HOST, physics_dt=dt, control_dt=80 * dt)
        q.append(play_motions(system, [motion], settle=0.0).q[0])
    far, near = (np.abs(k - q[2]).max() for k in q[:2])
    assert far / near == pytest.approx(4.0, rel=0.15)
    assert near <= 1e-3  # rad


@pytest.mark.slow
def test_the_linear_model_is_the_motion_near_rest():
    """Small rates against the matrix exponential of the exact linearisation, servos closed."""
    member = replace(SHUTTLE_LIKE.members[1], hinges=1)
    short = replace(SHUTTLE_LIKE, members=(member,))
    system = System(arm=short.carry(PUMA), vehicle=HOST)
    servo, q, t = own_gains(system.arm, system.vehicle), np.array([0.2, 0.3, -0.5, 0.4]), 0.5
    linear = linearise_ideal(system, q, servo=servo)
    n, p = 4, 3
    small = 1e-6 * np.random.default_rng(0).uniform(-1, 1, 6 + n + p)
    sim = Simulator(system, servo=servo)
    sim.reset(q=q, yd=small[:6], v=small[6 : 6 + n])
    sim.backend.set_gear_state(np.zeros((1, p)), small[None, 6 + n :])
    hold = sim.servo_command(q[None], np.zeros((1, n)))
    for _ in range(40):
        sim.step(hold)
    x = scipy.linalg.expm(linear.A * t) @ np.r_[np.zeros(len(small)), small]
    found = np.r_[sim.state.y[0], sim.state.q[0] - q, sim.internal_state[0][0]]
    expected = x[: len(small)]
    assert np.abs(found - expected).max() <= 1e-4 * np.abs(expected).max()


@pytest.mark.parametrize("pace", [pytest.param(4.0, marks=pytest.mark.slow), 2.0])
def test_a_braked_boom_is_the_flexible_base_it_reduces_to(pace):
    """Tool and energy of the nonlinear chain on the ground against the linear base."""
    q0, q1 = [0.0, -0.8, 0.5], [1.2, 0.2, -0.3]
    motion = Motion.straight(q0, q1, pace)
    servo = JointServo(kp=(3000.0, 2000.0, 1000.0), kd=(50.0, 40.0, 30.0))
    whole = play_motions(
        System(arm=BRAKED.arm, vehicle=GROUND), [motion], settle=3.0, servo=servo
    )
    base = SHUTTLE_LIKE.at(REACHING_OUT, modes=7)
    reduced = play_motions(System(arm=PUMA, vehicle=base), [motion], settle=3.0, servo=servo)
    flange = SHUTTLE_LIKE.reach(REACHING_OUT)
    tool = expand(BRAKED.arm).tool(whole.q[0], whole.u[0])
    still = expand(BRAKED.arm).tool(whole.q[0], 0 * whole.u[0])
    carried = joint_positions(PUMA, reduced.q[0])[:, -1]
    pose = reduced.y[0]
    moved = pose[:, :3] + (rotation(pose) @ carried[..., None])[..., 0]
    mine = (tool - still) @ flange.rotation
    theirs = moved - joint_positions(PUMA, reduced.q[0])[:, -1]
    assert np.abs(mine).max() > 1e-3  # m
    assert np.abs(mine - theirs).max() <= 0.01 * np.abs(mine).max()
    E = [k.energies(tail=3.0)[0].E_mean for k in (whole, reduced)]
    assert E[1] == pytest.approx(E[0], rel=0.02)


def test_a_plan_on_the_reduction_pays_on_the_chain():
    """`refined`, 1 s, on the linear base; both motions judged on the nonlinear chain."""
    servo, energies = JointServo(kp=HIGH_GAINS.kp, kd=HIGH_GAINS.kd), {}
    query = Query(
        system=System(arm=PUMA, vehicle=SHUTTLE_LIKE.at(REACHING_OUT)),
        start=(0.0, -0.8, 0.5),
        goal=(1.2, 0.2, -0.3),
        duration=1.0,
    )
    for name in ("straight", "refined"):
        motion = solve(get_planner(name), query, seed=0).motion
        run = play_motions(System(arm=BRAKED.arm, vehicle=GROUND), [motion], servo=servo)
        energies[name] = run.energies()[0].E_mean
    print(f"{energies['refined'] / energies['straight']:.3f}")
    assert energies["refined"] <= 0.25 * energies["straight"]
