"""Claim: what the engine integrates is the stated system, arm + M, D, K.

Compared with Pinocchio (rigid bodies of arm and satellite) plus the vehicle's matrices:

    (H_pin + M) a + h_pin = -D Y' - K Y + applied,

and, for the kinematics both models are built from, with the homogeneous transformations
printed in thesis B.3. Our own vectorised `inertia` and `inverse_dynamics` are compared
with `crba` and `rnea` too.

Tolerance: 1e-9 of the size of each array, state by state. Both sides are double precision
with a condition number of about 1e6; the smallest modelling error we care about (1e-5 of
a link's mass) is at least ten times larger, and a test shows that it is seen.
"""

import dataclasses

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from tests.arms import heavier, pinocchio_terms
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.spatial import rate_matrix
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES, MatrixVehicle, Satellite
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

STATES = 1000
TOLERANCE = 1e-9


def full_matrices() -> MatrixVehicle:
    """M, D, K that couple every pair of coordinates."""
    roots = np.random.default_rng(1).normal(size=(3, 6, 6))
    sizes = zip((80.0, 60.0, 900.0), roots, strict=True)
    M, D, K = (matrix(size * (root @ root.T + np.eye(6))) for size, root in sizes)
    return MatrixVehicle(M=M, D=D, K=K, source="test")


def lopsided_satellite() -> Satellite:
    """Products of inertia and an off-axis centre of mass."""
    moments = matrix(np.array([[120.0, 9, -7], [9, 150, 11], [-7, 11, 90]]))
    return Satellite(body=Inertial(mass=321.0, com=(0.2, -0.3, -0.7), inertia=moments))


# tests/claims/test_satellites_that_act.py
ACTING = ("free-flying", "servicer", "servicer-flexible")
CASES = {
    **{name: VEHICLES[name] for name in VEHICLES if name not in ACTING},
    "bent-consistent": dataclasses.replace(VEHICLES["bent-thesis"], mass_model="consistent"),
    "full-matrices": full_matrices(),
    "lopsided-satellite": lopsided_satellite(),
}


@dataclasses.dataclass
class States:
    """Random states and loads, in the engine's coordinate order."""

    z: np.ndarray  # (N, 9 + m) [m, rad], a base's internal modes last
    zd: np.ndarray
    load: np.ndarray  # (N, 9 + m) applied generalised force [N, N m]


def draw(seed: int, modes: int = 0) -> States:
    """Base within 0.3 m and 0.6 rad, joints anywhere, rates up to 1 m/s and 2 rad/s.

    Internal modes within 3 kg^(1/2) m, no load on them.
    """
    rng = np.random.default_rng(seed)
    box = np.r_[0.3, 0.3, 0.3, 0.6, 0.6, 0.6, 3.0, 3.0, 3.0]
    rates = np.r_[np.ones(3), 2 * np.ones(6)]
    loads = np.r_[100 * np.ones(6), 80 * np.ones(3)]
    z, zd, load = rng.uniform(-1, 1, (3, STATES, 9))
    u, ud = rng.uniform(-3, 3, (2, STATES, modes))
    return States(
        np.hstack([z * box, u]),
        np.hstack([zd * rates, ud]),
        np.hstack([load * loads, np.zeros((STATES, modes))]),
    )


def engine(model: mujoco.MjModel, s: States) -> dict[str, np.ndarray]:
    """Inertia, bias, passive force and acceleration as MuJoCo computes them."""
    data = mujoco.MjData(model)
    size = s.z.shape[1]
    out = {"inertia": np.zeros((STATES, size, size))}
    out |= {name: np.zeros((STATES, size)) for name in ("bias", "passive", "acceleration")}
    for k in range(STATES):
        data.qpos[:], data.qvel[:] = s.z[k], s.zd[k]
        data.qfrc_applied[:6] = s.load[k, :6]
        data.act[:] = s.load[k, 6:9]  # the drives' torque, inside their range
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, out["inertia"][k])
        out["bias"][k] = data.qfrc_bias
        out["passive"][k] = data.qfrc_passive
        out["acceleration"][k] = data.qacc
    return out


