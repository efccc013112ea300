"""Claim: a simulation of the compiled kernel depends on nothing but itself.

Compared bit for bit, without tolerance: simulation i of a batch against the same simulation
in other batches, lanes and threads; next to neighbours in the same vector that are not a
number, that overflow or that stand still; and a run continued from a snapshot against the
one that was not interrupted.
"""

import pickle

import numpy as np
import pytest

from ves_gym.engine.kernel.build import LANES
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED, FREE_FLYING
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.state import State
from ves_gym.system.system import System

SYSTEMS = {
    "bent-thesis": System(vehicle=BENT_THESIS),
    "satellite": System(vehicle=FREE_FLYING, integrator="euler"),
    "prescribed": System(vehicle=BENT_THESIS, drive="prescribed", integrator="implicitfast"),
    "emulated": System(mode="emulated", vehicle=DECOUPLED),
}
MANY = 3 * 8 * LANES + 5  # enough for three threads
STEPS = 6

# what the fields of one simulation are overwritten with
WILD = {
    "nan angle": ("z", 7, np.nan),
    "nan base": ("z", 0, np.nan),
    "nan rate": ("zd", 6, np.nan),
    "infinite": ("zd", 8, np.inf),
    "absurd": ("zd", 7, 1e12),
    "overflows": ("zd", 4, 1e200),
}


def start(i: int) -> dict[str, np.ndarray]:
    """State of simulation i, whatever batch it is in."""
    rng = np.random.default_rng(i)
    return {
        "q": rng.uniform(-1, 1, 3),
        "v": rng.uniform(-0.3, 0.3, 3),
        "y": rng.uniform(-0.01, 0.01, 6),
        "yd": rng.uniform(-0.01, 0.01, 6),
    }


def simulator(name: str, which, threads: int = 1, **options) -> Simulator:
    """A batch of the simulations `which`, with gains of their own."""
    system, which = SYSTEMS[name], list(which)
    sim = Simulator(
        system, len(which), backend="kernel", threads=threads, warn_at=None, **options
    )
    rows = [start(i) for i in which]
    sim.reset(**{key: np.array([row[key] for row in rows]) for key in rows[0]})
    if system.drive == "motor":
        scale = 1 + 0.01 * np.array(which)[:, None]
        sim.set_gains(40 * scale, 10 * scale)  # no motor at its limit: commands are felt
    return sim


def advance(sim: Simulator, which, steps: int = STEPS, first: int = 0) -> list[State]:
    """Commands held and commands played in turn; each simulation has its own."""
    states, shape = [], (sim.system.substeps + 1, 3)
    size = 2.0 if sim.system.drive == "prescribed" else 40.0
    for j in range(first, first + steps):
        rngs = [np.random.default_rng([i, j]) for i in which]
        nodes = np.stack([rng.uniform(-size, size, shape) for rng in rngs])
        if j % 2:
            sim.play(nodes)
            states.append(sim.state)
        else:
            jets = {}
            if sim.system.base.body is not None:
                jets["base_wrench"] = 3 * np.tile(nodes[:, 0], 2)
            states.append(sim.step(nodes[:, 0], **jets))
    return states


def bits(states: list[State], i: int) -> bytes:
    """Everything about simulation i, all steps."""
    return b"".join(part[i].tobytes() for state in states for part in state)


def report(sim: Simulator, i: int) -> bytes:
    """What one simulation reports besides its state."""
    parts = sim.evaluate(1.0)
    if sim.emulation_loop is not None:
        parts += sim.readings
    return b"".join(part[i].tobytes() for part in parts)


