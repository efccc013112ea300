"""Logs as a diagnosis gets them: lively motions, with noise of a known size in every signal."""

import dataclasses

import numpy as np

from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.diagnose import diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.mechanics.servo import OWN_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

NOISE = {
    "q": np.full(3, 1e-4),
    "v": np.full(3, 1e-3),
    "tau": np.full(3, 0.4),
    "y": np.array([2e-5] * 3 + [1e-5] * 3),
    "w": np.full(6, 0.3),
}
RIGID = System(vehicle=BENT_THESIS)


def recorded(system, seed=3, count=1, *, described=None, duration=10.0, settle=1.0, **options):
    """Logs of motions that excite all joints, which name the system described."""
    motions = excitation_motions(count, system.arm, duration=duration, seed=seed)
    options = {"record_dt": system.control_dt, "seed": seed, **options}
    recording = play_motions(system, motions, settle=settle, **options)
    logs = [recording.log(i) for i in range(count)]
    named = (described or system).to_dict()
    return [dataclasses.replace(k, meta={**k.meta, "system": named}) for k in logs]


def with_noise(log, sizes, rng, stated=True):
    """The log with white noise of sizes by signal, drawn in their order, which it may state."""
    shapes = {k: getattr(log, k).shape for k in sizes}
    parts = {k: getattr(log, k) + s * rng.standard_normal(shapes[k]) for k, s in sizes.items()}
    said = {k: np.broadcast_to(s, shapes[k][1]).tolist() for k, s in sizes.items()}
    meta = {**log.meta, "noise_std": said} if stated else log.meta
    return dataclasses.replace(log, meta=meta, **parts)


def logged(system, servo=OWN_GAINS, seed=3):
    """A run of 10 s of a system in space, with noise in every signal."""
    (log,) = recorded(system, seed, servo=servo)
    return run_of(with_noise(log, NOISE, np.random.default_rng(seed)), "run")


def told(described, logs, which=lambda c: True, final=0, **stated):
    """The diagnosis of logs by the candidates of the library that are of interest."""
    inputs = system_inputs(logs, described, final=final, **stated)
    some = [c for c in inputs.candidates if which(c)]
    return diagnose(inputs.machine, inputs.runs, inputs.final, candidates=some)
