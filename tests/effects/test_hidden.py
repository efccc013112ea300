"""Effects with states of their own: gears that give way, a mode nobody described."""

import numpy as np
import pytest
import scipy

from tests.effects.values import effect
from tests.free_bodies import momentum_of
from ves_gym._util.params import ParameterError
from ves_gym.effects import BaseExtraMode, JointBacklash, JointElasticity
from ves_gym.engine.linear import linearise_ideal
from ves_gym.hardware.admittance import admittance_matrices
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia, inverse_dynamics
from ves_gym.mechanics.gravity import GRAVITY
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.spatial import twist
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
)
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.stability import linearise
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

BACKENDS = ("kernel", "mujoco")
HIDDEN = ("joint/elasticity", "joint/backlash", "base/extra_mode")
STILL = EmulatorSettings(operation="position", joint_balance=False)
SWING = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 1.0)


def soft(c, d=0.0, joint=2):
    """One elastic joint."""
    compliance, damping = np.zeros(3), np.full(3, d)
    compliance[joint] = c
    return JointElasticity(compliance=compliance, damping=damping)


def on_a_still_platform(effects, emulator=STILL):
    still = {"mode": "emulated", "emulator": emulator, "drive": "prescribed"}
    return System(vehicle=BENT_THESIS, effects=effects, **still)


def frequency(x, dt):
    """Of a sampled sine without a mean: x+ + x- = 2 cos(w dt) x [rad/s]."""
    x = x - x.mean()
    c = (x[1:-1] @ (x[2:] + x[:-2])) / (x[1:-1] @ x[1:-1]) / 2
    return np.arccos(c) / dt


# --------------------------------------------------------------------------- elasticity


def test_a_link_swings_on_its_gear():
    """Rotor held, platform still: w^2 = stiffness / inertia of the link about its joint."""
    c = 1e-4
    system = on_a_still_platform((soft(c),), EmulatorSettings(operation="position"))
    sim = Simulator(system, warn_at=None)
    for accel in (1.0, -1.0):
        sim.step([0.0, 0.0, accel])
    path = []
    for _ in range(400):
        sim.play(np.zeros((1, 11, 3)))
        path.append(sim.internal_state[0][0, 0])
    path = np.array(path)
    q = sim.state.q[0]
    np.testing.assert_allclose(sim.state.v[0], 0, atol=1e-5)
    link = inertia(PUMA_560, q)[8, 8] - PUMA_560.links[2].rotor_inertia
    want = np.sqrt(1 / c / link)
    assert frequency(path, system.control_dt) == pytest.approx(want, rel=2e-3)


def test_a_gear_sags_by_compliance_times_torque():
    c, q = 1e-4, np.array([0.0, 0.3, -0.2])
    effects = (JointElasticity(compliance=(0.0, c, c), damping=(0.0, 60.0, 60.0)),)
    system = on_a_still_platform(effects)
    sim = Simulator(system, warn_at=None)
    sim.reset(q=q)
    for _ in range(200):
        sim.step(0.0)
    sag = sim.internal_state[0][0]
    bent = q + np.r_[0.0, sag]
    weight = inverse_dynamics(PUMA_560, bent, 0 * q, 0 * q, gravity=(0.0, 0.0, -GRAVITY))[0]
    np.testing.assert_allclose(sag, -c * weight[1:], rtol=1e-4)


def test_engines_agree_on_everything_hidden():
    effects = tuple(map(effect, HIDDEN))
    system = System(vehicle=FREE_FLOATING, effects=effects)
    runs = [play_motions(system, [SWING], settle=0.5, backend=k) for k in BACKENDS]
    for name in ("q", "y", "w"):
        a, b = (getattr(run, name) for run in runs)
        assert np.abs(a - b).max() < 1e-5 * np.abs(a).max(), name


def test_the_wrench_recorded_is_the_arms():
    """In space: what the arm gives the vehicle, whatever else that carries."""
    extra = BaseExtraMode(mass=1e-3, frequency=3.0)
    runs = [
        play_motions(System(vehicle=BENT_THESIS, effects=k), [SWING], settle=0.2)
        for k in ((), (extra,))
    ]
    np.testing.assert_allclose(runs[0].w, runs[1].w, atol=1e-3 * np.abs(runs[0].w).max())


# ----------------------------------------------------------------------------- backlash


