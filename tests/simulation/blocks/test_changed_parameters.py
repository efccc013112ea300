"""What follows from the parameters that have changed is derived anew, and only that.

One simulator has every effect on laboratory, arm and vehicle; some of its simulations get one
of them at another value. Reference: all blocks' parameters derived from scratch, bit for bit.
"""

import dataclasses

import numpy as np
import pytest

from tests.effects import values
from tests.simulation.blocks.machines import KINDS, simulator_of
from ves_gym.effects import EFFECTS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.blocks.block import Block
from ves_gym.system.effect import LaboratoryEffect
from ves_gym.system.effect_rows import BODIES, EffectRows
from ves_gym.system.system import System

ACTING = [
    kind
    for kind in KINDS
    if issubclass(EFFECTS[kind], (LaboratoryEffect, *BODIES)) and kind != "joint/elasticity"
]  # gears with play are gears already
N, IDS = 11, np.array([9, 0, 4])  # in two blocks of lanes


def changed(effect):
    """The effect at 0.7 of its value."""
    share = {
        field.name: (0.7 * np.array(getattr(effect, field.name))).tolist()
        for field in dataclasses.fields(effect)
    }
    return type(effect)(**share)


@pytest.fixture(scope="module")
def machine():
    effects = tuple(values.effect(kind) for kind in ACTING)
    mine = System(vehicle=BENT_THESIS, mode="emulated", effects=effects)
    with pytest.MonkeyPatch.context() as patch:
        return simulator_of(patch, mine, N, compiled=True)


def derived(loop):
    """Parameters of all blocks, from scratch."""
    return {
        b.name: b.parameters(loop.numbers.parameters, loop.numbers.bodies)
        for b in loop.wiring.blocks
    }


def require_derived(loop):
    for block, expected in derived(loop).items():
        for name, wanted in expected.items():
            assert loop.p[block][name].tobytes() == np.ascontiguousarray(wanted).tobytes(), name
    lanes = loop._code._p.copy()
    loop._code.load(loop.p)
    np.testing.assert_array_equal(loop._code._p, lanes)


@pytest.mark.parametrize("ids", [IDS, np.arange(N)], ids=["some", "all"])
@pytest.mark.parametrize("kind", ACTING)
def test_parameters_follow_an_effect(machine, kind, ids):
    loop, system = machine.emulation_loop, machine.system
    place = ACTING.index(kind)
    effects = list(system.effects)
    effects[place] = changed(effects[place])
    before = {(b, k): v.copy() for b, part in loop.p.items() for k, v in part.items()}
    machine.assign([system.replace(effects=tuple(effects))] * len(ids), ids)
    require_derived(loop)
    moved = [key for key, v in before.items() if (loop.p[key[0]][key[1]] != v).any()]
    if issubclass(EFFECTS[kind], LaboratoryEffect):
        assert moved  # the effect is seen
    machine.assign([system] * N)
    require_derived(loop)
    for (block, name), v in before.items():
        np.testing.assert_array_equal(loop.p[block][name], v)


def test_other_blocks_are_left_alone(machine, monkeypatch):
    """A biased sensor asks nothing of platform and estimate."""
    loop, system = machine.emulation_loop, machine.system
    place, asked = ACTING.index("sensor/bias"), []
    for block in loop.wiring.blocks:

        def parameters(p, bodies, block=block):
            asked.append(block.name)
            return type(block).parameters(block, p, bodies)

        monkeypatch.setattr(block, "parameters", parameters)
    bias = {(place, name): np.full((len(IDS), 3), 0.3) for name in ("force", "moment")}
    machine.assign_effects(EffectRows(system, bias, at_once=True), IDS)
    assert asked == ["force_sensor"]
    machine.assign([system] * N)


def test_every_block_says_what_it_follows_from(machine):
    """By what it reads; a block without parameters reads nothing."""
    sources = machine.emulation_loop.numbers.sources
    for block in machine.emulation_loop.wiring.blocks:
        assert isinstance(block, Block)
        assert bool(sources[block.name]) == bool(machine.emulation_loop.p[block.name])
    assert sources["force_sensor"] == {"sensor"}
