"""Newton-Euler against closed forms and conservation laws."""

import numpy as np
import pytest

pytest.importorskip("numba")

from ves_gym.diagnosis.benchmark.blind.mechanics import (
    GRAVITY,
    BodyParameters,
    conjugate,
    fill_trig,
    inverse_dynamics,
    newton_euler,
    platform_motion,
    unit_column,
)
from ves_gym.diagnosis.benchmark.blind.plant import rates, scratch
from ves_gym.diagnosis.benchmark.blind.setup import resting


def evaluate(bodies, q, v, a, spin=(0, 0, 0), turn=(0, 0, 0), pull=(0, 0, 0)):
    """Torques and wrench."""
    n = len(q)
    trig, work, tau, wrench = (
        np.zeros((n, 4)), np.zeros((n + 1, 12)), np.zeros(n), np.zeros(6),
    )  # fmt: skip
    fill_trig(bodies, np.asarray(q, float), trig)
    arrays = (np.asarray(k, float) for k in (v, a, spin, turn, pull))
    newton_euler(bodies, trig, *arrays, work, tau, wrench)
    return tau, wrench


def pendulum(mass=2.0, length=0.7, inertia=0.05):
    """One link that turns about the platform's z, its mass at the far end."""
    moments = np.zeros((2, 3, 3))
    moments[1] = inertia * np.eye(3)
    return BodyParameters(
        dh=np.array([[0.0, length, 0.0, 0.0]]),
        mass=np.array([0.0, mass]),
        com=np.zeros((2, 3)),
        inertia=moments,
    )


def test_pendulum_torque_is_closed_form():
    m, r, i = 2.0, 0.7, 0.05
    q, a = 0.4, 3.0
    down = np.array([GRAVITY, 0.0, 0.0])  # platform on its side: weight along -x
    tau, wrench = evaluate(pendulum(m, r, i), [q], [1.5], [a], pull=down)
    assert tau[0] == pytest.approx((m * r * r + i) * a - m * GRAVITY * r * np.sin(q), rel=1e-13)
    radial = -m * r * 1.5**2 * np.array([np.cos(q), np.sin(q)])
    along = m * r * a * np.array([-np.sin(q), np.cos(q)])
    assert wrench[:2] == pytest.approx(-(radial + along) - [m * GRAVITY, 0], rel=1e-12)


def test_unit_column_is_a_unit_acceleration(setup):
    q = np.array([0.3, -0.8, 1.1])
    room = scratch()
    fill_trig(setup.plant.bodies, q, room.trig)
    for j in range(3):
        unit_column(setup.plant.bodies, room.trig, j, room.work, room.columns[j])
        tau, wrench = evaluate(setup.plant.bodies, q, np.zeros(3), np.eye(3)[j])
        assert room.columns[j] == pytest.approx(np.r_[tau, wrench], abs=1e-12)


def test_weight_is_that_of_all_masses(setup):
    wrench = resting(setup.plant.bodies)
    assert wrench[:3] == pytest.approx([0, 0, -GRAVITY * setup.plant.bodies.mass.sum()])


def test_platform_motion_is_the_derivative_of_its_pose():
    """Rotation by Z-Y-X angles: its spin and acceleration by differences of step 1e-5."""
    from scipy.spatial.transform import Rotation

    pose, rate, acc = np.random.default_rng(1).normal(size=(3, 6)) * 0.3

    def at(t):
        y = pose + rate * t + acc * t * t / 2
        return Rotation.from_euler("xyz", y[3:]), rate + acc * t, y

    def spin_at(t, h=1e-5):
        before, after = at(t - h)[0], at(t + h)[0]
        return (before.inv() * after).as_rotvec() / (2 * h)

    spin, turn, pull = np.zeros((3, 3))
    platform_motion(pose, rate, acc, spin, turn, pull)
    assert spin == pytest.approx(spin_at(0.0), abs=1e-7)
    assert turn == pytest.approx((spin_at(1e-4) - spin_at(-1e-4)) / 2e-4, abs=1e-5)
    up = acc[:3] + np.array([0, 0, GRAVITY])
    assert pull == pytest.approx(at(0.0)[0].inv().apply(up), abs=1e-12)


def test_conjugate_force_does_the_same_work():
    """force . rate = wrench . twist for any rate."""
    rng = np.random.default_rng(2)
    pose, rate, wrench = rng.normal(size=(3, 6)) * 0.4
    spin, turn, linear = np.zeros((3, 3))
    zero, force = np.zeros(6), np.zeros(6)
    platform_motion(pose, rate, zero, spin, turn, linear)
    platform_motion(pose, zero, np.r_[rate[:3] - [0, 0, GRAVITY], 0, 0, 0], zero[:3].copy(),
                    turn, linear)  # fmt: skip
    conjugate(pose, wrench, force)
    assert force @ rate == pytest.approx(wrench @ np.r_[linear, spin], rel=1e-12)


def test_free_swing_keeps_its_energy(setup):
    """Arm let go under gravity on a platform that stands: 4th order, 1e-9 of its swing."""
    p = setup.finished()._replace(kp=np.zeros(3), kd=np.zeros(3))
    x = np.zeros(42)
    x[0:3] = x[6:9] = [0.4, 0.5, -0.3]
    room, zero, goal = scratch(), np.zeros(3), np.zeros(6)

    def energy(x):
        q, v = x[0:3], x[3:6]
        zeros = np.zeros((3, 3))
        H = inverse_dynamics(p.bodies, p.rotor, np.tile(q, (3, 1)), zeros, np.eye(3))
        turn, place, height = np.eye(3), np.zeros(3), 0.0
        for i, (d, a, alpha, offset) in enumerate(p.bodies.dh):
            c, s, ca, sa = (
                np.cos(q[i] + offset),
                np.sin(q[i] + offset),
                *(f(alpha) for f in (np.cos, np.sin)),
            )
            place = place + turn @ [a * c, a * s, d]
            turn = turn @ [[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0, sa, ca]]
            height += p.bodies.mass[i + 1] * (place + turn @ p.bodies.com[i + 1])[2]
        kinetic = 0.5 * v @ H @ v
        return kinetic + GRAVITY * height, kinetic

    def slope(x):
        dx = np.zeros(42)
        rates(p, x, zero, zero, zero, goal, goal, 0.0, dx, room)
        return dx

    first, most, h = energy(x)[0], 0.0, 1e-3
    for _ in range(500):
        a = slope(x)
        b = slope(x + h / 2 * a)
        c = slope(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))
        most = max(most, energy(x)[1])
    assert most > 20.0  # J: it did swing
    assert energy(x)[0] == pytest.approx(first, abs=1e-8 * most)
