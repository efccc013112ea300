"""A drift that is described may take any course, in every run its own: no disagreement."""

import numpy as np
import pytest

import ves_gym.effects as E
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.drift import courses
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

PLAIN = System(
    vehicle=BENT_THESIS, mode="emulated", emulator=EmulatorSettings(operation="position")
)
DRIFT = E.SensorDrift(moment=(2.0, 0.0, 0.0), time=20.0)
NOISE = E.SensorNoise(force=(0.35, 0.2, 0.4), moment=(0.3, 0.3, 0.05))


@pytest.fixture(scope="module")
def runs():
    system = PLAIN.replace(effects=(NOISE, DRIFT))
    motions = excitation_motions(2, duration=5.0, seed=1)
    recording = play_motions(system, motions, settle=1.0, seed=3)
    return [run_of(recording.log(i), f"run-{i}") for i in range(2)]


def slowest(residuals, size):
    """Mean square of the lowest frequencies of M_x."""
    at = [(g.port, g.channel, g.low) for g in residuals.groups].index(("wrench", 3, 0.0))
    return size[at]


def test_courses_add_up_to_the_covariance(runs):
    run, std, time = runs[0], np.array([0, 0, 0, 2.0, 0, 0]), 20.0
    found = courses(run, std, time)
    assert {path.channel for path, _ in found} == {3}
    paths = np.stack([size * path.of(run) for path, size in found])
    t = run.dt * np.arange(run.length)
    for lag in (0, 100, 300):  # on the average along the run
        pairs = np.einsum("kt,kt->t", paths[:, : len(t) - lag], paths[:, lag:]).mean()
        assert pairs == pytest.approx(4 * np.exp(-run.dt * lag / time), rel=0.02)


def test_a_described_drift_is_no_disagreement(runs):
    sizes = []
    for effects in ((NOISE,), (NOISE, DRIFT)):
        residuals = WhitenedResiduals(SystemMachine(PLAIN.replace(effects=effects)), runs)
        sizes.append(slowest(residuals, fit(residuals, (), ()).size))
    assert sizes[0] > 1  # of noise, where the description knows of none
    assert sizes[1] < 0.1 * sizes[0]


def test_a_run_held_back_takes_a_course_of_its_own(runs):
    machine = SystemMachine(PLAIN.replace(effects=(NOISE, DRIFT)))
    first, last = (WhitenedResiduals(machine, [run]) for run in reversed(runs))
    names = [k.name for k in last.nuisances[last.shared :]]
    assert names and all(name == "drift of M_x in run-0" for name in names)
    x = fit(first, (), ()).nuisances

    def mean_square(z):
        return slowest(last, [np.mean(z[g.part] ** 2) for g in last.groups])

    left = last.less_nuisances(last.null, x, fitted=False)
    assert mean_square(left) < 0.2 * mean_square(last.null)
    np.testing.assert_allclose(
        first.less_nuisances(first.null, x, fitted=True), first.null + first.slopes @ x
    )
