"""The compiled loop gives the answers of the blocks in NumPy.

Systems run for a second on the same compiled engine, their blocks once compiled and once in
NumPy: every operation, platform, kind of vehicle and drive, with and without payload
compensation, late computers, coarse transducers, and every registered effect of the mode.

Tolerance: 1e-9 of max(1, value) for angles, poses and rates (SI), of max(1000, value) for
readings [N, N m]; safety stops at the same instant for the same reason. Both run one text, so
what is left is rounding. A loop that is unstable, or has gears with play, amplifies it; where
1e-9 is exceeded, the difference must be below ten times what 1e-15 at the start becomes in
NumPy alone. An error of 1e-7 in a parameter of one of them is seen.
"""

import numpy as np
import pytest

from tests.simulation.blocks.machines import (
    COUNT,
    DURATION,
    KINDS,
    gap,
    run,
    simulator_of,
    system,
)
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

MOST = 1e-9
QUICK = (1, 2, 3)  # plain satellite, admittance, position


def compare(index, monkeypatch):
    """Hold the two runs of system `index` to each other; their difference, and what 1e-15 at
    the start becomes where that had to be asked."""
    mine = system(index)
    sims = [simulator_of(monkeypatch, mine, 2, compiled=k) for k in (True, False)]
    assert sims[1].emulation_loop._code is None
    assert sims[0].emulation_loop._code is not None
    ours, theirs = (run(sim, index, DURATION) for sim in sims)
    assert sims[0].events == sims[1].events
    worst, nudged = gap(ours, theirs), 0.0
    if worst > MOST:
        nudged = gap(run(sims[1], index, DURATION, 1e-15), theirs)
        assert nudged > MOST / 10
        eighth = len(ours) // 8
        assert gap(ours[:eighth], theirs[:eighth]) <= MOST
    assert worst <= max(MOST, 10 * nudged)
    print(f"system {index}: {worst:.1e}, {nudged:.1e}, {len(sims[0].events)} safety stops")
    return worst


@pytest.mark.parametrize("index", QUICK)
def test_both_give_the_same(index, monkeypatch):
    assert compare(index, monkeypatch) <= MOST


@pytest.mark.slow
@pytest.mark.parametrize("index", [k for k in range(COUNT) if k not in QUICK])
def test_all_give_the_same(index, monkeypatch):
    compare(index, monkeypatch)


def test_the_cases_are_what_they_should_be():
    """Every effect of the mode, and no two systems alike."""
    every = [system(k) for k in range(COUNT)]
    assert len({s.hash for s in every}) == COUNT
    assert {e.kind for s in every for e in s.effects} == set(KINDS)


def test_a_wrong_parameter_is_seen(monkeypatch):
    """The sensor's matrix off by 1e-7 in the compiled one: the comparison must fail."""
    mine = system(1)
    ours, theirs = (simulator_of(monkeypatch, mine, 2, compiled=k) for k in (True, False))
    loop = ours.emulation_loop
    loop.p["force_sensor"]["to_signal"] *= 1 + 1e-7
    loop._code.load(loop.p)
    assert gap(run(ours, 0, 0.5), run(theirs, 0, 0.5)) > MOST


def test_lanes_have_parameters_of_their_own(monkeypatch):
    """Eleven simulations in two blocks of lanes, each with other effects."""
    mine = system(0)
    rng = np.random.default_rng(0)

    def varied(effect):
        share = rng.uniform(0.5, 1.0)
        return type(effect)(
            **{k: (share * np.array(v)).tolist() for k, v in vars(effect).items()}
        )

    others = [mine.replace(effects=tuple(map(varied, mine.effects))) for _ in range(11)]
    sims = [simulator_of(monkeypatch, mine, 11, compiled=k) for k in (True, False)]
    for sim in sims:
        sim.assign(others)
    assert len(mine.effects) > 2
    assert gap(run(sims[0], 0, 0.5), run(sims[1], 0, 0.5)) <= MOST


def test_a_learnt_weight_runs_compiled(monkeypatch):
    """A table in place of the estimate rewires the loop (thesis 3.3)."""
    mine = System(vehicle=BENT_THESIS, mode="emulated")
    table = np.random.default_rng(0).normal([0, 0, -900, 0, 0, 0], 5.0, (2, 30, 6))
    sims = [simulator_of(monkeypatch, mine, 2, compiled=k) for k in (True, False)]
    for sim in sims:
        sim.use_gravity(table)
        assert "table" in sim.emulation_loop.wiring.external
    ours, theirs = (run(sim, 0, 0.5) for sim in sims)
    assert gap(ours, theirs) <= MOST
    np.testing.assert_array_equal(ours[10][6], theirs[10][6])


def test_what_is_compiled_when():
    """The kernel's loop is compiled; MuJoCo's, and a vehicle that is a function, are not."""

    def code(system=System(vehicle=BENT_THESIS, mode="emulated"), **options):
        return Simulator(system, warn_at=None, **options).emulation_loop._code

    assert code(backend="kernel") is not None
    assert code(backend="mujoco") is None

    def spring(X, W):
        return np.concatenate([X[:, 6:], W / 1e3 - 4.0 * X[:, :6]], axis=-1)

    plain = EmulatorSettings(payload_compensation=False)
    for emulator in (plain, EmulatorSettings()):
        machine = System(mode="emulated", vehicle=FREE_FLOATING, emulator=emulator)
        assert code(machine, backend="kernel", admittance=spring) is None
        assert code(machine, backend="kernel") is not None
