"""Claim: a base's internal modes are in every engine, energy and linear model alike.

The kernel and MuJoCo integrate arm, interface and modes; compared state by state with
Pinocchio (rigid bodies of the arm on its six base joints) and the modal matrices as stated,

    (H_pin + M) a + h_pin = -K Y - D_YY Y' - D_Yu u' + P omega^2 (u - P^T Y) + applied,
    u'' = -omega^2 (u - P^T Y) - D_uY Y' - D_uu u',

and, arm locked and motion small, with the matrix exponential of the linear system. The
energy account has the modes' share. Tolerance 1e-9 of the size of each array, as of bases
without modes (`test_simulated_system_is_the_stated_one.py`); a mode left out is seen.
"""

import dataclasses

import mujoco
import numpy as np
import pytest
import scipy.linalg

from tests.arms import pinocchio_terms
from ves_gym.damping.plant import plant_at
from ves_gym.engine.backends.mujoco import compile_model
from ves_gym.engine.kernel.sensitivity import rollout_gradients
from ves_gym.engine.linear import linearise_ideal
from ves_gym.engine.mjcf import TO_Y
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import VEHICLES, MatrixVehicle
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy import base_energy, internal_motion
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

NAMES = ("bent", "straight-horizontal")
STATES = 200
TOLERANCE = 1e-9
MOTION = Motion.straight(np.deg2rad([-40, -20, 0]), np.deg2rad([60, 40, -30]), 1.0)


def system_on(name, **changes):
    return System(vehicle=VEHICLES[name], **changes)


def drawn(system):
    """Random states (Y, q, u) and rates, and torques: (STATES, .) each."""
    rng, m = np.random.default_rng(0), system.base.m
    box = np.r_[np.full(3, 0.3), np.full(3, 0.6), np.full(3, 3.0), np.full(m, 0.3)]
    z, zd = rng.uniform(-1, 1, (2, STATES, 9 + m)) * box
    return z, zd, rng.uniform(-40, 40, (STATES, 3))


def reference(system, z, zd, tau):
    """z'' of every state by Pinocchio and the matrices."""
    base, modes = system.base, system.base.internal
    model = pinocchio_model(system.arm, base)
    data = model.createData()
    order = np.r_[TO_Y, 6:9]  # Pinocchio's coordinates are Z-Y-X as well
    P, w2, C = modes.coupling, modes.omega**2, modes.damping
    out = np.zeros_like(z)
    for k in range(STATES):
        y, u, yd, ud = z[k, :6], z[k, 9:], zd[k, :6], zd[k, 9:]
        H, bias = pinocchio_terms(model, data, z[k, order], zd[k, order])
        H[np.ix_(order, order)], bias[order] = H.copy(), bias.copy()
        lost = C @ np.r_[yd, ud]
        stretch = u - P.T @ y
        force = -base.K @ y - base.D @ yd + P @ (w2 * stretch) - lost[:6]
        H[:6, :6] += base.M
        out[k, :9] = np.linalg.solve(H, np.r_[force, tau[k]] - bias)
        out[k, 9:] = -w2 * stretch - lost[6:]
    return out


