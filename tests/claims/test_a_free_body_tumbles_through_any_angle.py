"""Claim: a free body tumbles through any angle, and its path is that of a torque-free body.

Reference: angular velocity by Jacobi's elliptic functions, attitude by integrating a quaternion
under it (SciPy), the centre of mass on a straight line. Nothing of our dynamics is used.
"""

import numpy as np
import pytest

from tests.free_bodies import NO_ARM, free_attitude, free_body
from ves_gym.mechanics import attitude
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.spatial import twist
from ves_gym.mechanics.vehicle import FREE_FLOATING, Satellite
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

MOMENTS = np.array([90.0, 60.0, 40.0])  # about the principal axes of the closed form
TO_BODY = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # whose first is the base's y
COM = np.array([0.2, -0.1, -0.6])
BODY = Satellite(body=Inertial(mass=300.0, com=tuple(COM), inertia=diagonal(40.0, 90.0, 60.0)))
PRINCIPAL = np.array([1.0, 0.1, -0.6])  # rad/s: far from any principal axis
SPIN = TO_BODY @ PRINCIPAL
DRIFT = np.array([0.02, -0.01, 0.03])  # m/s of the centre of mass
TURNS = 10


def start():
    """Pose and rate of the base for SPIN and DRIFT, turned by 0.3 rad to begin with."""
    y = np.array([0.0, 0.0, 0.0, 0.3, -0.2, 0.4])
    R = attitude.to_matrix(attitude.from_angles(y[3:]))
    speed = DRIFT - R @ np.cross(SPIN, COM)
    return y, np.r_[speed, attitude.angle_rates(y[3:], SPIN)]


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
def test_ten_turns_of_a_tumbling_base(backend):
    """Worst error of attitude, angular velocity and place over ten turns: <= 1e-8."""
    y, yd = start()
    time = np.linspace(0, TURNS * 2 * np.pi / np.linalg.norm(SPIN), 41)
    system = System(arm=NO_ARM, vehicle=BODY, control_dt=0.0125)
    sim = Simulator(system, backend=backend)
    state = sim.reset(y=y, yd=yd)
    times, quaternions, spins, places, pitches = [], [], [], [], []
    for k in range(round(time[-1] / system.control_dt)):
        state = sim.step()
        pitches.append(state.y[0, 4])
        if k % 100 == 0:
            times.append(state.time[0])
            quaternions.append(state.attitude[0])
            spins.append(state.spin[0])
            places.append(state.y[0, :3] + attitude.rotate(state.attitude[0], COM))
    times = np.array(times)
    to_body = attitude.from_matrix(TO_BODY)
    q = attitude.product(attitude.from_angles(y[3:]), to_body)
    q = free_attitude(MOMENTS, PRINCIPAL, q, np.r_[0, times])[1:]
    measured = attitude.product(np.array(quaternions), to_body)
    apart = np.linalg.norm(attitude.difference(q, measured), axis=1).max()
    faster = np.abs(np.array(spins) - free_body(MOMENTS, PRINCIPAL, times) @ TO_BODY.T).max()
    first = y[:3] + attitude.rotate(attitude.from_angles(y[3:]), COM)
    away = np.abs(np.array(places) - first - DRIFT * times[:, None]).max()
    print(f"{backend}: {apart:.1e} rad, {faster:.1e} rad/s, {away:.1e} m in {times[-1]:.0f} s")
    assert max(np.abs(pitches)) > np.deg2rad(80)  # through where Z-Y-X angles end
    assert apart <= 1e-8
    assert faster <= 1e-8
    assert away <= 1e-8


def tumble(sim, periods, yd):
    sim.reset(q=[0.0, 0.5, -1.0], yd=yd)
    hold = sim.servo_command(sim.state.q, np.zeros_like(sim.state.q))
    for _ in range(periods):
        sim.step(hold)
    return sim.state


RATES = np.array([0.1, 0.0, 0.0, 0.2, 1.5, 0.1])


def test_the_engines_agree_on_an_arm_that_tumbles():
    """4 s at 1.5 rad/s about the axis of phi_y, the arm held by its servo."""
    ends = [
        tumble(Simulator(System(vehicle=FREE_FLOATING), backend=k), 320, RATES)
        for k in ("kernel", "mujoco")
    ]
    for a, b in zip(*ends, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-9)


def test_a_played_run_is_the_stepped_one():
    sims = [Simulator(System(vehicle=FREE_FLOATING)) for _ in range(2)]
    stepped = tumble(sims[0], 160, RATES)
    q = sims[1].reset(q=[0.0, 0.5, -1.0], yd=RATES).q
    sims[1].play(np.tile(sims[1].servo_command(q, 0 * q)[:, None], (1, 1601, 1)))
    for a, b in zip(stepped, sims[1].state, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_a_snapshot_holds_the_frame():
    sim = Simulator(System(vehicle=FREE_FLOATING), 2)
    tumble(sim, 160, [RATES, 0.1 * RATES])
    taken, before = sim.snapshot(), sim.state
    first = sim.step()
    sim.reset()
    assert not sim.state.y.any()
    sim.restore(taken)
    for a, b in zip(before, sim.state, strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(first, sim.step(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_tumbling_neighbour_changes_nothing():
    """The one that stays within 45 deg is bit for bit what it is by itself."""
    alone, together = (
        Simulator(System(vehicle=FREE_FLOATING)),
        Simulator(System(vehicle=FREE_FLOATING), 2),
    )
    a, b = tumble(alone, 160, 0.1 * RATES), tumble(together, 160, [0.1 * RATES, RATES])
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x[0], y[0])


def test_the_acceleration_is_the_rate_of_the_rate():
    """Y'' of `evaluate` in the world's axes, by central differences over two physics steps."""
    h = 1e-4
    sim = Simulator(System(vehicle=FREE_FLOATING, physics_dt=h, control_dt=h))
    sim.reset(q=[0.0, 0.5, -1.0], y=[0, 0, 0, 0.1, 0.78, 0.2], yd=RATES)
    hold = sim.servo_command(sim.state.q, np.zeros_like(sim.state.q))
    for _ in range(200):
        behind = sim.step(hold)
    assert behind.y[0, 4] > np.pi / 4  # in a frame of its own by now
    _, ydd = (sim.step(hold), sim.evaluate(hold)[1])
    ahead = sim.step(hold)
    np.testing.assert_allclose((ahead.yd - behind.yd) / (2 * h), ydd, atol=2e-6)
    back = twist(ahead.y, ahead.yd)[:, 3:]
    np.testing.assert_allclose(back, ahead.spin, atol=1e-12)