def test_width_of_the_play():
    """A link hanging over to one side, then to the other: gap + 2 compliance torque apart."""
    gap, c, at = 0.02, 2e-5, []
    play = JointBacklash(gap=(0.0, 0.0, gap), compliance=c, damping=20.0)
    system = on_a_still_platform((play,))
    for turn in (0.0, np.pi):  # about joint 2: joint 3's load changes sign
        q = np.array([0.0, turn, 0.0])
        sim = Simulator(system, warn_at=None)
        sim.reset(q=q)
        for _ in range(400):
            sim.step(0.0)
        bent = q + np.r_[0, 0, sim.internal_state[0][0]]
        weight = inverse_dynamics(PUMA_560, bent, 0 * q, 0 * q, gravity=(0, 0, -GRAVITY))[0]
        at.append(sim.internal_state[0][0, 0])
        assert at[-1] == pytest.approx(-np.sign(weight[2]) * gap / 2 - c * weight[2], rel=1e-3)
    assert abs(at[0] - at[1]) > gap


def test_within_the_play_the_link_is_free():
    """No torque passes while the deflection stays inside: the rotor moves alone."""
    play = JointBacklash(gap=(0.0, 0.0, 0.1), damping=0.0)
    emulator = EmulatorSettings(operation="position")
    system = System(vehicle=BENT_THESIS, mode="emulated", emulator=emulator, effects=(play,))
    sim = Simulator(system, servo=None, warn_at=None)
    sim.step([0.0, 0.0, 1.0])
    rotor = PUMA_560.links[2].rotor_inertia
    want = 0.5 / rotor * system.control_dt**2
    assert sim.state.q[0, 2] == pytest.approx(want, rel=1e-9)
    np.testing.assert_allclose(sim.state.q[0, 2] + sim.internal_state[0][0, 0], 0, atol=1e-12)


# --------------------------------------------------------------------------- extra mode

EXTRA = BaseExtraMode(mass=200.0, frequency=0.3, damping_ratio=0.05, direction=(1.0, 0.0, 1.0))


def reference(system, y, t):
    """(N, 6) of vehicle, locked arm and oscillator, linear, by the matrix exponential."""
    base = system.actual.base
    M, D, K = base.full()
    M[:6, :6] += inertia(system.arm, np.zeros(3))[:6, :6]
    size = len(M)
    A = np.zeros((2 * size, 2 * size))
    A[:size, size:] = np.eye(size)
    A[size:] = np.linalg.solve(M, np.hstack([-K, -D]))
    x = np.r_[y, base.attached(y), np.zeros(size)]
    step = scipy.linalg.expm(A * (t[1] - t[0]))
    out = [x]
    for _ in t[1:]:
        out.append(step @ out[-1])
    return np.array(out)[:, :6]


@pytest.mark.parametrize(("mode", "tolerance"), [("ideal", 1e-3), ("emulated", 0.05)])
def test_motion_with_an_extra_mode(mode, tolerance):
    """Closed form for small motion; the laboratory within what its emulation leaves."""
    system = System(mode=mode, vehicle=DECOUPLED, drive="prescribed", effects=(EXTRA,))
    y = np.array([1e-3, 0.0, 5e-4, 0.0, 0.0, 0.0])
    sim = Simulator(system, warn_at=None)
    sim.reset(y=y)
    path = [sim.state.y[0]]
    for _ in range(240):
        sim.step(0.0)
        path.append(sim.state.y[0])
    t = np.arange(241) * system.control_dt
    want = reference(system, y, t)
    assert np.abs(np.array(path) - want).max() < tolerance * np.abs(want).max()
    plain = reference(system.replace(effects=()), y, t)
    assert np.abs(plain - want).max() > 0.1 * np.abs(want).max()


def test_a_satellite_and_what_rides_on_it_keep_their_momentum():
    """Nothing pushes from outside: bodies along one way, the rider along the other."""
    system = System(vehicle=FREE_FLOATING, drive="prescribed", effects=(EXTRA,))
    way = np.array(system.actual.vehicle.extra[0].direction)
    sim = Simulator(system, warn_at=None)
    bodies, rider = [], []
    for _ in range(100):
        sim.step([0.5, 1.0, -1.0])
        now = sim.state
        mass = inertia(system.arm, now.q[0])
        mass[:6, :6] += system.base.rigid()
        rates = np.r_[twist(now.y[0], now.yd[0]), now.v[0]]
        bodies.append(momentum_of(mass, rates, now.y[0])[:3])
        rider.append(np.sqrt(EXTRA.mass) * sim.internal_state[1][0, 0] * way)
    assert np.abs(rider).max() > 0.1
    assert np.abs(np.add(bodies, rider)).max() < 1e-6 * np.abs(rider).max()