def reference(system: System, s: States) -> dict[str, np.ndarray]:
    """The same from Pinocchio and the vehicle's M, D, K."""
    model = pinocchio_model(system.arm, system.base)
    data = model.createData()
    base, size = system.base, s.z.shape[1]
    at = np.r_[:6, 9:size]  # of what the base is described in, in the engine's order
    order = np.r_[TO_Y, 6 : len(at)]
    rigid = np.zeros((len(at),) * 2)  # Pinocchio has a satellite's body
    rigid[:6, :6] = 0.0 if base.body is None else base.body.spatial()
    M, D, K = (np.zeros((size, size)) for _ in range(3))
    stated = base.full()
    for padded, matrix_ in zip((M, D, K), (stated[0] - rigid, *stated[1:]), strict=True):
        padded[np.ix_(at, at)] = matrix_[np.ix_(order, order)]
    out = {"inertia": np.zeros((STATES, size, size)), "bias": np.zeros((STATES, size))}
    for k in range(STATES):
        H, out["bias"][k, :9] = pinocchio_terms(model, data, s.z[k, :9], s.zd[k, :9])
        out["inertia"][k] = M
        out["inertia"][k, :9, :9] += H
    out["passive"] = -s.z @ K - s.zd @ D
    force = s.load + out["passive"] - out["bias"]
    out["acceleration"] = np.linalg.solve(out["inertia"], force[..., None])[..., 0]
    return out


def largest_error(found: np.ndarray, true: np.ndarray) -> float:
    """Largest difference over the states, each relative to the size of the true array."""
    axes = tuple(range(1, true.ndim))
    size = np.abs(true).max(axis=axes)
    gap = np.abs(found - true).max(axis=axes)
    return float((gap / np.where(size > 0, size, 1.0)).max())


@pytest.mark.parametrize("name", CASES)
def test_engine_agrees_with_pinocchio(name):
    system = System(vehicle=CASES[name])
    states = draw(0, system.base.m)
    found, true = engine(compile_model(system), states), reference(system, states)
    errors = {key: largest_error(found[key], true[key]) for key in true}
    assert max(errors.values()) <= TOLERANCE, errors


def test_a_wrong_mass_is_seen():
    """One link heavier by 1e-5: the comparison above must fail on it."""
    system = System(vehicle=BENT_THESIS)
    states = draw(0)
    model = compile_model(heavier(system, 1 + 1e-5))
    found, true = engine(model, states), reference(system, states)
    for key in ("inertia", "bias", "acceleration"):
        assert largest_error(found[key], true[key]) > 10 * TOLERANCE, key


@pytest.mark.parametrize("name", ["bent-thesis", "full-matrices", "lopsided-satellite"])
def test_backend_agrees_with_pinocchio(name):
    """What `Simulator` reports: Y order, the drive's torque, the base's acceleration."""
    system = System(vehicle=CASES[name])
    s = draw(2)
    s.load[:, :6] = 0.0
    order = np.r_[TO_Y, 6, 7, 8]
    sim = Simulator(system, STATES, servo=None)
    sim.reset(q=s.z[:, 6:], v=s.zd[:, 6:], y=s.z[:, order[:6]], yd=s.zd[:, order[:6]])
    torque, ydd = sim.evaluate(s.load[:, 6:])
    true = reference(system, s)["acceleration"][:, TO_Y]
    assert largest_error(torque, s.load[:, 6:]) <= TOLERANCE
    assert largest_error(ydd, true) <= TOLERANCE


def test_prescribed_drive_gives_the_commanded_acceleration():
    """Tolerance 1e-6 rad/s^2: 1e4 N m over MuJoCo's armature of 1e10 kg m^2."""
    system = System(vehicle=BENT_THESIS, drive="prescribed")
    s = draw(3)
    model = compile_model(system)
    command = s.load[:, 6:] / 10  # rad/s^2
    found = engine(model, dataclasses.replace(s, load=np.hstack([s.load[:, :6], command])))
    assert np.abs(found["acceleration"][:, 6:] - command).max() <= 1e-6


