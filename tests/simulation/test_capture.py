"""Payloads of a simulator: free flight, grasp, carry, release; state, errors, laboratory."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from tests.free_bodies import momentum_of
from ves_gym._util.optional import installed
from ves_gym._util.params import ParameterError
from ves_gym.effects.joint_drive import JointElasticity
from ves_gym.effects.payload import PayloadMass
from ves_gym.mechanics.attitude import rotate
from ves_gym.mechanics.latch import body_momentum
from ves_gym.mechanics.link import Inertial, Mount, diagonal
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.spatial import quadratic
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, SERVICER_FLEXIBLE
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

BODY = Inertial(mass=12.0, com=(0.05, 0.0, 0.02), inertia=diagonal(0.3, 0.5, 0.4))
PAYLOAD = Payload(inertial=BODY, spin=(0.1, 0.8, -0.2), latch_distance=9.0)
SYSTEM = System(vehicle=FREE_FLOATING, payload=PAYLOAD, physics_dt=2.5e-3)
HOME = np.array([0.3, 0.4, -0.8])


def moving(system: System = SYSTEM, n: int = 3, **settings) -> Simulator:
    sim = Simulator(system, n, **settings)
    sim.reset(q=HOME, v=[0.2, -0.1, 0.3])
    return sim


def played(sim: Simulator, periods: int = 10) -> np.ndarray:
    hold = sim.servo_command(np.tile(HOME, (sim.n, 1)), np.zeros((sim.n, 3)))
    for _ in range(periods):
        sim.step(hold)
    return np.concatenate([*sim.state[1:], *sim.payload.state], axis=1)


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
def test_a_snapshot_continues_exactly_whether_it_carries_or_not(backend):
    sim = moving(backend=backend)
    played(sim, 3)
    sim.grasp([0, 2])
    played(sim, 3)
    snapshot = pickle.loads(pickle.dumps(sim.snapshot()))
    sim.release([2])
    once = played(sim)
    sim.reset()
    assert not sim.payload.carried.any()
    assert sim.payload.events == []
    sim.restore(snapshot)
    assert sim.payload.carried.tolist() == [True, False, True]
    assert [e.kind for e in sim.payload.events] == ["grasp", "grasp"]
    sim.release([2])
    assert played(sim).tobytes() == once.tobytes()


def test_simulations_do_not_touch_each_other():
    sim, alone = moving(n=3), moving(n=1)
    played(sim, 3), played(alone, 3)
    sim.grasp([1]), alone.grasp()
    assert np.abs(played(sim)[1] - played(alone)[0]).max() <= 1e-12


def test_a_released_payload_flies_on_as_it_moved():
    sim = moving()
    sim.grasp()
    played(sim)
    before, momentum = sim.payload.state, sim.payload.momentum
    sim.release([0])
    for a, b in zip(before, sim.payload.state, strict=True):
        assert np.abs(a - b).max() <= 1e-15
    assert np.abs(sim.payload.momentum - momentum).max() <= 1e-12
    com = before.position + rotate(before.attitude, np.tile(BODY.com, (3, 1)))
    played(sim, 8)
    after = sim.payload.state
    flown = after.position + rotate(after.attitude, np.tile(BODY.com, (3, 1)))
    assert np.abs(flown[0] - com[0] - 0.1 * before.velocity[0]).max() <= 1e-12


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
def test_a_system_assigned_in_flight_leaves_the_payload_where_it_is(backend):
    system = SYSTEM.replace(effects=(PayloadMass(mass=1.0),))
    heavier = system.replace(effects=(PayloadMass(mass=4.0),))
    sim, other = moving(system, 1, backend=backend), moving(heavier, 1, backend=backend)
    sim.assign([heavier])
    sim.grasp(), other.grasp()
    sim.assign([system]), sim.assign([heavier])
    assert np.abs(played(sim) - played(other)).max() <= 1e-12


def test_masses_of_their_own():
    sim = moving(n=2)
    ids = np.arange(2)
    sim.payload.change(ids, mass=[2.0, 50.0], inertia=np.stack([0.1 * np.eye(3), np.eye(3)]))
    lost = [event.lost for event in sim.grasp()]
    assert lost[1] > lost[0]
    sim.reset()
    assert sim.payload.mass.tolist() == [12.0, 12.0]
    other = replace(PAYLOAD, inertial=replace(BODY, mass=3.0))
    sim.assign([SYSTEM.replace(payload=other)], [1])
    assert sim.payload.mass.tolist() == [12.0, 3.0]


@pytest.mark.filterwarnings("ignore:backend gpu-kernel:UserWarning")
def test_gears_that_give_way_take_their_part_of_the_impulse():
    system = SYSTEM.replace(
        effects=(JointElasticity(compliance=(1e-4,) * 3, damping=(5.0,) * 3),)
    )
    engines = ["kernel", "mujoco", *(["gpu-kernel"] if installed("warp") else [])]
    ends = []
    for backend in engines:
        sim = moving(system, 1, backend=backend)
        played(sim, 4)
        momentum, energy = sim.payload.momentum, np.add(*sim.payload.energy)
        (event,) = sim.grasp()
        assert np.abs(sim.payload.momentum - momentum).max() <= 1e-12
        assert (energy - np.add(*sim.payload.energy))[0] == pytest.approx(event.lost, rel=1e-9)
        ends.append(played(sim))
    assert np.ptp(ends, axis=0).max() <= 1e-9


@pytest.mark.parametrize("vehicle", [SERVICER_FLEXIBLE, BENT_THESIS, FREE_FLOATING])
def test_the_ledger_is_the_mass_matrix_of_the_latch(vehicle):
    """Compiled, and as the latch has arm, base, gears, wheels and appendages in NumPy."""
    gear = JointElasticity(compliance=(1e-4,) * 3, damping=(5.0,) * 3)
    free = replace(PAYLOAD, spin=(0.1, 0.0, 0.2))
    sim = Simulator(System(vehicle=vehicle, payload=free, effects=(gear,)), 2)
    rng = np.random.default_rng(3)
    sim.reset(q=rng.uniform(-1, 1, (2, 3)), v=rng.uniform(-1, 1, (2, 3)),
              y=rng.uniform(-0.5, 0.5, (2, 6)), yd=rng.uniform(-0.1, 0.1, (2, 6)))  # fmt: skip
    sim.step(np.ones((2, 3)))
    ids = np.arange(2)
    motion, rates = sim.payload._motion(ids)
    M, of_body, com = sim.payload._bodies(ids)
    own = momentum_of(motion.mass, rates, sim.state.y) + body_momentum(M, of_body, com)
    momentum, energy, payload = sim.payload.ledger(ids)
    np.testing.assert_allclose(momentum, own, rtol=1e-11, atol=1e-10)
    np.testing.assert_allclose(energy, quadratic(motion.mass, rates), rtol=1e-11)
    np.testing.assert_allclose(payload, quadratic(M, of_body), rtol=1e-11)


def test_in_the_laboratory_a_stand_holds_it_and_the_estimate_does_not_know_it():
    system = System(vehicle=BENT_THESIS, payload=PAYLOAD, mode="emulated", physics_dt=2.5e-3)
    sim = Simulator(system, 2, warn_at=None)
    sim.reset(q=HOME)
    before = played(sim, 4)
    assert np.abs(sim.payload.state.position).max() == 0.0  # nothing floats there
    sim.grasp([1])
    moved = played(sim, 40)
    unknown = sim.readings.wrench - sim.readings.gravity  # taken for a force of the arm's
    assert unknown[1, 2] - unknown[0, 2] == pytest.approx(-12 * 9.81, rel=0.2)
    assert moved[1, 2] < before[1, 2] - 1e-3  # so the emulated base gives way
    assert abs(moved[0, 2] - before[0, 2]) < 1e-3


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda sim: sim.release(), "simulation 0 carries no payload"),
        (lambda sim: (sim.grasp([1]), sim.grasp()), "simulation 1 carries its payload already"),
        (lambda sim: sim.grasp(directions=["up"]), "directions must be some of x, y, z"),
        (lambda sim: sim.payload.change(np.arange(3), mass=1.0), r"shape \(3,\)"),
        (lambda sim: sim.payload.change(np.arange(3), weight=[1.0]), "got 'weight'"),
        (lambda sim: sim.payload.change(np.arange(1), mass=[0.0]), "must be > 0 kg"),
        (lambda sim: sim.assign([SYSTEM.replace(payload=None)] * 3), "the payload must be"),
    ],
)
def test_refused(act, message):
    sim = moving()
    with pytest.raises(ParameterError, match=message):
        act(sim)


def test_out_of_reach_is_refused_with_the_distance_and_the_turn():
    near = replace(PAYLOAD, latch_distance=0.01)
    sim = moving(SYSTEM.replace(payload=near))
    with pytest.raises(ParameterError, match=r"within 0.01 m of the fixture, the tool is 1.2"):
        sim.grasp()
    assert not sim.payload.carried.any()
    turned = replace(PAYLOAD, latch_angle=0.01, grip=Mount(angles=(0.0, 2.0, 0.0)))
    with pytest.raises(ParameterError, match="deg away"):
        moving(SYSTEM.replace(payload=turned)).grasp()


def test_a_payload_is_a_body():
    with pytest.raises(ParameterError, match="mass must be > 0 kg"):
        replace(PAYLOAD, inertial=replace(BODY, mass=0.0))
    with pytest.raises(ParameterError, match="must be positive definite"):
        replace(PAYLOAD, inertial=replace(BODY, inertia=diagonal(0.0, 0.0, 0.0)))
    with pytest.raises(ParameterError, match="system has no payload"):
        Simulator(System(vehicle=BENT_THESIS)).grasp()
    again = System.from_dict(SYSTEM.to_dict())
    assert again == SYSTEM
    assert again.hash == SYSTEM.hash != SYSTEM.replace(payload=None).hash


def test_a_satellite_that_tumbles_past_the_end_of_its_angles_captures_all_the_same():
    sim = moving(n=2)
    sim.reset(q=HOME, yd=[0.0, 0.0, 0.0, 0.1, 1.2, -0.2])
    played(sim, 104)
    momentum, energy = sim.payload.momentum, np.add(*sim.payload.energy)
    assert np.abs(sim.state.y[:, 4]).min() > np.deg2rad(75)  # all but at phi_y = 90 deg
    (event,) = sim.grasp([1])
    assert np.abs(sim.payload.momentum - momentum).max() <= 1e-11
    assert (energy - np.add(*sim.payload.energy))[1] == pytest.approx(event.lost, rel=1e-9)
    assert np.abs(sim.payload.relative([1])).max() <= 1e-12
    played(sim, 40)
    assert np.abs(sim.payload.momentum - momentum).max() <= 1e-8