def test_the_admittance_is_sampled_exactly():
    """Without compensation: the eigenvalues of the wider vehicle, whatever the form."""
    base = System(vehicle=DECOUPLED, effects=(EXTRA,)).actual.base
    M, D, K = base.full()
    A = np.block(
        [[np.zeros((7, 7)), np.eye(7)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]]
    )
    want = np.sort_complex(np.exp(np.linalg.eigvals(A) * 0.01))
    for form in ("coupled", "beam", "decoupled"):
        phi, gamma = admittance_matrices(base, 0.01, form)
        assert gamma.shape == (14, 6)
        np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(phi)), want, atol=1e-12)


def test_the_gears_are_in_the_loop_that_is_judged():
    """The linearised loop has the link's swing on its gear, at the frequency it has."""
    c = 3e-4
    system = System(mode="emulated", vehicle=DECOUPLED, drive="prescribed", effects=(soft(c),))
    z = np.linalg.eigvals(linearise(system).A)
    link = inertia(PUMA_560, np.zeros(3))[8, 8] - PUMA_560.links[2].rotor_inertia
    want = np.sqrt(1 / c / link)
    rates = np.abs(np.log(z[np.abs(z) > 0.5])) / system.control_dt
    assert np.abs(rates / want - 1).min() < 0.02
    sim = Simulator(system, 2, warn_at=None)
    sim.backend.set_gear_state(np.array([[0.01], [0.02]]), np.array([[0.3], [0.4]]))
    np.testing.assert_array_equal(np.hstack(sim.internal_state), [[0.01, 0.3], [0.02, 0.4]])


# ------------------------------------------------------------------------------ refused


def test_gears_are_the_same_joints_in_all_simulations():
    sim = Simulator(System(vehicle=BENT_THESIS, effects=(soft(1e-4),)))
    with pytest.raises(
        ParameterError, match=r"whose gears give way must be .* \[3\], got \[2\]"
    ):
        sim.assign([System(vehicle=BENT_THESIS, effects=(soft(1e-4, joint=1),))])
    with pytest.raises(
        ParameterError, match=r"give way must be the simulator's \[3\], got none"
    ):
        sim.assign([System(vehicle=BENT_THESIS, effects=(soft(0.0),))])
    sim = Simulator(System(vehicle=BENT_THESIS, effects=(EXTRA,)))
    with pytest.raises(ParameterError, match=r"internal modes must be .* 1, got 0"):
        sim.assign([System(vehicle=BENT_THESIS, effects=(BaseExtraMode(),))])


def test_a_gear_too_stiff_for_the_step_is_refused():
    with pytest.raises(ParameterError, match=r"physics_dt must be <= .* fastest motion"):
        Simulator(System(vehicle=BENT_THESIS, mode="emulated", effects=(soft(1e-8),)))


def test_what_knows_nothing_of_hidden_states_says_so():
    elastic = System(vehicle=BENT_THESIS, effects=(soft(1e-4),))
    with pytest.raises(ParameterError, match="derivatives know no gears"):
        linearise_ideal(elastic)
    run = play_motions(elastic, [SWING], settle=0.1)
    with pytest.raises(ParameterError, match="energy balance knows no gears"):
        EnergyBalance.of(run.log(0))
    with pytest.raises(ParameterError, match="implicitfast: use backend mujoco"):
        Simulator(elastic.replace(integrator="implicitfast"), backend="kernel")
    Simulator(elastic.replace(integrator="implicitfast"), backend="mujoco").step(0.0)


def test_bad_numbers():
    with pytest.raises(ParameterError, match="on a satellite in mode ideal, got mode emulated"):
        System(mode="emulated", vehicle=FREE_FLOATING, effects=(EXTRA,))
    carrying = System(vehicle=FREE_FLOATING, effects=(EXTRA,)).actual
    with pytest.raises(ParameterError, match="a satellite's body, not its extra"):
        System(mode="emulated", vehicle=carrying.vehicle)
    nowhere = BaseExtraMode(mass=1.0, direction=(0.0, 0.0, 0.0))
    with pytest.raises(ParameterError, match="direction must not be zero"):
        System(vehicle=BENT_THESIS, effects=(nowhere,))


def test_a_snapshot_keeps_what_is_hidden():
    effects = tuple(map(effect, HIDDEN))
    for mode in ("ideal", "emulated"):
        sim = Simulator(System(mode=mode, vehicle=DECOUPLED, effects=effects), warn_at=None)
        sim.step(5.0)
        kept, ends = sim.snapshot(), []
        for _ in range(2):
            sim.restore(kept)
            sim.step(-5.0)
            ends.append((*sim.state, *sim.internal_state))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(*ends, strict=True))