def test_vectorised_dynamics_agree_with_pinocchio():
    """`inertia` at any base pose, and `inverse_dynamics` on a base that stands still."""
    base = System(vehicle=VEHICLES["free-floating"]).base
    base = dataclasses.replace(base, body=None)
    model = pinocchio_model(PUMA_560, base)
    model.gravity.linear[:] = 1.0, -2.0, -9.0
    data = model.createData()
    s = draw(4)
    y, q = s.z[:, TO_Y], s.z[:, 6:]

    T = np.zeros((STATES, 9, 9))
    T[:, :6, :6] = rate_matrix(y)
    T[:, 6:, 6:] = np.eye(3)
    ours = np.swapaxes(T, -1, -2) @ inertia(PUMA_560, q) @ T
    order = np.r_[TO_Y, 6, 7, 8]
    theirs, tau, wrench = np.zeros_like(ours), np.zeros((STATES, 3)), np.zeros((STATES, 6))
    zero = np.zeros(6)
    for k in range(STATES):
        H, _ = pinocchio_terms(model, data, s.z[k], s.zd[k])
        theirs[k] = H[np.ix_(order, order)]
        motion = (np.r_[zero, part] for part in (q[k], s.zd[k, 6:], s.load[k, 6:]))
        force = pin.rnea(model, data, *motion)
        tau[k], wrench[k] = force[6:], -force[TO_Y]
    assert largest_error(ours, theirs) <= TOLERANCE

    found = inverse_dynamics(PUMA_560, q, s.zd[:, 6:], s.load[:, 6:], (1.0, -2.0, -9.0))
    assert largest_error(found[0], tau) <= TOLERANCE
    assert largest_error(found[1], wrench) <= TOLERANCE


def thesis_transforms(q: np.ndarray) -> list[np.ndarray]:
    """Thesis B.3 as printed (d3 = 0.098): frames 1, 2, 3 in the platform-top frame."""
    d0, d1, d2, d3, a2, a3 = 0.22844, 0.672, -0.2435, 0.098, 0.4318, 0.4331
    (c1, c2, _), (s1, s2, _) = np.cos(q), np.sin(q)
    c23, s23 = np.cos(q[1] + q[2]), np.sin(q[1] + q[2])
    a, b, c = a2 * c1 * c2 + d2 * s1, a2 * s1 * c2 - d2 * c1, a2 * s2 + d0 + d1
    last = [0, 0, 0, 1]
    x, y, z = a3 * c1 * c23 + d3 * s1 + a, a3 * s1 * c23 - d3 * c1 + b, a3 * s23 + c
    rows = [
        [[c1, 0, s1, 0], [s1, 0, -c1, 0], [0, 1, 0, d0 + d1], last],
        [[c1 * c2, -c1 * s2, s1, a], [s1 * c2, -s1 * s2, -c1, b], [s2, c2, 0, c], last],
        [[c1 * c23, -c1 * s23, s1, x], [s1 * c23, -s1 * s23, -c1, y], [s23, c23, 0, z], last],
    ]
    return [np.array(k) for k in rows]


def test_kinematics_are_the_thesis_transformations():
    """Tool and links of both engines, and of ours, against the printed matrices: 1e-12 m."""
    system = System(vehicle=BENT_THESIS)
    model = compile_model(system)
    data = mujoco.MjData(model)
    pin_model = pinocchio_model(system.arm, system.base)
    pin_data = pin_model.createData()
    tool = pin_model.getFrameId("tool")
    for q in np.random.default_rng(5).uniform(-3, 3, (50, 3)):
        printed = thesis_transforms(q)
        ours = joint_positions(system.arm, q)
        for k in range(3):
            assert np.abs(ours[k + 1] - printed[k][:3, 3]).max() <= 1e-12
        data.qpos[:] = np.r_[np.zeros(6), q]
        mujoco.mj_kinematics(model, data)
        assert np.abs(data.site("tool").xpos - printed[2][:3, 3]).max() <= 1e-12
        assert np.abs(data.site("tool").xmat.reshape(3, 3) - printed[2][:3, :3]).max() <= 1e-12
        pin.framesForwardKinematics(pin_model, pin_data, np.r_[np.zeros(6), q])
        assert np.abs(pin_data.oMf[tool].homogeneous - printed[2]).max() <= 1e-12
