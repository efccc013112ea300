"""Memory of the loop across snapshots and rewirings, in rows and in lanes."""

import numpy as np
import pytest

from tests.simulation.blocks.machines import simulator_of
from ves_gym.effects import GravityDelay, PlatformDelay
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

# kinds alike, so that one can be assigned to the simulator of the other
SOON = System(
    vehicle=BENT_THESIS,
    mode="emulated",
    effects=(PlatformDelay(delay=0.0), GravityDelay(delay=0.0)),
)
LATE = SOON.replace(effects=(PlatformDelay(delay=0.05), GravityDelay(delay=0.12)))
compiled_or_not = pytest.mark.parametrize("compiled", [True, False])


def swing(sim, periods):
    out = []
    for _ in range(periods):
        t = sim.state.time[:, None]
        q = np.array([0.3, 0.2, -0.3]) * np.sin(5 * t + np.arange(sim.n)[:, None])
        sim.step(sim.servo_command(q, np.zeros_like(q)))
        out.append(np.concatenate([*sim.state[1:], *sim.readings], axis=-1))
    return np.array(out)


@compiled_or_not
def test_a_delay_assigned_later_rewires_the_loop(compiled, monkeypatch):
    """Simulation 1 becomes late; after its reset it is as in a simulator of its own.

    Neighbours run on, bit for bit, though the loop has other blocks then: a model beside the
    platform. Blocks are compiled one by one, so that they round as before.
    """
    sim, alone, twin = (simulator_of(monkeypatch, k, n, compiled=compiled) for k, n in
                        ((SOON, 3), (LATE, 3), (SOON, 3)))  # fmt: skip
    loop = sim.emulation_loop
    assert loop.memory.shapes["command_line.history"] == (0, 12)
    assert "platform_model" not in [b.name for b in loop.wiring.blocks]
    np.testing.assert_array_equal(swing(sim, 12), swing(twin, 12))
    sim.assign([LATE], [1])
    assert loop.memory.shapes["command_line.history"] == (5, 12)
    assert loop.memory.shapes["gravity_estimate.history"][0] > 10
    assert "platform_model" in [b.name for b in loop.wiring.blocks]
    assert (loop._code is not None) == compiled
    ours, theirs = swing(sim, 12), swing(twin, 12)
    for i in (0, 2):
        np.testing.assert_array_equal(ours[:, i], theirs[:, i])
    assert np.abs(ours[:, 1] - theirs[:, 1]).max() > 1e-3

    for k in (sim, alone):
        k.reset()
    ours, theirs = swing(sim, 12), swing(alone, 12)
    np.testing.assert_array_equal(ours[:, 1], theirs[:, 1])


@compiled_or_not
def test_a_snapshot_fits_memory_of_another_length(compiled, monkeypatch):
    """Taken before the memory grew, or restored where it is still short: it goes on alike."""
    sim = simulator_of(monkeypatch, SOON, 2, compiled=compiled)
    swing(sim, 8)
    before = sim.snapshot()
    wanted = swing(sim, 12)
    sim.restore(before)
    sim.assign([LATE], [1])
    swing(sim, 8)
    late = sim.snapshot()
    wanted_late = swing(sim, 12)

    sim.restore(before)  # short memory into long
    assert sim.systems == (SOON, SOON)
    assert sim.emulation_loop.memory.shapes["command_line.history"] == (5, 12)
    np.testing.assert_array_equal(swing(sim, 12), wanted)

    fresh = simulator_of(monkeypatch, SOON, 2, compiled=compiled)
    assert fresh.emulation_loop.memory.shapes["command_line.history"] == (0, 12)
    fresh.restore(late)  # long memory into short
    assert fresh.systems[1].hash == LATE.hash
    np.testing.assert_array_equal(swing(fresh, 12), wanted_late)