def engines(system, z, zd, tau):
    """z'' of every state by MuJoCo, and by the kernel (its own state in place)."""
    model = compile_model(system)
    data, m = mujoco.MjData(model), system.base.m
    order = np.r_[TO_Y, 6 : 9 + m]
    found = np.zeros_like(z)
    for k in range(STATES):
        data.qpos[order], data.qvel[order] = z[k], zd[k]
        data.act[:] = tau[k]
        mujoco.mj_forward(model, data)
        found[k] = data.qacc[order]
    sim = Simulator(system, STATES, servo=None, backend="kernel", warn_at=None)
    sim.reset(q=z[:, 6:9], y=z[:, :6], v=zd[:, 6:9], yd=zd[:, :6])
    for part, values in zip(sim.backend.rows_of_modes(), (z[:, 9:], zd[:, 9:]), strict=True):
        for i in range(STATES):
            part[i // part.shape[-1], :, i % part.shape[-1]] = values[i]
    return found, sim.evaluate(tau)[1]


def error(found, true):
    return float((np.abs(found - true).max(axis=1) / np.abs(true).max(axis=1)).max())


@pytest.mark.parametrize("name", NAMES)
def test_engines_agree_with_pinocchio_and_the_modal_matrices(name):
    system = system_on(name)
    states = drawn(system)
    true = reference(system, *states)
    by_mujoco, base_by_kernel = engines(system, *states)
    assert error(by_mujoco, true) <= TOLERANCE
    assert error(base_by_kernel, true[:, :6]) <= TOLERANCE


def test_a_mode_of_another_frequency_is_seen():
    system = system_on("bent")
    states = drawn(system)
    modes = system.base.internal
    other = dataclasses.replace(modes, omega=modes.omega * (1 + 1e-6))
    base = dataclasses.replace(system.base, internal=other)
    changed = system_on("bent")
    changed.__dict__["base"] = base
    by_mujoco, _ = engines(system, *states)
    assert error(by_mujoco, reference(changed, *states)) > 10 * TOLERANCE


@pytest.mark.parametrize("name", NAMES)
def test_both_engines_play_the_same_run(name):
    system = system_on(name)
    a, b = (
        play_motions(system, [MOTION], settle=1.0, backend=backend)
        for backend in ("kernel", "mujoco")
    )
    for part in ("q", "y", "yd", "u", "ud", "tau", "w"):
        mine, theirs = getattr(a, part), getattr(b, part)
        assert np.abs(mine - theirs).max() <= TOLERANCE * np.abs(theirs).max(), part


@pytest.mark.parametrize("name", NAMES)
def test_small_motion_of_a_locked_arm_is_the_linear_one(name):
    # a step in which even the fastest mode turns by a tenth of a radian
    system = system_on(name, drive="prescribed", physics_dt=3.125e-4)
    M, D, K = system.base.full()
    M[:6, :6] += inertia(system.arm, np.zeros(3))[:6, :6]
    size = len(M)
    A = np.zeros((2 * size, 2 * size))
    A[:size, size:] = np.eye(size)
    A[size:] = np.linalg.solve(M, np.hstack([-K, -D]))
    y = 1e-5 * np.array([1.0, -2.0, 1.5, 0.3, 0.2, -0.1])
    sim = Simulator(system, warn_at=None)
    sim.reset(y=y)
    start = np.r_[y, system.base.attached(y), np.zeros(size)]
    for k in range(1, 81):
        sim.step(np.zeros(3))
        want = scipy.linalg.expm(A * k * system.control_dt) @ start
        assert np.abs(sim.state.y[0] - want[:6]).max() <= 1e-4 * np.abs(y).max()
    u = sim.base_modes[0][0]
    assert np.abs(u - want[6:size]).max() <= 1e-3 * np.abs(system.base.attached(y)).max()


@pytest.mark.parametrize("name", NAMES)
def test_the_account_closes_with_the_modes_in_it(name, tmp_path):
    system = system_on(name)
    log = play_motions(system, [MOTION], settle=2.0, record_dt=system.physics_dt).log(0)
    assert EnergyBalance.of(log).relative <= 1e-5  # 1e-3 promised of any base
    log.save(tmp_path / "run.csv")
    assert RunLog.load(tmp_path / "run.csv").digest == log.digest
    with_rest = dataclasses.replace(log, u=0 * log.u, ud=0 * log.ud)
    assert EnergyBalance.of(with_rest).relative > 1e-3  # modes said to rest: it is seen


def test_modes_are_estimated_where_a_log_has_none():
    system = system_on("bent")
    log = play_motions(system, [MOTION], settle=5.0).log(0)
    u, ud = internal_motion(system.base, log.t, log.y, log.yd)
    total = base_energy(system, log.q, log.y, log.yd, (log.u, log.ud)).total
    estimated = base_energy(system, log.q, log.y, log.yd, (u, ud)).total
    assert np.abs(estimated - total).max() <= 0.01 * total.max()


def test_the_laboratory_moves_as_the_flexible_base_would():
    energies = [
        play_motions(system_on("bent", mode=mode), [MOTION]).energies()[0].E_mean
        for mode in ("ideal", "emulated")
    ]
    # 10 % measured, 3 % on the thesis's base, whose tip is ten times as heavy
    assert energies[1] == pytest.approx(energies[0], rel=0.15)


def test_the_linear_model_has_the_modes():
    system = system_on("bent")
    found = linearise_ideal(system, np.zeros(3), servo=HIGH_GAINS)
    H = inertia(system.arm, np.zeros(3))
    M, D, K = system.base.full()
    b, n = len(M), 3
    at = np.r_[:6, 9 : 9 + b - 6]
    full = np.zeros((3, b + n, b + n))
    for part, block in zip(full, (M, D, K), strict=True):
        part[np.ix_(at, at)] = block
    full[0][:9, :9] += H
    full[1][6:9, 6:9], full[2][6:9, 6:9] = np.diag(HIGH_GAINS.kd), np.diag(HIGH_GAINS.kp)
    companion = np.block(
        [
            [np.zeros((b + n, b + n)), np.eye(b + n)],
            [-np.linalg.solve(full[0], full[2]), -np.linalg.solve(full[0], full[1])],
        ]
    )
    assert np.abs(found.A - companion).max() <= 1e-9 * np.abs(companion).max()
    plant = plant_at(system, np.zeros(3))
    K = plant.K  # its internal modes let go: what the interface feels at rest
    static = K[:6, :6] - K[:6, 6:] @ np.linalg.solve(K[6:, 6:], K[6:, :6])
    np.testing.assert_allclose(plant.stiffness, static, rtol=1e-9, atol=1e-6)
    x = plant.start(np.r_[0.1, np.zeros(5)])
    assert x @ plant.strain @ x == pytest.approx(0.5 * 0.01 * system.base.K[0, 0], rel=1e-9)


def test_derivatives_know_the_modes():
    """Along a command, against central differences of the same rollout."""
    system = system_on("bent")
    rng = np.random.default_rng(3)
    commands = rng.uniform(-5, 5, (1, 41, 3))
    way = rng.uniform(-1, 1, (1, 41, 1, 3))
    exact = rollout_gradients(system, commands, along=way)
    step = 1e-4
    ends = [
        rollout_gradients(system, commands + sign * step * way[:, :, 0]) for sign in (1, -1)
    ]
    slope = (ends[0].energy - ends[1].energy) / (2 * step)
    np.testing.assert_allclose(exact.denergy[:, 0], slope, rtol=1e-6)
    change = (ends[0].x - ends[1].x) / (2 * step)
    assert np.abs(exact.dx[:, 0] - change).max() <= 1e-6 * np.abs(change).max()


def test_numbers_that_do_not_fit_together_are_refused():
    plain = VEHICLES["decoupled"]
    with pytest.raises(ValueError, match=r"coupling .* \(6, 2\)"):
        MatrixVehicle(M=plain.M, D=plain.D, K=plain.K, omega=(1.0, 2.0), coupling=((1.0,),) * 6)
    with pytest.raises(ValueError, match="omega must be given"):
        MatrixVehicle(M=plain.M, D=plain.D, K=plain.K, coupling=((1.0,),) * 6)
