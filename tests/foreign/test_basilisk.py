"""Basilisk 2.12.1: wheels, jets, arrays, slosh, gravity gradient, an arm that moves."""

from dataclasses import replace

import numpy as np
import pytest

from tests.foreign.conftest import difference
from tests.foreign.servo_loop import link_rows, row, servo_loop, without_rotors
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.link import diagonal
from ves_gym.mechanics.orbit import EARTH, EARTH_RADIUS, Orbit
from ves_gym.mechanics.pointing import allocated, wrench_matrix
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import FREE_FLOATING, SERVICER_FLEXIBLE
from ves_gym.planners.query import solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

pytestmark = pytest.mark.slow
SECONDS = 8.0


def physics(system):
    """The servicer and its arm as rows of numbers, see basilisk_servicer.py."""
    vehicle, arm = system.vehicle, system.arm
    hinges = [k for k in vehicle.appendages if k.joint == "hinge"]
    slides = [k for k in vehicle.appendages if k.joint == "slide"]
    return {
        "hub": [row(vehicle.body), row(arm.base)],
        "links": link_rows(arm),
        "wheels": [[*k.axis, k.inertia, k.viscous, k.coulomb] for k in vehicle.wheels],
        "panels": [[*k.point, *k.axis, k.stiffness, k.damping, *row(k.body)] for k in hinges],
        "slosh": [[*k.axis, k.body.mass, *k.body.com, k.stiffness, k.damping] for k in slides],
        "jets": [[*k.position, *k.direction, k.thrust] for k in vehicle.jets],
    }


def test_a_servicer_that_acts_while_its_arm_moves(foreign):
    """Tolerance: 1e-6 of the largest entry of each kind."""
    vehicle = replace(SERVICER_FLEXIBLE, pointing=None)
    system = System(arm=get_arm("ur5e"), vehicle=vehicle)
    count = round(SECONDS / system.control_dt)
    time = np.arange(count) * system.control_dt
    torque = np.array([0.1, -0.05, 0.08, 0.15]) * np.sin(0.9 * time)[:, None] + 0.02
    speeds = np.array([100.0, -120.0, 80.0, 150.0])  # rad/s, far from where they would stick
    on = np.zeros((count, len(vehicle.jets)), bool)
    on[80:160, [0, 1]] = True  # a force along x, 1 s
    on[320:360, [4, 7]] = True  # a couple, 0.5 s
    thrust = np.array([k.thrust for k in vehicle.jets])
    wrench = (thrust * on) @ wrench_matrix(vehicle.jets).T
    np.testing.assert_allclose(allocated(vehicle.jets, wrench), thrust * on, atol=1e-2)
    loop, ours = servo_loop(
        system,
        SECONDS,
        lambda k: {"base_wrench": wrench[k], "wheel_torque": torque[k]},
        wheel_speed=speeds,
    )
    loop |= {k: loop[k][None] for k in ("command", "start_q", "start_u")}
    theirs = foreign(
        "basilisk", "basilisk_servicer", **physics(system), **loop, wheel_torque=torque, on=on,
        wheel_speed=speeds, step=system.physics_dt / 2,
    )["path"][0]  # fmt: skip
    kinds = {"joints": 6, "position": 3, "quaternion": 4, "wheels": 4, "arrays": 2, "slosh": 2}
    ends = np.cumsum(list(kinds.values()))
    for name, a, b in zip(
        kinds, np.split(theirs, ends, 1), np.split(ours, ends, 1), strict=False
    ):
        print(f"{name}: {difference(a, b):.1e}")
        assert difference(a, b) < 1e-6


