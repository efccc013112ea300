"""Sensors that wander are told from what is missing, and the colour of noise from motion."""

import dataclasses

import numpy as np
import pytest

from tests.diagnosis.test_every_effect import HISS, STD, SYSTEM, library_of, noisy, played
from ves_gym._util.signals import SensorNoiseModel
from ves_gym.diagnosis.data.measured_run import run_of, with_shared_colour
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.model_selection import Thresholds, select, unexplained
from ves_gym.diagnosis.inference.signatures import Signatures
from ves_gym.diagnosis.inference.slow_noise import MOST, slow_shares
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)
SHARE = 0.2


@pytest.fixture(scope="module")
def log():
    return played(SYSTEM)


def wandering(log, seed):
    """The log with slow noise on torques, a fifth of the variance of the noise stated."""
    drawn = SensorNoiseModel(STD["tau"], np.zeros(3)).draw_slow(
        np.random.default_rng(seed), 1, len(log)
    )
    return dataclasses.replace(log, tau=log.tau + np.sqrt(SHARE) * drawn[0])


def at_joints(logs, slow=None):
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name == "servo")
    runs = [run_of(k, f"run-{i}") for i, k in enumerate(logs)]
    return WhitenedResiduals(machine, with_shared_colour(runs, runs), slow=slow)


def test_a_wander_of_most_channels_is_noise_and_not_a_gap(log):
    still = [noisy(log, seed) for seed in range(4)]
    moved = [wandering(k, seed) for seed, k in enumerate(still)]
    assert slow_shares(at_joints(still)).get("servo", 0.0) < 0.05
    shares = slow_shares(at_joints(moved))
    assert 0.06 < shares["servo"] <= MOST
    before, after = (
        unexplained(fit(r, (), ()), r) for r in (at_joints(moved), at_joints(moved, shares))
    )
    assert after < 0.5 * before


def test_an_offset_of_one_joint_is_no_wander(log):
    pushed = [
        noisy(dataclasses.replace(log, tau=log.tau + np.array([0, 5, 0])), k) for k in range(2)
    ]
    assert slow_shares(at_joints(pushed)).get("servo", 0.0) < 0.05


def test_runs_share_the_colour_of_the_one_that_moves_least(log):
    hiss = np.random.default_rng(0).standard_normal(log.tau.shape)
    shaken = dataclasses.replace(noisy(log, 1), tau=noisy(log, 1).tau + hiss)
    calm, loud = (run_of(k, "run") for k in (noisy(log, 0), shaken))
    assert loud.noise["tau"].correlation.max() < 0.2 < calm.noise["tau"].correlation.min()
    shared = with_shared_colour([loud], [calm, loud])[0].noise["tau"]
    assert shared.correlation == pytest.approx(calm.noise["tau"].correlation)
    assert shared.std == pytest.approx(STD["tau"])


@pytest.mark.parametrize(("size", "names"), [(0.8, 0), (2.0, 1)])
@pytest.mark.slow
def test_a_drift_below_the_noise_stated_is_part_of_it(size, names):
    """F_y wanders by parts of its noise: above it, it drifts."""
    quiet = played(SYSTEM, HISS)
    wave = np.sqrt(2) * np.cos(2.5 * np.pi * np.linspace(0, 1, len(quiet)))
    moved = quiet.w + np.outer(wave, size * STD["w"] * (np.arange(6) == 1))
    logs = [noisy(dataclasses.replace(quiet, w=moved), seed) for seed in range(4)]
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name == "wrench")
    runs = [run_of(k, f"run-{i}") for i, k in enumerate(logs)]
    residuals = WhitenedResiduals(machine, runs)
    drifts = [c for c in library_of(machine, runs) if c.kind == "sensor/drift"]
    found = select(residuals, Signatures(residuals, drifts), Thresholds())
    best = next(c for c in drifts if c.slot == "F_y")
    gained = fit(residuals, (), ()).deviance - fit(residuals, [best], best.starts).deviance
    assert gained > 100  # enough for a name, either way
    assert [c.slot for c in found.fit.candidates] == ["F_y"] * names


def test_nothing_is_told_where_an_effect_may_be_in_the_median(log, monkeypatch):
    """As on an axis alone, whose friction was taken for a wander of its torque."""
    moved = [wandering(noisy(log, seed), seed) for seed in range(4)]
    assert slow_shares(at_joints(moved))
    monkeypatch.setattr("ves_gym.diagnosis.inference.slow_noise._FEWEST", 4)
    assert slow_shares(at_joints(moved)) == {}
