"""Effects with arrays for parameters: k simulations at once, bit for bit as one by one."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import EFFECTS, LABORATORY_ERRORS
from ves_gym.envs.batch import Batch
from ves_gym.envs.build import build_task
from ves_gym.mechanics.link import diagonal
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import LaboratoryEffect, parameter, register_effect
from ves_gym.system.effect_rows import ONE_BY_ONE, EffectRows
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

EMULATOR = EmulatorSettings(payload_compensation=True)
WHOLE = sorted(k for k, c in EFFECTS.items() if not issubclass(c, ONE_BY_ONE))


def rows_of(kind, n=5, mode="emulated", emulator=EMULATOR):
    """Small random values of every parameter of an effect, on top of the nominal budget."""
    cls, rng, values = EFFECTS[kind], np.random.default_rng(1), {}
    for field in dataclasses.fields(cls):
        low, high = field.metadata["bounds"]
        low, high = max(low, -0.01), min(high, max(low, -0.01) + 0.5)
        shape = [k or (9 if kind == "gravity/moment" else 3) for k in field.metadata["shape"]]
        values[field.name] = rng.uniform(low, high, (n, *shape))
    effect = cls(**{name: v[0].tolist() for name, v in values.items()})
    before = tuple(e for e in LABORATORY_ERRORS if e.kind != kind and mode == "emulated")
    emulator = emulator if mode == "emulated" else None
    system = System(
        vehicle=BENT_THESIS, mode=mode, emulator=emulator, effects=(*before, effect)
    )
    return EffectRows(system, {(len(before), name): v for name, v in values.items()}, True)


@pytest.mark.parametrize("kind", WHOLE)
def test_effects_take_arrays(kind):
    """Every registered effect but those on arm and vehicle edits all simulations at once."""
    rows = rows_of(kind)
    assert rows.together(LoopParameters.nominal(rows.template.arm, EMULATOR, 1))


@pytest.mark.parametrize("kind", ["sensor/rotation", "joint/stribeck", "command/delay"])
def test_rows_are_the_systems_they_stand_for(kind):
    """A second of motion, bit for bit that of `assign` with a system per simulation."""
    rows = rows_of(kind)
    ours, theirs = (Simulator(rows.template, len(rows)) for _ in "ab")
    ours.assign_effects(rows)
    theirs.assign([rows.system(i) for i in range(len(rows))])
    start = np.array([0.3, -0.5, 0.8])
    for sim in (ours, theirs):
        sim.reset(q=start)
    target = start + np.linspace(0.1, 0.5, 5)[:, None]
    for _ in range(80):
        ours.step(ours.servo_command(target, np.zeros((5, 3))))
        theirs.step(theirs.servo_command(target, np.zeros((5, 3))))
    assert ours.state.y.tobytes() == theirs.state.y.tobytes()
    assert ours.state.q.tobytes() == theirs.state.q.tobytes()
    assert len(np.unique(ours.state.q[:, 0])) == 5
    assert ours.systems == theirs.systems


def swung(sims):
    """A third of a second of motion; poses and angles of each."""
    start = np.array([0.3, -0.5, 0.8])
    out = []
    for sim in sims:
        sim.reset(q=start, y=0.01)
        target = start + np.linspace(0.1, 0.5, sim.n)[:, None]
        for _ in range(27):
            sim.step(sim.servo_command(target, np.zeros((sim.n, 3))))
        out.append(np.concatenate([sim.state.y, sim.state.q], axis=1))
    return out


def test_vehicles_that_cannot_be_are_refused():
    """Too stiff for the physics step, or of negative stiffness; nothing is assigned then."""
    stiff = dataclasses.replace(DECOUPLED, K=diagonal(1.28e7, 1e3, 1e3, 1e3, 1e3, 1e3))
    effect = EFFECTS["base/stiffness"](error=0.1)  # its pole at 1.9 of a physics step
    system = System(vehicle=stiff, effects=(effect,), physics_dt=12.5e-3)
    sim, plain = (Simulator(system, 3, backend="kernel") for _ in "ab")
    for errors, message in (
        ([0.0, 3.0, 0.0], "physics_dt must be <= .* fastest motion"),
        ([0.0, 0.0, -1.5], "base/stiffness.error must be one number in"),
    ):
        rows = EffectRows(system, {(0, "error"): np.array(errors)}, True)
        with pytest.raises(ParameterError, match=message):
            sim.assign_effects(rows)
        a, b = swung([sim, plain])
        assert a.tobytes() == b.tobytes()


@dataclass(frozen=True, kw_only=True)
class ByLeadingAxis(LaboratoryEffect):
    """Written for (n, 6): with the simulations' axis last it would edit simulation 2."""

    port = "wrench"
    force: float = parameter("N", bounds=(-10.0, 10.0))

    def edit(self, p):
        """Bias along z."""
        p.sensor.bias[:, 2] += self.force


def test_an_effect_that_does_not_broadcast_is_run_one_by_one(monkeypatch):
    monkeypatch.setitem(EFFECTS.data, "test/by_leading_axis", None)
    del EFFECTS.data["test/by_leading_axis"]
    register_effect("test/by_leading_axis")(ByLeadingAxis)
    ranges = {"test/by_leading_axis": {"force": (1.0, 2.0)}}
    batch = Batch(build_task("rest_to_rest", mode="emulated", randomize=ranges), 6)
    batch.seed(np.arange(6), 3, np.arange(6))
    batch.reset(np.arange(6))
    drawn = batch.drawn["test/by_leading_axis.force"][:, 0]
    bias = batch.sim.emulation_loop.parameters.sensor.bias
    np.testing.assert_array_equal(bias[:, 2], drawn)
    np.testing.assert_array_equal(bias[:, [0, 1, 3, 4, 5]], 0.0)
    del EFFECTS.data["test/by_leading_axis"]


def test_systems_are_made_when_asked_for():
    """Not by a reset; and a restored batch goes on as the one it was taken from."""
    ranges = {"gravity/scale": {"error": (-0.01, 0.01)}}
    task = build_task("rest_to_rest", mode="emulated", randomize=ranges)
    ours, theirs = Batch(task, 4), Batch(task, 4)
    everyone = np.arange(4)
    ours.seed(everyone, 0, everyone)
    ours.reset(everyone)
    assert all(not rows._systems for rows, _ in ours.sim.machines._sources.values())
    errors = [system.effects[-1].error for system in ours.sim.systems]
    np.testing.assert_array_equal(errors, ours.drawn["gravity/scale.error"][:, 0])
    theirs.set_state(ours.get_state())
    for batch in (ours, theirs):
        batch.reset(np.array([1, 3]))
        for _ in range(3):
            batch.step(np.full((4, batch.width), 0.1))
    assert ours.sim.systems == theirs.sim.systems
    assert ours.observe().tobytes() == theirs.observe().tobytes()