@pytest.fixture(scope="module", params=SYSTEMS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def alone(name):
    """Bits of simulations 0 to 16, each in a batch of one: states, and what is reported."""
    found = []
    for i in range(17):
        sim = simulator(name, [i])
        states = advance(sim, [i])
        found.append((bits(states, 0), report(sim, 0)))
    return found


# ------------------------------------------------------------- batch, lane and thread


@pytest.mark.parametrize("n", [2, LANES - 1, LANES, LANES + 1, 2 * LANES + 1])
def test_the_size_of_the_batch_does_not_matter(name, alone, n):
    sim = simulator(name, range(n))
    states = advance(sim, range(n))
    for i in range(n):
        assert (bits(states, i), report(sim, i)) == alone[i]


def test_the_lane_does_not_matter(name, alone):
    """Every simulation in every lane."""
    for shift in range(LANES):
        which = np.roll(np.arange(LANES), shift).tolist()
        sim = simulator(name, which)
        states = advance(sim, which)
        for lane, i in enumerate(which):
            assert (bits(states, lane), report(sim, lane)) == alone[i]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_do_not_matter(name, alone, threads):
    which = [i % 17 for i in range(MANY)]
    sim = simulator(name, which, threads)
    assert sim.backend._threads == threads
    states = advance(sim, which)
    for place, i in enumerate(which):
        assert bits(states, place) == alone[i][0]


def test_identical_simulations_stay_identical(name):
    states = advance(simulator(name, [3] * 21), [3] * 21)
    assert len({bits(states, i) for i in range(21)}) == 1


def test_another_command_is_seen():
    """The comparison is not blind: a command changed by one part in 1e13 shows."""
    sims = [simulator("bent-thesis", [0]) for _ in range(2)]
    ends = []
    for sim, torque in zip(sims, (10.0, 10.0 * (1 + 1e-13)), strict=True):
        ends.append([sim.step(torque) for _ in range(3)])
    assert bits(ends[0], 0) != bits(ends[1], 0)


# ------------------------------------------------------------------------- neighbours


def spoil(sim: Simulator, i: int, case: str) -> None:
    """Overwrite one number of simulation i inside the engine."""
    field, column, value = WILD[case]
    time, z, zd = (part[i : i + 1].copy() for part in sim.backend.read())
    {"z": z, "zd": zd}[field][:, column] = value
    sim.backend.write(np.array([i]), time, z, zd)


@pytest.mark.parametrize("lane", [pytest.param(0, marks=pytest.mark.slow), 5])
@pytest.mark.parametrize("case", WILD)
def test_what_is_no_number_stays_in_its_lane(name, case, lane):
    n, others = LANES, [i for i in range(LANES) if i != lane]
    which = range(n)
    sim = simulator(name, which, on_divergence="mark")
    twin = simulator(name, which)
    advance(sim, which, 2)
    advance(twin, which, 2)
    spoil(sim, lane, case)
    found, wanted = advance(sim, which, 4, first=2), advance(twin, which, 4, first=2)
    assert sim.diverged.tolist() == [i == lane for i in which]
    for i in others:
        assert bits(found, i) == bits(wanted, i)
        assert report(sim, i) == report(twin, i)
    # from the period in which it was found on it stays where it is, its clock too
    assert len({bits([state], lane) for state in found}) == 1
    # and it comes back as new
    sim.reset(**start(lane), ids=[lane])
    twin.reset(**start(lane), ids=[lane])
    assert not sim.diverged.any()
    found, wanted = advance(sim, which, 2), advance(twin, which, 2)
    for i in which:
        assert bits(found, i) == bits(wanted, i)


@pytest.mark.parametrize("how", ["step", "play"])
def test_only_the_diverged_are_reported(how):
    sim = simulator("bent-thesis", range(11))
    for lane in (2, 9):
        spoil(sim, lane, "nan rate" if lane == 2 else "absurd")
    with pytest.raises(Divergence, match="simulation 2 of 11 diverged at t = 0") as found:
        sim.step(0.0) if how == "step" else sim.play(np.zeros((11, 11, 3)))
    assert found.value.ids.tolist() == [2, 9]
    sim.step(0.0)  # known by now
    assert np.flatnonzero(sim.diverged).tolist() == [2, 9]


def test_nobody_reads_the_lanes_that_fill_up_the_last_block(name, alone):
    sim = simulator(name, range(3))
    sim.backend._x[0, :, 3:] = np.nan
    states = advance(sim, range(3))
    assert not sim.diverged.any()
    assert not sim.backend.faults().any()
    for i in range(3):
        assert (bits(states, i), report(sim, i)) == alone[i]


def test_simulations_not_named_stay_where_they_are(name):
    """`ids` of the engine: a subset goes on, the others keep state and clock."""
    sim, twin = simulator(name, range(11)), simulator(name, range(11))
    ids, before, k = np.array([1, 2, 9]), sim.state, sim.system.substeps
    command, nodes = np.ones((11, 3)), np.ones((11, k + 1, 3))
    for engine, some in ((sim.backend, ids), (twin.backend, None)):
        if sim.system.mode == "emulated":
            engine.step_on_platform(nodes, np.full((11, k + 1, 6), 0.1), some)
        else:
            engine.step_sequence(np.broadcast_to(command[:, None], nodes.shape), some)
        engine.step_sequence(nodes, some)
    for i in range(11):
        wanted = twin.state if i in ids else before
        assert bits([sim.state], i) == bits([wanted], i)


# -------------------------------------------------------------------------- snapshots


@pytest.mark.parametrize("fresh", [False, True], ids=["same simulator", "fresh simulator"])
def test_a_snapshot_continues_identically(name, fresh):
    which = range(LANES + 3)
    sim = simulator(name, which, on_divergence="mark")
    spoil(sim, 4, "absurd")
    advance(sim, which, 3)
    kept = pickle.loads(pickle.dumps(sim.snapshot()))
    expected = advance(sim, which, 3, first=3)
    reported = [report(sim, i) for i in which]

    other = sim
    if fresh:
        other = simulator(name, np.arange(LANES + 3) + 100, threads=2, on_divergence="mark")
    other.restore(kept)
    assert np.flatnonzero(other.diverged).tolist() == [4]
    found = advance(other, which, 3, first=3)
    for i in which:
        assert bits(found, i) == bits(expected, i)
        assert report(other, i) == reported[i]


def test_a_snapshot_keeps_its_place():
    sim = simulator("bent-thesis", range(3))
    advance(sim, range(3), 2)
    kept, before = sim.snapshot(), sim.state
    advance(sim, range(3), 2)
    sim.restore(kept)
    sim.step(5.0)
    sim.restore(kept)
    for i in range(3):
        assert bits([sim.state], i) == bits([before], i)
