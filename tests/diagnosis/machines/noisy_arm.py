"""A run of an arm in space with noise in every signal, its size stated."""

import dataclasses

import numpy as np

from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
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


def logged(system, servo=OWN_GAINS, seed=3):
    """A run of 10 s of a system."""
    motions = excitation_motions(1, system.arm, duration=10.0, seed=seed)
    recording = play_motions(
        system, motions, servo=servo, settle=1.0, record_dt=system.control_dt, seed=seed
    )
    log, rng = recording.log(0), np.random.default_rng(seed)
    parts = {
        k: getattr(log, k) + rng.standard_normal(getattr(log, k).shape) * s
        for k, s in NOISE.items()
    }
    stated = {"noise_std": {k: s.tolist() for k, s in NOISE.items()}}
    return run_of(dataclasses.replace(log, meta={**log.meta, **stated}, **parts), "run")
