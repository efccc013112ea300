"""Force that a vehicle with internal modes takes: at coarse samples, and from any start."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.signals import SpectralWindow, margin
from ves_gym.diagnosis.diagnose import NOTHING, WEAK, diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.machines.vehicle_force import (
    InnerStart,
    dynamic_stiffness,
    vehicle_gap,
)
from ves_gym.mechanics.vehicle import STRAIGHT_VERTICAL
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

SYSTEM = System(vehicle=STRAIGHT_VERTICAL)


class Tone:
    """A run whose vehicle moves in a tone, as its exact derivatives have it."""

    name = "tone"

    def __init__(self, f, dt, T=30.0):
        t, w = np.arange(0, T, dt), 2 * np.pi * f
        way = 1e-5 * np.array([1.0, -0.5, 0.2, 0.3, 0.8, -0.4])
        phase = np.exp(1j * w * t)[:, None] * way
        self.dt, self.t, self.way, self.w = dt, t, way, w
        self.length, self.window = len(t), SpectralWindow(len(t), dt, 12.0, margin(dt, 12.0))
        self.base = tuple(x.real for x in (phase, 1j * w * phase, -(w**2) * phase))

    def derived(self, name, uses, make):
        return np.eye(6), np.zeros((len(self.t), 6))  # nothing measured: the force alone


@pytest.mark.parametrize("f", [2.0, 6.5, 11.0])
@pytest.mark.parametrize("dt", [0.0125, 0.00125])
def test_a_tone_takes_its_dynamic_stiffness_at_any_sampling(f, dt):
    """Reference: the closed form by frequency, once what began with the run has died away."""
    base, run = SYSTEM.actual.base, Tone(f, dt)
    stiffness = dynamic_stiffness(base, np.eye(6), np.array([run.w]))[0]
    expected = -(np.exp(1j * run.w * run.t)[:, None] * (stiffness @ run.way)).real
    late = run.t > 25
    error = np.abs(vehicle_gap(run, base) - expected)[late].max(axis=0)
    assert (error < 3e-3 * np.abs(expected[late]).max()).all()


@pytest.fixture(scope="module")
def log():
    """Noise-free, in space, of a vehicle with internal modes."""
    motions = excitation_motions(1, SYSTEM.arm, duration=8.0, seed=3)
    recording = play_motions(SYSTEM, motions, settle=1.0, record_dt=0.0125, seed=3)
    return recording.log(0)


def cut(log, first):
    """A log without its first samples; the clock begins at zero."""
    fields = {f.name: getattr(log, f.name) for f in dataclasses.fields(log) if f.init}
    taken = {
        k: x[first:] if isinstance(x, np.ndarray) and len(x) == len(log.t) else x
        for k, x in fields.items()
    }
    taken["t"] = taken["t"] - taken["t"][0]
    return dataclasses.replace(log, **taken)


def test_a_run_that_begins_in_motion_differs_by_the_states_of_its_modes(log):
    inputs = system_inputs([cut(log, 200)], SYSTEM, final=0)
    (run,) = inputs.runs
    base = SYSTEM.actual.base
    gap = np.reshape(vehicle_gap(run, base), (-1, *run["y"].shape[-2:]))[0][20:-20]
    decays = [
        InnerStart(run.name, i).force(run, base)[20:-20] for i in range(2 * base.internal.m)
    ]
    columns = np.stack([d.ravel() for d in decays], axis=1)
    columns /= np.linalg.norm(columns, axis=0)
    left = gap.ravel() - columns @ np.linalg.lstsq(columns, gap.ravel(), rcond=1e-9)[0]
    print(f"{np.linalg.norm(left) / np.linalg.norm(gap):.3g} of the gap is left")
    assert np.linalg.norm(left) < 0.05 * np.linalg.norm(gap)
    assert not InnerStart("another", 0).force(run, base).any()


def test_nothing_is_missing_in_a_log_that_begins_in_motion(log):
    inputs = system_inputs([cut(log, 200)], SYSTEM, final=0)
    found = diagnose(inputs.machine, inputs.runs, inputs.final, candidates=inputs.candidates)
    assert found.verdict in (NOTHING, WEAK), found.sentence
