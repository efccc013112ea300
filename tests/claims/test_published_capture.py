"""Claim: captures by a published free-floating robot are those of its equations of momentum.

The robot: the planar two-link manipulator of Papadopoulos and Dubowsky ("Dynamic singularities
in free-floating space manipulators", J. Dyn. Sys. Meas. Control 115, 1993; IEEE Trans. Robotics
and Automation 7, 1991). Its published figure, a dynamic singularity at q1 = -65 deg, q2 =
-11.41 deg, fixes its numbers; the papers capture nothing, so captures are held against the
planar equations, written here in five coordinates of the robot and three of the target.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.latch import tool_motion
from ves_gym.mechanics.link import Inertial, Link, Mount, diagonal
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.servo import JointServo
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

# mass [kg], moment of inertia [kg m^2]; every centre lies 0.5 m from the joints of its body
MASSES, MOMENTS, HALF = np.array([40.0, 4.0, 3.0]), np.array([6.667, 0.333, 0.250]), 0.5
SINGULAR = np.deg2rad([-65.0, -11.41])  # as published
TARGET_MASS, TARGET_MOMENT = 8.0, 0.9  # of the body caught (this project)
OFFSET = np.array([0.3, -0.2])  # of its centre from the tool [m]


def body(mass: float, moment: float, com: tuple = (0.0, 0.0, 0.0)) -> Inertial:
    return Inertial(mass=mass, com=com, inertia=diagonal(moment, moment, moment))


def robot() -> tuple[Arm, Satellite]:
    limits = {"q_min": -3.1, "q_max": 3.1, "v_max": 9.0, "a_max": 9.0, "tau_max": 1e3}
    links = tuple(
        Link(d=0.0, a=2 * HALF, alpha=0.0, inertial=body(m, i, (-HALF, 0.0, 0.0)), **limits)
        for m, i in zip(MASSES[1:], MOMENTS[1:], strict=True)
    )
    nothing = Inertial(mass=0.0, com=(0.0, 0.0, 0.0), inertia=diagonal(0.0, 0.0, 0.0))
    source = "Papadopoulos and Dubowsky 1993"
    mount = Mount(position=(HALF, 0.0, 0.0))
    arm = Arm(name="two links", base=nothing, links=links, mount=mount, source=source)
    return arm, Satellite(body=body(MASSES[0], MOMENTS[0]), source=source)


# ------------------------------------------------------------------ the plane, by hand


def planar(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(5, 5) inertia and (3, 5) tool Jacobian by (x', y', w, q1', q2')."""
    along = [np.array([np.cos(k), np.sin(k)]) for k in (0.0, q[0], q[0] + q[1])]
    joints = [HALF * along[0], HALF * along[0] + 2 * HALF * along[1]]
    centres = [np.zeros(2), joints[0] + HALF * along[1], joints[1] + HALF * along[2]]
    tool = joints[1] + 2 * HALF * along[2]

    def rates(point: np.ndarray, moving: int) -> np.ndarray:
        J = np.zeros((3, 5))
        J[:2, :2] = np.eye(2)
        for k, pivot in enumerate((np.zeros(2), *joints)[: moving + 1]):
            J[:, 2 + k] = [-(point - pivot)[1], (point - pivot)[0], 1.0]
        return J

    H = np.zeros((5, 5))
    for k, (mass, moment) in enumerate(zip(MASSES, MOMENTS, strict=True)):
        J = rates(centres[k], k)
        H += J.T @ np.diag([mass, mass, moment]) @ J
    return H, rates(tool, 2), tool


def generalised(q: np.ndarray) -> np.ndarray:
    """(2, 2) generalised Jacobian of the tool's velocity, by hand."""
    H, J, _ = planar(q)
    return (J[:, 3:] - J[:, :3] @ np.linalg.solve(H[:3, :3], H[:3, 3:]))[:2]


def of_package(q: np.ndarray) -> np.ndarray:
    """(2, 2) the same from the package's mass matrix and Jacobian."""
    arm, satellite = robot()
    t = tool_motion(arm, satellite.base_model(), np.zeros(6), q, np.zeros(0))
    return (t.J[:, 6:] - t.J[:, :6] @ np.linalg.solve(t.mass[:6, :6], t.mass[:6, 6:]))[:2]


