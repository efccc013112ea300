"""What has no name is written as a torque at a joint, as a spring or damper at the base."""

import dataclasses

import numpy as np
import pytest

from tests.diagnosis import logs as files
from tests.diagnosis.test_every_effect import HISS, SYSTEM, noisy
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.held_back import gaps
from ves_gym.diagnosis.inference.open_set import OpenSet
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import BaseAmplitudeDamping
from ves_gym.mechanics.vehicle import STRAIGHT_VERTICAL
from ves_gym.system.system import System

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)


@pytest.fixture(scope="module")
def logs():
    """Three motions of a machine that is as described."""
    return recorded(3)


def recorded(n):
    noisy_sensor = SYSTEM.replace(effects=(HISS,))
    return files.recorded(noisy_sensor, 1, n, described=SYSTEM, duration=6.0)


def changed(logs, torque, seed=0):
    """Residuals of logs with a torque added, and of the last, held back."""
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name == "joint")
    runs = []
    for i, log in enumerate(logs):  # the controller has asked for other torques
        log = dataclasses.replace(log, tau=log.tau + torque(log))
        runs.append(dataclasses.replace(run_of(noisy(log, seed + i), f"run-{i}"), by_log=True))
    return WhitenedResiduals(machine, runs[:-1]), WhitenedResiduals(machine, runs[-1:])


def written(residuals, last, at, names):
    """The change written, which may be read again, and how much of a gap it explains."""
    null = fit(residuals, (), ())
    found = OpenSet(residuals, null).fit(null)
    assert {c.name for c in found.candidates} >= set(names)
    model = residuals.machine.model(found.effects)
    assert System.from_dict(model.system.to_dict()) == model.system
    gap = next(g for g in gaps(last, found, null, False) if (g.port, g.channel) == at)
    assert gap.before > 3
    return found, 1 - max(gap.after**2 - 1, 0) / (gap.before**2 - 1)


HERE = ("joint", "tau_2")


def hose(log):
    """Torque at joint 2 of a hose along joints 2 and 3, softly taut beyond an angle."""
    stretch = log.q[:, 1] + 0.5 * log.q[:, 2] + 0.4
    return np.outer(10.0 * (stretch + np.hypot(stretch, 0.2)) / 2, [0, 1, 0])


def test_a_law_that_nobody_has_is_written_where_it_is(logs):
    """Most of the gap goes on a motion that no fit has seen."""
    found, part = written(*changed(logs, hose), HERE, [])
    assert [c.slot for c in found.candidates] == ["joint 2"]
    assert part > 0.84


def caught(log):
    """Torque at joint 2 of a magnet at one angle, and of friction in patches."""
    q, v = log.q[:, 1], log.v[:, 1]
    x = (q + 0.1) / 0.06
    magnet = -3 * x * np.exp((1 - x**2) / 2)
    return np.outer(
        magnet - 3 * np.maximum(np.sin(9 * q), 0) ** 2 * np.tanh(v / 0.01), [0, 1, 0]
    )


@pytest.mark.slow
def test_a_law_of_fine_structure_over_an_angle_is_written_as_curves():
    """Four motions cover the angles of the one held back."""
    found, part = written(*changed(recorded(5), caught), HERE, ["joint/curves at joint 2"])
    assert {c.name for c in found.candidates} == {"joint/curves at joint 2"}
    assert part > 0.8


def rested(log, length=8e-4, time=1.5, way=1e-2):
    """Friction at joint 2 that grows at rest: LuGre's bristle, integrated finely."""
    out, dt, fine = np.zeros_like(log.v), log.t[1] - log.t[0], 400
    z, age = 0.0, 1.0
    for k, rate in enumerate(log.v[:, 1]):
        for _ in range(fine):
            z += dt / fine * (rate - abs(rate) * z) / length
            age += dt / fine * ((1 - age) / time - abs(rate) / way * age)
        out[k, 1] = 20.0 * age * z
    return out


@pytest.mark.slow
def test_a_friction_that_grows_at_rest_is_written_with_its_memory(logs):
    """Reference: a law of the test's own. Angles and rates alone remove none of it."""
    assert written(*changed(logs, rested), HERE, ["joint/memory at joint 2"])[1] > 0.9


AFLOAT, AT = System(vehicle=STRAIGHT_VERTICAL), ("base", "F_x")


def on_a_base(coefficient):
    """Residuals of two runs and one held back, of a base whose damping grows with its rate."""
    vector = (coefficient, 0.0, 0.0, 0.0, 0.0, 0.0)
    true = AFLOAT.replace(effects=(BaseAmplitudeDamping(coefficient=vector),))
    some = files.recorded(true, 3, 3, described=AFLOAT, duration=8.0, settle=0.0)
    rng, sizes = np.random.default_rng(5), {"q": 2e-5, "tau": 0.3, "y": 1e-5, "w": 0.3}
    some = [files.with_noise(log, sizes, rng, stated=False) for log in some]
    runs = [run_of(log, f"run-{i}") for i, log in enumerate(some)]
    machine = SystemMachine(AFLOAT)
    machine.ports = tuple(p for p in machine.ports if p.name in ("wrench", "base"))
    return WhitenedResiduals(machine, runs[:2]), WhitenedResiduals(machine, runs[2:])


@pytest.mark.parametrize("coefficient", [pytest.param(300.0, marks=pytest.mark.slow), 3000.0])
def test_what_has_no_name_at_the_base_is_written_as_springs_and_dampers(coefficient):
    found, part = written(*on_a_base(coefficient), AT, ["base/unknown at x"])
    [effect] = found.effects
    assert effect.damping[0] > 10 and not any(effect.damping[1:]) and not any(effect.stiffness)
    assert part > 0.8


@pytest.mark.slow
def test_nothing_is_written_at_a_base_that_is_as_described():
    residuals, _ = on_a_base(0.0)
    null = fit(residuals, (), ())
    assert OpenSet(residuals, null).fit(null) is null


def test_nothing_is_written_where_nothing_is_missing(logs):
    residuals, _ = changed(logs, lambda log: 0.0)
    null = fit(residuals, (), ())
    assert OpenSet(residuals, null).fit(null) is null
