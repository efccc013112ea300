"""Claim: a latch is an exact inelastic impulse, and what it joins moves as one body.

Momentum of arm, base and payload through the latch changes by <= 1e-10 of what the single
bodies carry, the energy lost is the closed form's to 1e-9, and rates after it are those that
Pinocchio's impulse dynamics (satellites) and MuJoCo's mass matrix and Jacobians (every base)
give. After it, arm and payload move as MuJoCo moves an arm that was built with it, <= 1e-9.
"""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from tests.free_bodies import TARGET
from ves_gym.engine.backends.mujoco import model_spec
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.attitude import to_matrix
from ves_gym.mechanics.vehicle import BENT, BENT_THESIS, FREE_FLOATING
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

BODY = TARGET.inertial
CASES = [
    pytest.param(arm, k, id=f"{arm} {k.kind}", marks=marks)
    for arm, marks in (("puma560", ()), ("puma560-wrist", pytest.mark.slow), ("iiwa14", ()))
    for k in (FREE_FLOATING, BENT_THESIS, BENT)
]


def before_capture(arm: str, vehicle: object, backend: str = "auto") -> Simulator:
    """Two simulations in which arm, base and target move."""
    system = System(arm=get_arm(arm), vehicle=vehicle, payload=TARGET, physics_dt=2.5e-3)
    sim, rng = Simulator(system, 2, backend=backend), np.random.default_rng(3)
    low, high = (system.arm.column(k) for k in ("q_min", "q_max"))
    middle, half = (low + high) / 2, (high - low) / 2
    sim.reset(
        q=middle + 0.4 * half * rng.uniform(-1, 1, sim.joints),
        v=0.3 * rng.normal(size=sim.joints),
        y=0.02 * rng.normal(size=6),
        yd=0.1 * rng.normal(size=6),
    )
    for _ in range(8):
        sim.step(sim.servo_command(sim.state.q, sim.state.v))
    return sim


def jumped(sim: Simulator) -> np.ndarray:
    """Base and joint rates, and the payload's, of simulation 1."""
    state = sim.payload.state
    return np.r_[sim.state.yd[1], sim.state.v[1], state.velocity[1], state.spin[1]]


@pytest.mark.parametrize(("arm", "vehicle"), CASES)
def test_momentum_stays_and_the_energy_lost_is_the_closed_form(arm, vehicle):
    sim = before_capture(arm, vehicle)
    momentum, energy, alone = sim.payload.momentum, np.add(*sim.payload.energy), jumped(sim)
    (event,) = sim.grasp([1])
    change = np.abs(sim.payload.momentum - momentum).max() / np.abs(momentum[1]).max()
    lost = energy - np.add(*sim.payload.energy)
    error = lost[1] / event.lost - 1
    print(f"momentum {change:.1e}, energy lost {error:.1e} of {event.lost:.3g} J")
    assert change <= 1e-10
    assert lost[0] == 0.0  # the neighbour flies on
    assert event.lost > 0.1
    assert lost[1] == pytest.approx(event.lost, rel=1e-9)
    assert np.abs(jumped(sim) - alone).max() > 1e-3
    assert np.abs(sim.payload.relative([1])[0]).max() <= 1e-12


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
@pytest.mark.parametrize(("arm", "vehicle"), CASES)
def test_rates_after_it_are_those_of_mujocos_matrices(arm, vehicle, backend):
    sim = before_capture(arm, vehicle, backend)
    expected = mujoco_impulse(sim)
    sim.grasp([1])
    error = np.abs(jumped(sim) - expected).max()
    print(f"rates {error:.1e}")
    assert error <= 1e-10


def mujoco_impulse(sim: Simulator) -> np.ndarray:
    """What a weld's impulse makes of the rates, by MuJoCo's own M and Jacobians."""
    n, state = sim.joints, sim.payload.state
    spec = with_target(sim.system)
    model = spec.compile()
    data = mujoco.MjData(model)
    modes = sim.system.base.m
    set_state(data, sim, n)
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    tool = data.site("tool").xpos.copy()
    J, row = np.zeros((6, model.nv)), np.zeros((6, model.nv))
    for name, sign in ((f"link_{n}", 1.0), ("target", -1.0)):
        mujoco.mj_jac(model, data, row[:3], row[3:], tool, model.body(name).id)
        J += sign * row
    by = np.linalg.solve(M, J.T)
    after = data.qvel - by @ np.linalg.solve(J @ by, J @ data.qvel)
    yd, v = after[TO_Y], after[6 : 6 + n]
    free = after[6 + n + modes :]  # origin's velocity in space, spin in its own axes
    turn = to_matrix(state.attitude[1])
    velocity = free[:3] + turn @ np.cross(free[3:], BODY.com)
    return np.r_[yd, v, velocity, free[3:]]


def with_target(system: System) -> mujoco.MjSpec:
    """The arm on its base as MuJoCo has it, and the target as a body of its own."""
    spec = model_spec(system.replace(payload=None))
    body = spec.worldbody.add_body(name="target")
    body.add_freejoint()
    weigh(body)
    return spec


