"""Blocks and wires: which signal arrives when, and what cannot be wired."""

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import PlatformBandwidth
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.blocks.block import Block, LoopShape, Memory, ModelOf, signal_of
from ves_gym.simulation.blocks.wiring import Wiring
from ves_gym.simulation.emulation_loop import EmulationLoop
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

SHAPE = LoopShape(nodes=4, joints=3, control_dt=0.01, physics_dt=0.01 / 3)


class Adds(Block):
    """Sums up what it reads, on top of a number of its own."""

    name = "adds"

    def __init__(self, name, inputs, outputs, memory=()):
        self.name, self.inputs, self.outputs, self._memory = name, inputs, outputs, memory

    @property
    def memory(self):
        return {k: Memory((6,)) for k in self._memory}

    def step(self, p, x, u):
        total = sum(u[k] for k in self.inputs) + sum(x.values())
        return {k: v + 1 for k, v in x.items()}, dict.fromkeys(self.outputs, total)


def loop_of(*effects, **options):
    system = System(
        vehicle=BENT_THESIS,
        mode="emulated",
        effects=effects,
        emulator=EmulatorSettings(**options),
    )
    return EmulationLoop(system, 2, [np.random.default_rng(i) for i in range(2)])


# -------------------------------------------------------------------------- refusals


def test_a_signal_that_there_is_not_is_refused_by_name():
    with pytest.raises(ParameterError, match="no signal 'tension'; known: q, kp"):
        Wiring([Adds("a", ("tension",), ("weight",))], [], [])


def test_a_signal_that_nobody_puts_out_is_refused_by_name():
    blocks = [Adds("a", ("reading",), ("weight",)), Adds("b", ("weight",), ("payload",))]
    message = "signal 'reading' is read but no block puts it out: blocks are a, b"
    with pytest.raises(ParameterError, match=message):
        Wiring(blocks, [], [])
    Wiring(blocks, [], ["reading"])  # or somebody outside hands it in
    with pytest.raises(ParameterError, match="signal 'frozen' is read but no block"):
        Wiring(blocks, [], ["reading"], watched=["frozen"])


# -------------------------------------------------------------- when a signal arrives


def test_the_order_of_blocks_says_when_a_signal_arrives():
    """b reads a's output of this period, a reads c's of the period before."""
    a = Adds("a", ("weight",), ("reading",))
    b = Adds("b", ("reading",), ("payload",))
    c = Adds("c", ("payload",), ("weight",), memory=("count",))
    wiring = Wiring([a, b], [c], [])
    assert wiring.delayed == ("weight", "payload")  # late; from before the engine to after it
    when = {(row["from"], row["to"]): row["when"] for row in wiring.describe(SHAPE)}
    late, now = "a period later", "at once"
    assert when == {("c", "a"): late, ("a", "b"): now, ("b", "c"): now}
    x = {k: np.zeros((1, *shape)) for k, shape in wiring.carried(SHAPE).items()}
    assert set(x) == {"c.count", "weight", "payload"}
    seen = []
    for _ in range(3):
        for half in (wiring.before, wiring.after):
            changed, out = wiring.run(half, {}, x, {})
            x |= changed
        seen.append(out["weight"][0, 0])
    # each period adds the count so far to the weight of the period before
    assert seen == [0, 1, 3]
    assert wiring.memories().keys() == {"c.count"}
    assert wiring.dynamic() == ["c.count", "weight", "payload"]


def test_a_model_is_the_same_text_on_other_wires():
    block = Adds("a", ("command_received",), ("y",), memory=("count",))
    model = ModelOf(block)
    assert (model.inputs, model.outputs) == (("command_sent",), ("y_model",))
    assert (model.name, model.summary) == ("a_model", block.summary)
    x, u = {"count": np.ones((1, 6))}, np.full((1, 6), 2.0)
    new, out = model.step({}, x, {"command_sent": u})
    mine = block.step({}, x, {"command_received": u})
    np.testing.assert_array_equal(out["y_model"], mine[1]["y"])
    np.testing.assert_array_equal(new["count"], mine[0]["count"])
    signal, original = signal_of("y_model"), signal_of("y")
    assert (signal.unit, signal.shape) == (original.unit, original.shape)
    assert signal.meaning == f"{original.meaning}, by the model"


def test_a_block_may_run_several_times_a_period():
    """Outputs are those of the last time, or stand side by side."""

    class Counts(Adds):
        repeats, stacked = 3, ("y_nodes",)

        def step(self, p, x, u):
            count = x["count"] + 1
            return {"count": count}, {"pose": count, "y_nodes": count[:, None]}

    block = Counts("counts", (), ("pose", "y_nodes"), memory=("count",))
    wiring = Wiring([block], [], [])
    x = {k: np.zeros((1, *shape)) for k, shape in wiring.carried(SHAPE).items()}
    changed, out = wiring.run(wiring.before, {}, x, {})
    assert (changed["counts.count"] == 3).all() and (out["pose"] == 3).all()
    assert out["y_nodes"][0, :, 0].tolist() == [1, 2, 3]


# ----------------------------------------------------------------- the emulation loop


def test_the_signals_of_a_period_have_the_shapes_listed():
    """One period in NumPy of the compensated loop with a model of its platform."""
    loop = loop_of(PlatformBandwidth(error=0.1))
    rng = np.random.default_rng(0)
    sizes = loop.wiring.everything(loop.shape)
    given = {k: rng.normal(size=(2, *sizes[k])) for k in loop.wiring.external}
    x = {k: loop.memory[k] for k in loop.memory.shapes}
    for half in (loop.wiring.before, loop.wiring.after):
        changed, out = loop.wiring.run(half, loop.p, x, given)
        for name, values in out.items():
            assert values.shape == (2, *sizes[name]), name
        for name, values in changed.items():
            assert values.shape == (2, *loop.memory.shapes[name]), name
        x |= changed


def test_the_picture_shows_the_loop_as_it_is():
    """Else: `python scripts/wiring.py`, once blocks and wires have their place there."""
    from scripts import wiring

    assert wiring.PICTURE.read_text(encoding="utf-8") == wiring.picture()
    other = System(vehicle=BENT_THESIS, mode="emulated", effects=[PlatformBandwidth(error=0.1)])
    with pytest.raises(ValueError, match=r"wires differ: .*platform_model"):
        wiring.picture(other)
