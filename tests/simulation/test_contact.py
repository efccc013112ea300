"""Contact of a simulator's tool: what is refused, state, batches, files, engines."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.boom import get_boom
from ves_gym.mechanics.contact import Contact, ContactShape
from ves_gym.mechanics.kinematics import tool_frame
from ves_gym.mechanics.link import Inertial, diagonal
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.vehicle import BENT, FREE_FLOATING
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

HOME = np.array([0.3, 0.4, -0.8])
TOOL = tool_frame(PUMA_560, HOME)[0]
BODY = Inertial(mass=12.0, com=(0.02, 0.0, 0.01), inertia=diagonal(0.3, 0.5, 0.4))
PAYLOAD = Payload(
    inertial=BODY,
    position=(TOOL[0] + 0.252, TOOL[1], TOOL[2]),
    velocity=(-0.2, 0.0, 0.0),
    spin=(0.1, 0.3, 0.0),
    latch_distance=1.0,
)
CONTACT = Contact(
    tool=(ContactShape(form="sphere", size=(0.05,)),),
    target=(ContactShape(form="sphere", size=(0.2,)),),
    stiffness=2e4,
    damping=60.0,
    friction=0.2,
    tangential_damping=200.0,
)
BOX = ContactShape(form="box", size=(0.1, 0.1, 0.1))
SYSTEM = System(vehicle=FREE_FLOATING, payload=PAYLOAD, contact=CONTACT, physics_dt=2.5e-3)


def started(system: System = SYSTEM, n: int = 1, **settings) -> Simulator:
    sim = Simulator(system, n, **settings)
    sim.reset(q=HOME)
    return sim


def played(sim: Simulator, periods: int = 8) -> np.ndarray:
    hold = sim.servo_command(np.tile(HOME, (sim.n, 1)), np.zeros((sim.n, 3)))
    for _ in range(periods):
        sim.step(hold)
    return np.concatenate([*sim.state[1:], *sim.payload.state, *sim.contact.measured()[:1]], 1)


def test_a_snapshot_continues_exactly():
    sim = started(SYSTEM.replace(vehicle=BENT), 2)
    played(sim, 3)
    sim.grasp([1])
    snapshot = pickle.loads(pickle.dumps(sim.snapshot()))
    once = played(sim)
    assert not np.array_equal(once[0], once[1])
    sim.reset()
    sim.restore(snapshot)
    assert np.abs(played(sim) - once).max() <= 1e-12


def test_simulations_do_not_touch_each_other():
    sim, alone = started(n=3), started()
    ids = np.arange(3)
    sim.payload.change(ids[2:], mass=[30.0], com=[[0.0, 0.1, 0.0]])
    sim.payload.change(ids[:1], position=[[5.0, 0.0, 0.0]])
    moved, same = played(sim), played(alone)
    assert np.abs(moved[1] - same[0]).max() <= 1e-12
    assert np.abs(moved[2] - same[0]).max() > 1e-3
    assert not moved[0, -6:].any()  # out of reach


def test_while_it_is_carried_nothing_touches_and_once_released_it_does():
    sim = started()
    played(sim, 4)
    assert sim.contact.measured()[0].any()
    sim.grasp()
    assert not sim.contact.measured()[0].any()
    played(sim, 4)
    assert not sim.contact.measured()[0].any()
    sim.release()
    assert sim.contact.measured()[0].any()
    assert np.abs(sim.payload.state.position - started().payload.state.position).max() < 0.1


def test_a_mass_of_its_own_is_the_mass_of_a_system_described_so():
    """Bodies whose axes are principal and central have a faster form in the engine."""
    plain = Inertial(mass=12.0, com=(0.0, 0.0, 0.0), inertia=diagonal(0.4, 0.4, 0.4))
    sim = started(SYSTEM.replace(payload=replace(PAYLOAD, inertial=plain)))
    inertia = np.array(BODY.inertia)[None]
    sim.payload.change(np.arange(1), mass=[12.0], com=[BODY.com], inertia=inertia)
    described = started()
    start = described.payload.state
    sim.payload.change(np.arange(1), velocity=start.velocity, position=start.position)
    assert np.abs(played(sim) - played(described)).max() <= 1e-5


def test_files_and_logs_hold_it(tmp_path):
    SYSTEM.save(tmp_path / "system.toml")
    assert System.load(tmp_path / "system.toml") == SYSTEM
    assert SYSTEM.hash != SYSTEM.replace(contact=None).hash
    motion = Motion.straight(HOME, HOME + 0.02, 0.1)
    log = play_motions(SYSTEM, [motion], settle=0.1, latch=[(0.05, "grasp")]).log(0)
    log.save(tmp_path / "run.csv")
    again = RunLog.load(tmp_path / "run.csv")
    assert again.digest == log.digest
    assert again.contact[2].any()
    assert again.contact_energy[2] > 0
    assert not again.contact[5:].any()


def test_a_flexible_base_takes_its_part():
    shape = replace(CONTACT.target[0], place=replace(PAYLOAD.grip, position=PAYLOAD.position))
    contact = replace(CONTACT, on="space", target=(shape,))
    system = System(vehicle=BENT, contact=contact)
    motion = Motion.straight(HOME, HOME + np.array([-0.15, 0.2, 0.1]), 0.4)
    log = play_motions(system, [motion], settle=0.2, record_dt=system.physics_dt).log(0)
    balance = EnergyBalance.of(log)
    assert np.abs(log.contact).max() > 5.0
    assert balance.relative <= 5e-3


def test_other_engines_name_the_one_that_can():
    with pytest.raises(ParameterError, match=r"backend mujoco has no contact .* use kernel"):
        Simulator(SYSTEM, backend="mujoco")
    assert Simulator(SYSTEM).backend_name == "kernel"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SYSTEM.replace(payload=None), "on the payload, of which there is none"),
        (lambda: SYSTEM.replace(mode="emulated"), "needs mode ideal, got mode emulated"),
        (
            lambda: SYSTEM.replace(arm=get_boom("shuttle-like").carry(PUMA_560)),
            "contact at the tool",
        ),
        (lambda: replace(CONTACT, stiffness=0.0), "stiffness must be > 0"),
        (lambda: replace(CONTACT, on="moon"), "on must be one of"),
        (lambda: replace(CONTACT, tool=()), "tool must be one shape"),
        (lambda: ContactShape(form="torus", size=(1.0,)), "form must be one of"),
        (
            lambda: replace(CONTACT, tool=(BOX,), target=(BOX,)),
            "no law for a box that meets a box: one of two",
        ),
        (lambda: ContactShape(form="box", size=(1.0, 1.0)), "size of a box"),
        (lambda: replace(CONTACT, friction=0.0), "friction and tangential_damping must be > 0"),
        (
            lambda: Simulator(SYSTEM.replace(contact=replace(CONTACT, tangential_damping=1e5))),
            r"physics_dt must be <= .* s for a contact of 20000 N/m and 100000 N s/m",
        ),
        (
            lambda: Simulator(SYSTEM.replace(contact=replace(CONTACT, stiffness=1e8))),
            r"physics_dt must be <= .* s for a contact of 1e\+08 N/m",
        ),
    ],
)
def test_refused(make, message):
    with pytest.raises(ParameterError, match=message):
        make()