def weigh(body: mujoco.MjsBody) -> None:
    """Give a body of a MuJoCo specification the target's mass."""
    body.mass, body.ipos, body.explicitinertial = BODY.mass, BODY.com, True
    I = np.array(BODY.inertia)
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def set_state(data: mujoco.MjData, sim: Simulator, n: int) -> None:
    """State of simulation 1."""
    s, modes, free = sim.state, sim.system.base.m, sim.payload.state
    at, rate = sim.internal_state
    turn = to_matrix(free.attitude[1])
    data.qpos[TO_Y], data.qpos[6 : 6 + n] = s.y[1], s.q[1]
    data.qvel[TO_Y], data.qvel[6 : 6 + n] = s.yd[1], s.v[1]
    data.qpos[6 + n : 6 + n + modes] = at[1]
    data.qvel[6 + n : 6 + n + modes] = rate[1]
    if len(data.qpos) > 6 + n + modes:
        data.qpos[6 + n + modes :] = np.r_[free.position[1], free.attitude[1]]
        origin = free.velocity[1] - turn @ np.cross(free.spin[1], BODY.com)
        data.qvel[6 + n + modes :] = np.r_[origin, free.spin[1]]


@pytest.mark.parametrize("arm", ["puma560", "iiwa14"])
def test_rates_after_it_are_those_of_pinocchios_impulse_dynamics(arm):
    sim = before_capture(arm, FREE_FLOATING)
    n, state, s = sim.joints, sim.payload.state, sim.state
    model = pinocchio_model(sim.system.arm, sim.system.base)
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "target")
    body = pin.Inertia(BODY.mass, np.array(BODY.com), np.array(BODY.inertia))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    model.armature = np.r_[model.armature[: 6 + n], np.zeros(6)]
    turn = to_matrix(state.attitude[1])
    q = np.r_[s.y[1][TO_Y], s.q[1], state.position[1], np.roll(state.attitude[1], -1)]
    origin = turn.T @ state.velocity[1] - np.cross(state.spin[1], BODY.com)
    v = np.r_[s.yd[1][TO_Y], s.v[1], origin, state.spin[1]]
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    at = data.oMf[model.getFrameId("tool")].translation
    shift = pin.SE3(np.eye(3), at).inverse().action  # to twists at the tool, inertial axes
    J = shift @ (
        pin.getJointJacobian(model, data, model.getJointId(f"q_{n}"), pin.WORLD)
        - pin.getJointJacobian(model, data, joint, pin.WORLD)
    )
    after = pin.impulseDynamics(model, data, q, v, J, 0.0, 0.0)
    sim.grasp([1])
    ours = jumped(sim)
    velocity = turn @ (after[6 + n : 9 + n] + np.cross(after[9 + n :], BODY.com))
    theirs = np.r_[after[TO_Y], after[6 : 6 + n], velocity, after[9 + n :]]
    assert np.abs(ours - theirs).max() <= 1e-10


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
@pytest.mark.parametrize(("arm", "vehicle"), [CASES[0], CASES[2], CASES[-2]])
def test_after_it_arm_and_payload_move_as_an_arm_built_with_it(arm, vehicle, backend):
    sim = before_capture(arm, vehicle, backend)
    sim.grasp([1])
    n, cargo, free = sim.joints, sim.payload, sim.payload.state
    spec = model_spec(sim.system.replace(payload=None))
    body = spec.body(f"link_{n}").add_body(name="held")
    far = sim.system.arm.links[-1].far_end
    place, turn = far[1] + far[0] @ cargo.place[1], far[0] @ cargo.turn[1]
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(turn).ravel())
    body.pos, body.quat = place, quat
    weigh(body)
    model = spec.compile()
    data = mujoco.MjData(model)
    for i in range(n):
        model.actuator_biasprm[i, 1:3] = -np.array([sim.servo.kp[i], sim.servo.kd[i]])
    set_state(data, sim, n)
    command = sim.servo_command(sim.state.q, np.zeros_like(sim.state.q))
    data.act[:] = command[1]
    for _ in range(20):
        sim.step(command)
        mujoco.mj_step(model, data, sim.system.substeps)
    mujoco.mj_forward(model, data)
    s, moved = sim.state, sim.payload.state
    errors = (
        s.q[1] - data.qpos[6 : 6 + n],
        s.y[1] - data.qpos[TO_Y],
        moved.position[1] - data.body("held").xpos,
    )
    error = max(np.abs(k).max() for k in errors)
    print(f"{backend}: {error:.1e}")
    assert error <= 1e-9
    assert np.abs(moved.position[1] - free.position[1]).max() > 1e-3


def test_in_some_directions_only_their_relative_motion_goes():
    sim = before_capture("puma560-wrist", FREE_FLOATING)
    momentum, energy = sim.payload.momentum, np.add(*sim.payload.energy)
    relative = sim.payload.relative([1])[0]
    (event,) = sim.grasp([1], directions=["x", "y", "z"])
    after = sim.payload.relative([1])[0]
    assert np.abs(after[:3]).max() <= 1e-12
    assert np.abs(after[3:] - relative[3:]).max() > 1e-4  # it still turns in the grasp
    assert not sim.payload.carried.any()
    assert np.abs(sim.payload.momentum - momentum).max() <= 1e-10 * np.abs(momentum).max()
    lost = energy[1] - np.add(*sim.payload.energy)[1]
    assert lost == pytest.approx(event.lost, rel=1e-9)
    whole = before_capture("puma560-wrist", FREE_FLOATING)
    assert whole.grasp([1])[0].lost > event.lost