@pytest.mark.parametrize("duration", [2.0, 4.0])
def test_plans_on_arrays_and_slosh(foreign, duration):
    """Predicted over their E_mean, and `refined` over the straight line's there.

    The first twenty queries of reach100; wheels idle, jets off; an arm without rotors, which
    Basilisk does not know. Means over the motion and ten seconds after it.
    """
    vehicle = replace(SERVICER_FLEXIBLE, pointing=None)
    system, runs, predicted = System(arm=without_rotors(PUMA_560), vehicle=vehicle), [], []
    count = round((duration + TAIL) / system.control_dt)
    times = np.arange(count) * system.control_dt
    sim = Simulator(system)
    asked = reach100(system, "servicer-flexible", 20, durations=(duration,)).queries
    for _, query in asked:
        query = replace(query, system=system)
        for planner in ("straight", "refined"):
            plan = solve(get_planner(planner), query)
            middle = plan.motion.at(times + system.control_dt / 2)  # held
            torque = sim.servo.torque_feedforward(system.arm, middle)
            command = sim.servo_command(middle.q[None], middle.v[None], torque[None])[0]
            runs.append((command, plan.motion.start, np.zeros(6 + system.arm.n)))
            predicted.append(plan.predicted.E_mean)
    command, start_q, start_u = (np.array(k) for k in zip(*runs, strict=True))
    theirs = foreign(
        "basilisk", "basilisk_servicer", **physics(system), kp=sim.servo.kp, kd=sim.servo.kd,
        command=command, period=system.control_dt, start_q=start_q, start_u=start_u,
        wheel_torque=np.zeros((count, 4)), on=np.zeros((count, len(vehicle.jets)), bool),
        wheel_speed=np.zeros(4), step=system.physics_dt,
    )  # fmt: skip
    E = theirs["E"].mean(axis=1).reshape(-1, 2)
    found = np.array(predicted).reshape(-1, 2) / E
    strain = theirs["strain"].mean(axis=1).reshape(-1, 2)
    print(f"{duration:g} s: predicted over theirs {found.min():.3f} to {found.max():.3f}")
    for name, part in (("E", E), ("strain", strain)):
        ratios = part[:, 1] / part[:, 0]
        print(f"refined over straight, {name}: {np.round(ratios, 3)}, {np.median(ratios):.4f}")
    assert ((found > 0.97) & (found < 1.03)).all()
    assert np.median(E[:, 1] / E[:, 0]) < 0.18


def test_gravity_gradient_and_drift(foreign):
    """A satellite with its arm held, 1 m off the orbit's point, a sixth of an orbit.

    Basilisk has the point-mass field and its GravityGradientEffector. Tolerance: 1e-6 of the
    turn and of the drift; the field beyond first order is 5e-7 of that.
    """
    orbit, step, every = Orbit(altitude=400e3), 0.1, 50.0
    body = replace(FREE_FLOATING.body, inertia=diagonal(120.0, 150.0, 180.0))
    system = System(
        vehicle=replace(FREE_FLOATING, body=body, orbit=orbit),
        drive="prescribed", physics_dt=step, control_dt=step,
    )  # fmt: skip
    H = inertia(system.arm, np.zeros(3))[:6, :6] + system.base.rigid()
    mass, c = H[0, 0], np.array([H[5, 1], H[3, 2], H[4, 0]]) / H[0, 0]
    about = H[3:, 3:] - mass * (c @ c * np.eye(3) - np.outer(c, c))
    place, omega = np.array([1.0, 0.3, -0.2]), np.array([2e-4, -1e-4, 3e-4])
    sim, ours = Simulator(system), []
    sim.reset(y=[*(place - c), 0, 0, 0], yd=[*-np.cross(omega, c), *omega])
    for k in range(round(900 / step)):
        state = sim.step()
        if (k + 1) % round(every / step) == 0:
            R = rotation(state.y)[0]
            ours.append([*(state.y[0, :3] + R @ c), *state.attitude[0]])
    radius = EARTH_RADIUS + orbit.altitude
    point = np.array([[radius, 0, 0], [0, orbit.rate * radius, 0]])
    theirs = foreign(
        "basilisk", "basilisk_orbit", body=about, mass=mass, mu=EARTH, orbit=point,
        start=np.array([place, 0 * place]), omega=omega, step=step, until=900.0, every=every,
    )["path"]  # fmt: skip
    angle = orbit.rate * every * np.arange(1, len(theirs) + 1)[:, None]
    theirs[:, :3] -= radius * np.hstack([np.cos(angle), np.sin(angle), 0 * angle])
    ours = np.array(ours)
    ours[:, 3:] *= np.sign(np.sum(ours[:, 3:] * theirs[:, 3:], axis=1))[:, None]
    for name, part in (("drift", slice(0, 3)), ("turn", slice(4, 7))):
        print(f"{name}: {difference(theirs[:, part], ours[:, part]):.1e}")
        assert difference(theirs[:, part], ours[:, part]) < 1e-6
