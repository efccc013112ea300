"""What has no name is written as a torque, and belief in "none of these" is explicit."""

import dataclasses
import types

import numpy as np
import pytest

from tests.diagnosis.test_every_effect import HISS, SYSTEM, noisy
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.held_back import gaps
from ves_gym.diagnosis.inference.model_selection import Rival, Selection, Thresholds
from ves_gym.diagnosis.inference.unknown import (
    LIBRARY,
    NONE_OF_THESE,
    NOTHING,
    beliefs,
    unnamed,
)
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import BaseAmplitudeDamping
from ves_gym.mechanics.vehicle import STRAIGHT_VERTICAL
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)


@pytest.fixture(scope="module")
def logs():
    """Three motions of a machine that is as described."""
    return recorded(3)


def recorded(n):
    motions = excitation_motions(n, duration=6.0, seed=1)
    recording = play_motions(SYSTEM.replace(effects=(HISS,)), motions, settle=1.0)
    out = [recording.log(i) for i in range(n)]
    return [dataclasses.replace(k, meta={**k.meta, "system": SYSTEM.to_dict()}) for k in out]


def hose(q):
    """Torque at joint 2 of a hose along joints 2 and 3, softly taut beyond an angle."""
    stretch = q[:, 1] + 0.5 * q[:, 2] + 0.4
    torque = np.zeros_like(q)
    torque[:, 1] = 10.0 * (stretch + np.hypot(stretch, 0.2)) / 2
    return torque


def joint_residuals(logs, seed):
    """Of logs whose torques are changed: the controller has asked for others."""
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name == "joint")
    runs = [run_of(noisy(k, seed + i), f"run-{seed + i}") for i, k in enumerate(logs)]
    return WhitenedResiduals(machine, [dataclasses.replace(r, by_log=True) for r in runs])


def test_a_law_that_nobody_has_is_written_where_it_is(logs):
    """Most of the gap goes on a motion that no fit has seen."""
    pulled = [dataclasses.replace(k, tau=k.tau + hose(k.q)) for k in logs]
    residuals, last = joint_residuals(pulled[:2], 0), joint_residuals(pulled[2:], 2)
    null = fit(residuals, (), ())
    found = unnamed(residuals, last, null)
    assert [c.slot for c in found.candidates] == ["joint 2"]
    gap = next(g for g in gaps(last, found, null, False) if g.channel == "tau_2")
    assert gap.before > 3
    assert 1 - (max(gap.after**2 - 1, 0) / (gap.before**2 - 1)) ** 0.5 > 0.6
    model = residuals.machine.model(found.effects)
    assert System.from_dict(model.system.to_dict()) == model.system


def caught(q, v):
    """Torque at joint 2 of a magnet at one angle, and of friction in patches."""
    torque, x = np.zeros_like(q), (q[:, 1] + 0.1) / 0.06
    torque[:, 1] = -3 * x * np.exp((1 - x**2) / 2)
    torque[:, 1] -= 3 * np.maximum(np.sin(9 * q[:, 1]), 0) ** 2 * np.tanh(v[:, 1] / 0.01)
    return torque


def test_a_law_of_fine_structure_over_an_angle_is_written_as_curves():
    """Four motions cover the angles of the one held back."""
    met = [dataclasses.replace(k, tau=k.tau + caught(k.q, k.v)) for k in recorded(5)]
    residuals, last = joint_residuals(met[:4], 0), joint_residuals(met[4:], 4)
    null = fit(residuals, (), ())
    found = unnamed(residuals, last, null)
    assert {c.name for c in found.candidates} == {"joint/curves at joint 2"}
    gap = next(g for g in gaps(last, found, null, False) if g.channel == "tau_2")
    print(gap)
    assert gap.before > 5
    assert 1 - (gap.after**2 - 1) / (gap.before**2 - 1) > 0.8
    model = residuals.machine.model(found.effects)
    assert System.from_dict(model.system.to_dict()) == model.system


def rested(v, dt, torque, length=8e-4, time=1.5, way=1e-2):
    """Friction at joint 2 that grows at rest: LuGre's bristle, integrated finely."""
    out = np.zeros_like(v)
    z, age, fine = 0.0, 1.0, 400
    for k, rate in enumerate(v[:, 1]):
        for _ in range(fine):
            z += dt / fine * (rate - abs(rate) * z) / length
            age += dt / fine * ((1 - age) / time - abs(rate) / way * age)
        out[k, 1] = torque * age * z
    return out


