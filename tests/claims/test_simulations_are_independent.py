"""Claim: a simulation does not depend on its batch, on threads or on its neighbours.

Compared bit for bit, without tolerance: simulation i of a batch against the same
simulation alone, on one thread and on two, next to quiet and to diverging neighbours;
and a run continued from a snapshot against the run that was not interrupted.
"""

import pickle

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator, State
from ves_gym.system.system import System

STEPS = 40
SPREAD = {"q": 0.5, "v": 0.3, "y": 0.01, "yd": 0.02}


def commands(i: int) -> np.ndarray:
    """(STEPS, 3) torques of simulation i [N m]."""
    return np.random.default_rng(i).uniform(-50, 50, (STEPS, 3))


def advance(sim: Simulator, torques: np.ndarray) -> list[State]:
    """torques (STEPS, n, 3)."""
    return [sim.step(row) for row in torques]


def rows(states: list[State], i: int) -> np.ndarray:
    """Everything about simulation i, all steps."""
    return np.array([np.concatenate([[s.time[i]], *(x[i] for x in s[1:])]) for s in states])


def batch(n: int, threads: int, system: System | None = None) -> list[State]:
    sim = Simulator(system or System(), n, threads=threads, seed=7)
    sim.reset(spread=SPREAD)
    return advance(sim, np.stack([commands(i) for i in range(n)], axis=1))


@pytest.mark.parametrize("name", ["bent", "free-floating"])
def test_batch_size_and_threads_do_not_matter(name):
    system = System(vehicle=VEHICLES[name])
    reference = batch(8, 1, system)
    for n, threads in ((8, 2), (3, 1), (1, 1), (16, 2)):
        other = batch(n, threads, system)
        for i in range(min(n, 8)):
            assert np.array_equal(rows(other, i), rows(reference, i)), (n, threads, i)


def test_neighbours_do_not_matter():
    """Other torques, gains and states next door, and a reset of some of them on the way."""
    alone = Simulator(System(), 1)
    alone.reset(q=[0.3, -0.4, 0.5], y=[0.01, 0, 0.02, 0, 0.001, 0])
    expected = rows(advance(alone, commands(0)[:, None]), 0)

    crowd = Simulator(System(), 5, threads=2)
    crowd.reset(q=1.0, v=-0.5)
    crowd.reset(q=[0.3, -0.4, 0.5], y=[0.01, 0, 0.02, 0, 0.001, 0], ids=[2])
    crowd.set_gains(500.0, 5.0, ids=[1, 3])
    states = []
    for k in range(STEPS):
        torque = np.random.default_rng(100 + k).uniform(-80, 80, (5, 3))
        torque[2] = commands(0)[k]
        states.append(crowd.step(torque))
        if k == STEPS // 2:
            crowd.reset(q=-1.0, ids=[0, 4])
    assert np.array_equal(rows(states, 2), expected)


def test_a_diverging_neighbour_does_not_matter():
    alone = Simulator(System(), 1)
    alone.reset(q=0.2)
    expected = rows(advance(alone, commands(0)[:, None]), 0)

    pair = Simulator(System(), 2, on_divergence="mark")
    pair.reset(q=0.2)
    pair.reset(v=1e9, yd=1e9, ids=[1])
    torque = np.stack([commands(0), commands(1)], axis=1)
    states = advance(pair, torque)
    assert pair.diverged.tolist() == [False, True]
    assert np.array_equal(rows(states, 0), expected)


def test_another_command_is_seen():
    """The comparison is not blind: one torque changed by one part in 1e12 shows."""
    sims = [Simulator(System(), 1) for _ in range(2)]
    first, second = (commands(0)[:, None] for _ in range(2))
    second[3] *= 1 + 1e-12
    ends = [advance(s, c)[-1] for s, c in zip(sims, (first, second), strict=True)]
    assert not np.array_equal(ends[0].q, ends[1].q)


def test_motions_played_together_or_alone():
    motions = [
        Motion.straight(np.zeros(3), np.deg2rad([30.0 * i, 20, -10 * i]), 1.0) for i in range(4)
    ]
    together = play_motions(System(), motions, settle=0.5)
    for i, motion in enumerate(motions):
        alone = play_motions(System(), [motion], settle=0.5)
        for name in ("q", "v", "tau", "y", "yd", "w"):
            assert np.array_equal(getattr(alone, name)[0], getattr(together, name)[i]), name


@pytest.mark.parametrize("name", ["bent", "free-floating"])
@pytest.mark.parametrize("fresh", [False, True], ids=["same simulator", "fresh simulator"])
def test_snapshot_continues_identically(name, fresh):
    system = System(vehicle=VEHICLES[name])
    sim = Simulator(system, 3, seed=7)
    sim.reset(spread=SPREAD)
    sim.set_gains(700.0, 20.0, ids=[1])
    torque = np.stack([commands(i) for i in range(3)], axis=1)
    advance(sim, torque[:17])
    kept = pickle.loads(pickle.dumps(sim.snapshot()))
    expected = advance(sim, torque[17:])
    drawn = sim.reset(spread=SPREAD)  # the generators are part of the snapshot

    other = Simulator(system, 3, seed=0) if fresh else sim
    other.restore(kept)
    found = advance(other, torque[17:])
    for i in range(3):
        assert np.array_equal(rows(found, i), rows(expected, i))
    again = other.reset(spread=SPREAD)
    assert all(np.array_equal(a, b) for a, b in zip(again, drawn, strict=True))


def test_a_foreign_snapshot_is_refused():
    kept = Simulator(System(), 2).snapshot()
    with pytest.raises(ParameterError, match="snapshot"):
        Simulator(System(), 3).restore(kept)
    with pytest.raises(ParameterError, match="snapshot"):
        Simulator(System(physics_dt=2.5e-3), 2).restore(kept)
