"""Claim: a simulation does not depend on its batch, on threads or on its neighbours.

Compared bit for bit, without tolerance: simulation i of a batch against the same
simulation alone, on one thread and on two, in other places, next to quiet and to diverging
neighbours; and a run continued from a snapshot against the run that was not interrupted.
"""

import pickle

import numpy as np
import pytest

from ves_gym import effects
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.state import State
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
    sim = Simulator(system or System(vehicle=BENT_THESIS), n, threads=threads, seed=7)
    sim.reset(spread=SPREAD)
    return advance(sim, np.stack([commands(i) for i in range(n)], axis=1))


@pytest.mark.parametrize("name", ["bent-thesis", "free-floating"])
def test_batch_size_and_threads_do_not_matter(name):
    system = System(vehicle=VEHICLES[name])
    reference = batch(8, 1, system)
    for n, threads in ((8, 2), (3, 1), (1, 1), (16, 2)):
        other = batch(n, threads, system)
        for i in range(min(n, 8)):
            assert np.array_equal(rows(other, i), rows(reference, i)), (n, threads, i)


# laws with every function that laws may use, on joints with gears and without
LAWS = (
    effects.JointStribeck(coulomb=(3.0, 4.0, 2.0), stiction=(6.0, 8.0, 4.0), fade_speed=0.3),
    effects.JointLoadFriction(coefficient=(0.05, 0.1, 0.02)),
    effects.JointAsymmetry(coulomb=(1.0, 2.0, 0.5), viscous=(0.5, 0.2, 0.1)),
    effects.JointRipple(
        amplitude=(1.0, 0.5, 2.0), cycles=(36.0, 7.0, 50.0), phase=(0.1, 0.2, 0.3)
    ),
    effects.JointTorqueLimit(fraction=(0.7, 0.2, 0.1)),
)
GEARS = effects.JointElasticity(compliance=(5e-5, 5e-5, 1e-4), damping=(20.0, 20.0, 10.0))
PLACES = [[4], [9, 4], [0, 1, 4], [1, 2, 3, 4, 0], [*range(5, 17), 4], [*range(19)]]


def run(system: System, which: list[int], backend: str) -> dict[int, np.ndarray]:
    """Everything about the simulations `which`, in this order, by their number."""
    sim = Simulator(system, len(which), backend=backend, warn_at=None)
    rngs = [np.random.default_rng([3, i]) for i in which]
    for place, rng in enumerate(rngs):
        sim.reset(q=rng.uniform(-1, 1, 3), v=rng.uniform(-0.3, 0.3, 3), ids=[place])
    torque = np.stack([commands(i)[:8] for i in which], axis=1)
    states = advance(sim, torque)
    reported = np.concatenate(sim.evaluate(torque[0]), axis=1)
    return {i: np.append(rows(states, k), reported[k]) for k, i in enumerate(which)}


def require_that_places_do_not_matter(system: System, backend: str) -> None:
    """Simulation 4 alone, and among others in several places of batches of several sizes."""
    expected = run(system, PLACES[0], backend)[4]
    for which in PLACES[1:]:
        assert run(system, which, backend)[4].tobytes() == expected.tobytes(), which


@pytest.mark.parametrize("backend", ["kernel", "mujoco"])
@pytest.mark.parametrize("mode", ["ideal", "emulated"])
@pytest.mark.parametrize("geared", [False, True], ids=["stiff", "geared"])
def test_the_place_does_not_matter(mode, backend, geared):
    system = System(vehicle=BENT_THESIS, mode=mode, effects=(*LAWS, GEARS) if geared else LAWS)
    require_that_places_do_not_matter(system, backend)


def test_neighbours_do_not_matter():
    """Other torques, gains and states next door, and a reset of some of them on the way."""
    alone = Simulator(System(vehicle=BENT_THESIS), 1)
    alone.reset(q=[0.3, -0.4, 0.5], y=[0.01, 0, 0.02, 0, 0.001, 0])
    expected = rows(advance(alone, commands(0)[:, None]), 0)

    crowd = Simulator(System(vehicle=BENT_THESIS), 5, threads=2)
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
    alone = Simulator(System(vehicle=BENT_THESIS), 1)
    alone.reset(q=0.2)
    expected = rows(advance(alone, commands(0)[:, None]), 0)

    pair = Simulator(System(vehicle=BENT_THESIS), 2, on_divergence="mark")
    pair.reset(q=0.2)
    pair.reset(v=1e9, yd=1e9, ids=[1])
    torque = np.stack([commands(0), commands(1)], axis=1)
    states = advance(pair, torque)
    assert pair.diverged.tolist() == [False, True]
    assert np.array_equal(rows(states, 0), expected)


def test_another_command_is_seen():
    """The comparison is not blind: one torque changed by one part in 1e12 shows."""
    sims = [Simulator(System(vehicle=BENT_THESIS), 1) for _ in range(2)]
    first, second = (commands(0)[:, None] for _ in range(2))
    second[3] *= 1 + 1e-12
    ends = [advance(s, c)[-1] for s, c in zip(sims, (first, second), strict=True)]
    assert not np.array_equal(ends[0].q, ends[1].q)


def test_motions_played_together_or_alone():
    motions = [
        Motion.straight(np.zeros(3), np.deg2rad([30.0 * i, 20, -10 * i]), 1.0) for i in range(4)
    ]
    together = play_motions(System(vehicle=BENT_THESIS), motions, settle=0.5)
    for i, motion in enumerate(motions):
        alone = play_motions(System(vehicle=BENT_THESIS), [motion], settle=0.5)
        for name in ("q", "v", "tau", "y", "yd", "w"):
            assert np.array_equal(getattr(alone, name)[0], getattr(together, name)[i]), name


@pytest.mark.parametrize("name", ["bent-thesis", "free-floating"])
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
    kept = Simulator(System(vehicle=BENT_THESIS), 2).snapshot()
    with pytest.raises(ParameterError, match="snapshot"):
        Simulator(System(vehicle=BENT_THESIS), 3).restore(kept)
    with pytest.raises(ParameterError, match="snapshot"):
        Simulator(System(vehicle=BENT_THESIS, physics_dt=2.5e-3), 2).restore(kept)
