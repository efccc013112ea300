"""Claim: contact at the tool is the spring, the damper and the friction that it states, in SI.

Impacts last and rebound as the closed form of the linear spring and damper says, whatever the
masses; friction follows Coulomb's closed forms; momentum stays, and the energy that contact
takes is accounted for. Plain MuJoCo, on a model written by hand, gives the same trajectory
through contact, capture and after it: by its own contact without friction, and by forces that
its own distances give, applied at its own points, with it.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests import contact_mjcf
from tests.free_bodies import NO_ARM, momentum_of, rebound
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.attitude import conjugate, from_angles, rotate
from ves_gym.mechanics.contact import Contact, ContactShape
from ves_gym.mechanics.kinematics import tool_frame, tool_jacobian
from ves_gym.mechanics.latch import tool_motion
from ves_gym.mechanics.link import Inertial, Mount, diagonal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.spatial import twist
from ves_gym.mechanics.vehicle import FREE_FLOATING, Satellite
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

HOME = np.array([0.3, 0.4, -0.8])
TOOL = tool_frame(PUMA_560, HOME)[0]
TOWARDS = np.array([1.0, 0.2, -0.1]) / np.linalg.norm([1.0, 0.2, -0.1])
PAD = ContactShape(form="sphere", size=(contact_mjcf.PAD,))
GAP = 0.01  # m, at the start


def ball(mass: float, radius: float, **motion) -> Payload:
    """A homogeneous ball."""
    moment = 0.4 * mass * radius**2
    inertial = Inertial(mass=mass, com=(0.0, 0.0, 0.0), inertia=diagonal(*(moment,) * 3))
    return Payload(inertial=inertial, **motion)


def wall(mass: float, speed: tuple[float, float], law: dict, dt: float) -> Simulator:
    """A ball of 0.05 m that meets a plate on a satellite of 1e8 kg, GAP away."""
    plate = ContactShape(
        form="box", size=(2.0, 2.0, 0.2), place=Mount(position=(-0.1, 0, -0.1))
    )
    heavy = Inertial(mass=1e8, com=(0.0, 0.0, 0.0), inertia=diagonal(1e8, 1e8, 1e8))
    payload = ball(
        mass, 0.05, position=(0.0, 0.0, 0.05 + GAP), velocity=(speed[1], 0.0, -speed[0])
    )
    round_one = ContactShape(form="sphere", size=(0.05,))
    system = System(
        arm=NO_ARM,
        vehicle=Satellite(body=heavy, source="test"),
        payload=payload,
        contact=Contact(tool=(plate,), target=(round_one,), **law),
        drive="prescribed",
        physics_dt=dt,
        control_dt=dt,
    )
    return Simulator(system, servo=None)


def through(sim: Simulator, time: float) -> float:
    """Step on; return how long the contact pushed."""
    dt, pushed = sim.system.control_dt, 0
    for _ in range(round(time / dt)):
        sim.step()
        pushed += bool(sim.contact.measured()[0].any())
    return pushed * dt


@pytest.mark.parametrize(("mass", "ratio"), [(50.0, 0.0), (0.5, 0.1), (50.0, 0.1), (0.5, 1.5)])
def test_an_impact_lasts_and_rebounds_as_the_closed_form_says(mass, ratio):
    time = 0.02  # of half a period without damping
    stiffness = mass * (np.pi / time) ** 2
    damping = 2 * ratio * np.sqrt(stiffness * mass)
    lasts, restitution = rebound(mass, stiffness, damping)
    dt = 2e-4
    sim = wall(mass, (0.5, 0.0), {"stiffness": stiffness, "damping": damping}, dt)
    pushed = through(sim, GAP / 0.5 + 1.3 * time)
    out = sim.payload.state.velocity[0, 2] / 0.5
    print(f"{mass} kg, {ratio}: {pushed:.4f} s of {lasts:.4f}, {out:.5f} of {restitution:.5f}")
    assert abs(pushed - lasts) <= 1.5 * dt
    assert out == pytest.approx(restitution, abs=2e-3)


@pytest.mark.parametrize(
    ("speed", "friction", "closed"),
    [
        (0.3, 0.1, "slides"),  # friction times the normal impulse
        (0.05, 0.5, "rolls"),  # the surface stops, the ball turns on
    ],
)
def test_friction_slides_and_rolls_as_coulomb_says(speed, friction, closed):
    mass, stiffness, damping, dt = 2.0, 1e5, 100.0, 2.5e-4
    law = {"stiffness": stiffness, "damping": damping, "friction": friction}
    law["tangential_damping"] = 250.0
    sim = wall(mass, (0.3, speed), law, dt)
    through(sim, GAP / 0.3 + 0.03)
    _, restitution = rebound(mass, stiffness, damping)
    s = sim.payload.state
    slides = speed - friction * (1 + restitution) * 0.3
    expected = slides if closed == "slides" else speed * 5 / 7
    print(f"{closed}: {s.velocity[0, 0]:.5f} m/s of {expected:.5f}")
    assert s.velocity[0, 0] == pytest.approx(expected, rel=0.01)
    assert s.spin[0, 1] * 0.4 * 0.05 == pytest.approx(speed - s.velocity[0, 0], rel=0.03)


@pytest.mark.parametrize("damping", [0.0, 40.0])
def test_a_pin_that_rattles_in_a_tube_keeps_its_energy_or_loses_it_and_gains_none(damping):
    """Scores of impacts, wall to wall: no step of the chatter makes energy."""
    tube = ContactShape(form="cone", size=(0.08, 0.08, 0.6))
    system = wall(2.0, (0.0, 0.0), {"stiffness": 1e5, "damping": damping}, 2.5e-4).system
    contact = replace(system.contact, tool=(PAD,), target=(tube,))
    at_tool, v = (0.1, 0.0, 0.0), np.array([1.8, 0.6, 0.0])
    payload = replace(system.payload, position=at_tool, velocity=tuple(v.tolist()))
    system = system.replace(contact=contact, payload=payload, control_dt=1e-3)
    sim, energies, pushed = Simulator(system, servo=None), [], []
    for _ in range(1500):
        sim.step()
        (wrench, stored), body = sim.contact.measured(), sim.payload.state
        moving = 2.0 * (body.velocity**2).sum() + 0.4 * 2.0 * 0.05**2 * (body.spin**2).sum()
        energies.append((0.5 * moving + stored[0]) / (v @ v))
        pushed.append(wrench.any())
    impacts, change = np.count_nonzero(np.diff(np.array(pushed, int)) > 0), np.diff(energies)
    print(f"{impacts} impacts, {min(energies):.4f} to {max(energies):.6f} of what it had")
    assert impacts >= 12
    assert change.max() <= 2e-4
    if damping:
        assert energies[-1] <= 0.1
    else:
        assert np.abs(np.array(energies) - 1).max() <= 2e-3


def test_the_longest_step_that_is_taken_makes_no_energy():
    """With the springs between the lightest that both can show; a longer one is refused."""
    law, stiffness = {"damping": 0.0}, 2.0
    sim = wall(2.0, (0.3, 0.0), {"stiffness": stiffness, **law}, 2.5e-4)
    with pytest.raises(ParameterError, match="physics_dt must be") as refused:
        wall(2.0, (0.3, 0.0), {"stiffness": 1e12, **law}, 2.5e-4)
    most = 1e12 * (float(str(refused.value).split("<= ")[1].split(" s")[0]) / 2.5e-4) ** 2
    sim = wall(2.0, (0.3, 0.0), {"stiffness": 0.98 * most, **law}, 2.5e-4)
    through(sim, GAP / 0.3 + 0.02)
    out = sim.payload.state.velocity[0, 2] / 0.3
    print(f"stiffness {most:.3g} N/m at 0.25 ms rebounds with {out:.3f}")
    assert 0.3 < out <= 1.02


def meeting(shape: ContactShape, tool: ContactShape = PAD, **law) -> System:
    """A body on its way to the tool of a PUMA 560 at HOME on the free cube."""
    numbers = contact_mjcf.BALL
    body = Inertial(
        mass=numbers["mass"], com=numbers["com"], inertia=diagonal(*numbers["moments"])
    )
    near = numbers["radius"] + contact_mjcf.PAD + GAP
    payload = Payload(
        inertial=body,
        position=tuple(TOOL + near * TOWARDS),
        velocity=tuple(-0.2 * TOWARDS),
        spin=(0.1, 0.2, 0.3),
        latch_distance=1.0,
    )
    said = {**contact_mjcf.LAW, **law}
    contact = Contact(tool=(tool,), target=(shape,), **said)
    return System(vehicle=FREE_FLOATING, payload=payload, contact=contact)


BALL = ContactShape(form="sphere", size=(contact_mjcf.BALL["radius"],))


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_plain_mujoco_gives_the_same_trajectory_through_contact_and_capture(friction):
    law = {} if friction else {"friction": 0.0, "tangential_damping": 0.0}
    sim = Simulator(meeting(BALL, **law))
    assert sim.backend_name == "kernel"
    rates = np.array([0.2, -0.1, 0.15])
    sim.reset(q=HOME, v=rates)
    payload, kp, kd = sim.system.payload, np.array(sim.servo.kp), np.array(sim.servo.kd)
    origin = np.array(payload.velocity) - np.cross(payload.spin, payload.inertial.com)
    start = np.array(payload.position), np.array([1.0, 0, 0, 0]), origin, np.array(payload.spin)
    push = contact_mjcf.push if friction else None
    theirs, force = contact_mjcf.run(kp, kd, HOME, rates, start, HOME, (80, 120), push)
    hold = sim.servo_command(HOME[None], np.zeros((1, 3)))
    mine, wrench = [], []
    for period in range(21):
        if period == 8:
            assert sim.contact.measured()[0].any()  # it is caught while it touches
            sim.grasp()
        s = sim.state
        mine.append(np.r_[s.q[0], s.y[0, :3], s.attitude[0], sim.payload.state.position[0]])
        wrench.append(sim.contact.measured()[0][0, :3])
        sim.step(hold)
    error = np.abs(np.array(mine) - theirs[::10]).max()
    off = np.abs(np.array(wrench)[:8] + force[:80:10]).max()
    print(f"trajectory {error:.1e} m, rad; force {off:.1e} of {np.abs(force).max():.3g} N")
    # MuJoCo states its own contact as a constraint, which is off by its least impedance, 1e-4
    assert error <= (1e-11 if friction else 1e-7)
    assert off <= (1e-9 if friction else 1e-4) * np.abs(force).max()
    assert np.abs(theirs[-1] - theirs[0]).max() > 0.01


def test_plain_mujoco_gives_the_same_trajectory_of_a_pin_into_a_funnel():
    across, length, radii = np.array([0.0, 0.0, 1.0]), 0.1, (0.12, 0.055)
    centre = TOOL + (length / 2 - 0.043) * TOWARDS + 0.03 * across
    tilt, heading = np.arccos(TOWARDS[2]), np.arctan2(TOWARDS[1], TOWARDS[0])
    place = Mount(position=tuple(centre), angles=(0.0, tilt, heading))
    cone = ContactShape(form="cone", size=(*radii, length), place=place)
    contact = replace(meeting(BALL).contact, on="space", target=(cone,))
    sim = Simulator(System(vehicle=FREE_FLOATING, contact=contact))
    # near enough for no motor to reach its limit, which the judge has not
    hold = HOME + np.linalg.solve(tool_jacobian(PUMA_560, HOME), 0.012 * TOWARDS)
    sim.reset(q=HOME)
    far = np.array([9.0, 0, 0]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)
    push = contact_mjcf.funnel(centre, TOWARDS, *radii, length)
    gains = np.array(sim.servo.kp), np.array(sim.servo.kd)
    theirs, _ = contact_mjcf.run(*gains, HOME, np.zeros(3), far, hold, (400, 0), push)
    command, mine, touched = sim.servo_command(hold[None], np.zeros((1, 3))), [], 0
    for _ in range(41):
        s = sim.state
        mine.append(np.r_[s.q[0], s.y[0, :3], s.attitude[0]])
        touched += bool(sim.contact.measured()[0].any())
        sim.step(command)
    error = np.abs(np.array(mine) - theirs[::10, :10]).max()
    print(f"{error:.1e} m, rad over {touched} of 41 periods in contact")
    assert touched > 5
    assert error <= 1e-12


SHAPES = [
    ContactShape(form="sphere", size=(0.2,)),
    ContactShape(form="box", size=(0.4, 0.3, 0.3), place=Mount(angles=(0.1, 0.0, 0.2))),
    ContactShape(form="cone", size=(0.17, 0.05, 0.4), place=Mount(angles=(0.0, -1.4, 0.2))),
    ContactShape(form="capsule", size=(0.1, 0.2), place=Mount(angles=(0.0, 1.5, 0.2))),
]


@pytest.mark.parametrize("shape", SHAPES, ids=[k.form for k in SHAPES])
def test_momentum_stays_and_the_ledger_closes(shape):
    bar = ContactShape(form="capsule", size=(0.05, 0.2), place=Mount(angles=(0.4, 0.0, 0.0)))
    system = meeting(shape, bar if shape.form == "capsule" else PAD)
    motion = Motion.straight(HOME, HOME + 0.05, 0.25)
    log = play_motions(system, [motion], settle=0.2, record_dt=system.physics_dt).log(0)
    body = system.payload.inertial
    base = system.base
    tool = tool_motion(system.arm, base, log.y, log.q, np.zeros((len(log.t), 0)))
    arm = momentum_of(tool.mass, np.c_[twist(log.y, log.yd), log.v], log.y)
    linear = arm[:, :3] + body.mass * log.pd[:, :3]
    assert np.abs(linear - linear[0]).max() <= 1e-8
    # the wrench in the log is what changes the payload's momentum
    impulse = -np.trapezoid(log.contact[:, :3], log.t, axis=0)
    gained = body.mass * (log.pd[-1, :3] - log.pd[0, :3])
    assert np.linalg.norm(gained) > 1.0
    assert np.abs(impulse - gained).max() <= 0.01 * np.linalg.norm(gained)
    balance = EnergyBalance.of(log)
    print(f"{shape.form}: {balance}, lost {balance.dissipated[-1]:.3g} J")
    assert balance.relative <= 2e-4
    assert balance.dissipated[-1] > 0.02
    assert np.diff(balance.dissipated).min() >= -1e-4
    wrong = EnergyBalance.of(replace(log, contact=0.0 * log.contact))
    assert wrong.relative > 0.05  # the ledger is about it


def test_the_energy_lost_in_an_impact_is_the_closed_form():
    sim = wall(2.0, (0.4, 0.0), {"stiffness": 1e5, "damping": 200.0}, 2.5e-4)
    motion = Motion.straight([0.0], [0.0], 0.05)
    log = play_motions(sim.system, [motion], settle=0.02, record_dt=2.5e-4).log(0)
    _, restitution = rebound(2.0, 1e5, 200.0)
    lost = EnergyBalance.of(log).dissipated[-1]
    expected = 0.5 * 2.0 * 0.4**2 * (1 - restitution**2)
    print(f"{lost:.5f} J of {expected:.5f}")
    assert lost == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("on", ["payload", "space", "base"])
def test_it_is_the_same_whichever_way_the_satellite_is_turned(on):
    """phi_y = 100 deg lies beyond where Z-Y-X angles end: the engine has a frame of its own."""
    ends = []
    for angles in (np.zeros(3), np.array([0.3, np.deg2rad(100.0), -0.2])):
        q, system = from_angles(angles), meeting(BALL)
        payload, rates = system.payload, np.zeros(3)
        if on != "payload":
            turned = rotate(q, payload.position) if on == "space" else payload.position
            shape = replace(BALL, place=Mount(position=tuple(turned)))
            contact = replace(system.contact, on=on, target=(shape,))
            system = system.replace(contact=contact, payload=None)
            rates = np.linalg.solve(tool_jacobian(PUMA_560, HOME), 0.8 * TOWARDS)
        sim = Simulator(system)
        sim.reset(q=HOME, v=rates, y=np.r_[0, 0, 0, angles])
        if on == "payload":
            sim.payload.change(
                np.arange(1),
                position=rotate(q, payload.position)[None],
                velocity=rotate(q, payload.velocity)[None],
                attitude=q[None],
            )
        hold, most = sim.servo_command(HOME[None], np.zeros((1, 3))), 0.0
        for _ in range(20):
            sim.step(hold)
            most = max(most, np.abs(sim.contact.measured()[0]).max())
        s, back = sim.state, conjugate(q)
        place = rotate(back, sim.payload.state.position[0]) if on == "payload" else []
        ends.append(np.r_[s.q[0], rotate(back, s.y[0, :3]), place])
        assert most > 5.0
    assert np.abs(ends[0] - ends[1]).max() <= 1e-7