def singular(jacobian: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Joint angles near the published ones at which a Jacobian has no inverse."""

    def determinant(q2: float) -> float:
        return float(np.linalg.det(jacobian(np.array([SINGULAR[0], q2]))))

    return np.array([SINGULAR[0], brentq(determinant, -0.5, 0.0, xtol=1e-14)])


# ------------------------------------------------------------------ tests


def test_the_dynamic_singularity_is_where_it_was_published():
    for q in (SINGULAR, np.array([0.4, 1.1])):
        assert np.abs(of_package(q) - generalised(q)).max() <= 1e-12
    at = np.rad2deg(singular(of_package)[1])
    print(f"q2 = {at:.4f} deg, published -11.41")
    assert round(at, 2) == -11.41


def before(q: np.ndarray, rates: np.ndarray, twist: np.ndarray, servo=None) -> Simulator:
    """The robot, and a disc at its tool that moves with a planar twist (x', y', w)."""
    arm, satellite = robot()
    _, _, tool = planar(q)
    payload = Payload(
        inertial=body(TARGET_MASS, TARGET_MOMENT),
        grip=Mount(position=(-OFFSET[0], -OFFSET[1], 0.0)),
        position=(*(tool + OFFSET), 0.0),
        velocity=(twist[0], twist[1], 0.0),
        spin=(0.0, 0.0, twist[2]),
        latch_distance=1e-9,
    )
    system = System(arm=arm, vehicle=satellite, payload=payload)
    sim = Simulator(system, servo=servo)
    yd = np.zeros(6)
    yd[[0, 1, 5]] = rates[:3]
    sim.reset(q=q, v=rates[3:], yd=yd)
    return sim


def by_hand(q: np.ndarray, rates: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, float]:
    """Rates (8,) after the capture, energy lost: momentum, and one twist at the tool."""
    H, J, _ = planar(q)
    mass = np.zeros((8, 8))
    mass[:5, :5], mass[5:, 5:] = H, np.diag([TARGET_MASS, TARGET_MASS, TARGET_MOMENT])
    # the tool lies at minus OFFSET from the disc's centre
    X = np.array([[1.0, 0.0, OFFSET[1]], [0.0, 1.0, -OFFSET[0]], [0.0, 0.0, 1.0]])
    C = np.hstack([J, -X])
    start = np.r_[rates, twist]
    saddle = np.block([[mass, C.T], [C, np.zeros((3, 3))]])
    after = np.linalg.solve(saddle, np.r_[mass @ start, np.zeros(3)])[:8]
    return after, 0.5 * (start @ mass @ start - after @ mass @ after)


CASES = [
    (SINGULAR, np.zeros(5), np.array([-0.2, 0.1, 0.0])),
    (SINGULAR, np.array([0.0, 0.0, 0.0, 0.2, -0.3]), np.array([-0.1, 0.0, 0.8])),
    (
        np.array([0.6, 1.2]),
        np.array([0.05, -0.02, 0.1, -0.2, 0.4]),
        np.array([0.0, -0.3, -0.5]),
    ),
]


@pytest.mark.parametrize(("q", "rates", "twist"), CASES)
def test_rates_after_a_capture_are_those_of_the_planar_equations(q, rates, twist):
    sim = before(q, rates, twist)
    expected, lost = by_hand(q, rates, twist)
    (event,) = sim.grasp()
    s, free = sim.state, sim.payload.state
    ours = np.r_[s.yd[0, [0, 1, 5]], s.v[0], free.velocity[0, :2], free.spin[0, 2]]
    print(f"rates {np.abs(ours - expected).max():.1e}, lost {event.lost:.6f} J of {lost:.6f}")
    assert np.abs(ours - expected).max() <= 1e-12
    assert event.lost == pytest.approx(lost, rel=1e-10)
    assert np.abs(s.yd[0, [2, 3, 4]]).max() <= 1e-12  # it stays in its plane


def test_an_impulse_in_the_singular_direction_moves_no_joint():
    """u^T J* = 0, so J*^T u p = 0: the robot takes it as one rigid body, whatever its size."""
    q = singular(generalised)
    u, _, _ = np.linalg.svd(generalised(q))
    rest, twist, jumps = np.zeros(5), np.array([-0.4, 0.3, 0.0]), []
    for direction in (u[:, 1], u[:, 0]):
        sim = before(q, rest, twist)
        (event,) = sim.grasp(directions=np.r_[direction, np.zeros(4)][:, None])
        assert np.linalg.norm(event.impulse) > 0.1
        assert np.linalg.norm(sim.state.yd) > 1e-3  # the base moves
        jumps.append(np.abs(sim.state.v).max())
    print(f"joints jump by {jumps[0]:.1e} rad/s, across it by {jumps[1]:.2f}")
    assert jumps[0] <= 1e-12
    assert jumps[1] > 0.1


def test_after_the_joints_have_stopped_it_turns_as_one_body():
    """Angular momentum about the common centre over the locked inertia; that centre's drift."""
    q, rates, twist = CASES[2]
    servo = JointServo(kp=(400.0, 400.0), kd=(200.0, 200.0))
    sim = before(q, rates, twist, servo)
    H, _, tool = planar(q)
    centre = tool + OFFSET
    momentum = (H @ rates)[:3] + np.r_[TARGET_MASS * twist[:2], TARGET_MOMENT * twist[2]]
    momentum[2] += TARGET_MASS * (centre[0] * twist[1] - centre[1] * twist[0])
    mass = MASSES.sum() + TARGET_MASS
    middle = (TARGET_MASS * centre + np.array([H[1, 2], -H[0, 2]])) / mass
    about = momentum[2] - (middle[0] * momentum[1] - middle[1] * momentum[0])
    sim.grasp()
    hold = sim.servo_command(sim.state.q, np.zeros((1, 2)))
    for _ in range(800):
        sim.step(hold)
    s = sim.state
    assert np.abs(s.v).max() <= 1e-6
    H, _, tool = planar(s.q[0])
    link = np.array([np.cos(s.q[0].sum()), np.sin(s.q[0].sum())])
    place = sim.payload.place[0]
    there = tool + place[0] * link + place[1] * np.array([-link[1], link[0]])
    locked = H[2, 2] + TARGET_MOMENT + TARGET_MASS * there @ there
    middle = (TARGET_MASS * there + np.array([H[1, 2], -H[0, 2]])) / mass
    spin = about / (locked - mass * middle @ middle)
    print(f"spin {s.yd[0, 5]:.8f} rad/s of {spin:.8f}")
    assert s.yd[0, 5] == pytest.approx(spin, abs=1e-6)
    assert abs(spin) > 0.01