def test_a_friction_that_grows_at_rest_is_written_with_its_memory(logs):
    """Reference: a law of the test's own. Angles and rates alone remove none of it."""
    stuck = [
        dataclasses.replace(k, tau=k.tau + rested(k.v, k.t[1] - k.t[0], 20.0)) for k in logs
    ]
    residuals, last = joint_residuals(stuck[:2], 0), joint_residuals(stuck[2:], 2)
    null = fit(residuals, (), ())
    found = unnamed(residuals, last, null)
    assert "joint/memory at joint 2" in [c.name for c in found.candidates]
    gap = next(g for g in gaps(last, found, null, False) if g.channel == "tau_2")
    print(gap)
    assert gap.before > 3
    assert 1 - (max(gap.after**2 - 1, 0) / (gap.before**2 - 1)) ** 0.5 > 0.7
    model = residuals.machine.model(found.effects)
    assert System.from_dict(model.system.to_dict()) == model.system


AFLOAT, AT = System(vehicle=STRAIGHT_VERTICAL), ("base", "F_x")


def on_a_base(coefficient):
    """Residuals of two runs and one held back, of a base whose damping grows with its rate."""
    vector = (coefficient, 0.0, 0.0, 0.0, 0.0, 0.0)
    true = AFLOAT.replace(effects=(BaseAmplitudeDamping(coefficient=vector),))
    recording = play_motions(
        true, excitation_motions(3, duration=8.0, seed=3), settle=0.0, record_dt=12.5e-3
    )
    rng, runs = np.random.default_rng(5), []
    for i in range(3):
        log = recording.log(i)
        noise = {"q": 2e-5, "tau": 0.3, "y": 1e-5, "w": 0.3}
        read = {k: getattr(log, k) for k in noise}
        read = {k: x + noise[k] * rng.standard_normal(x.shape) for k, x in read.items()}
        meta = {**log.meta, "system": AFLOAT.to_dict()}
        runs.append(run_of(dataclasses.replace(log, **read, meta=meta), f"run-{i}"))
    machine = SystemMachine(AFLOAT)
    machine.ports = tuple(p for p in machine.ports if p.name in ("wrench", "base"))
    return WhitenedResiduals(machine, runs[:2]), WhitenedResiduals(machine, runs[2:])


@pytest.mark.parametrize("coefficient", [300.0, 3000.0])
def test_what_has_no_name_at_the_base_is_written_as_springs_and_dampers(coefficient):
    residuals, last = on_a_base(coefficient)
    null = fit(residuals, (), ())
    found = unnamed(residuals, last, null)
    assert [c.name for c in found.candidates] == ["base/unknown at x"]
    [effect] = found.effects
    assert effect.damping[0] > 10 and not any(effect.damping[1:]) and not any(effect.stiffness)
    gap = next(g for g in gaps(last, found, null, False) if (g.port, g.channel) == AT)
    print(gap)
    assert gap.before > 3 and 1 - (gap.after**2 - 1) / (gap.before**2 - 1) > 0.8
    model = residuals.machine.model(found.effects)
    assert System.from_dict(model.system.to_dict()) == model.system


def test_nothing_is_written_at_a_base_that_is_as_described():
    residuals, last = on_a_base(0.0)
    assert unnamed(residuals, last, fit(residuals, (), ())) is None


def test_nothing_is_written_where_nothing_is_missing(logs):
    residuals, last = joint_residuals(logs[:2], 0), joint_residuals(logs[2:], 2)
    assert unnamed(residuals, last, fit(residuals, (), ())) is None


def rival(name, probability):
    return Rival(types.SimpleNamespace(name=name), np.zeros(1), 0.0, probability)


PAIR = Selection(None, None, ((rival("a", 0.9), rival("b", 0.1)), (rival("c", 1.0),)))


@pytest.mark.parametrize("names", [-50.0, 0.0, 40.0, 1e5])
@pytest.mark.parametrize("none", [-400.0, 10.0, 1e6])
@pytest.mark.parametrize("decided", [None, NOTHING, NONE_OF_THESE, LIBRARY])
def test_beliefs_sum_to_one_and_follow_evidence_and_decision(names, none, decided):
    found = beliefs(PAIR, names, none, decided, Thresholds())
    assert found.keys() == {NOTHING, "a + c", "b + c", NONE_OF_THESE}
    assert sum(found.values()) == pytest.approx(1)
    library = found["a + c"] + found["b + c"]
    share = {NOTHING: found[NOTHING], LIBRARY: library, NONE_OF_THESE: found[NONE_OF_THESE]}
    likely = max(
        {NOTHING: 0.0, LIBRARY: names, NONE_OF_THESE: none}.items(), key=lambda x: x[1]
    )[0]
    assert max(share, key=share.get) == (likely if decided is None else decided) or (
        sorted(share.values())[-1] == pytest.approx(sorted(share.values())[-2])
    )
    if library > 1e-9:
        assert found["a + c"] / library == pytest.approx(0.9)
