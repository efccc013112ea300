"""Noise of the readings: coloured, quantised, on a clock that jitters."""

from __future__ import annotations

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.benchmark.blind.setup import MachineSetup
from ves_gym.diagnosis.benchmark.blind.simulate import CHANNELS, NoiseSamples

# standard deviation per channel [rad, rad/s, N m, m and rad, N and N m]
STD: dict[str, Array] = {
    "q": np.array([1.3e-4, 2e-4, 2.5e-4]),  # times kp: that of the torque
    "v": np.full(3, 2e-3),
    "tau": np.array([0.4, 0.4, 0.25]),
    "y": np.array([5e-5, 5e-5, 5e-5, 2e-5, 2e-5, 2e-5]),
    "w": np.array([0.35, 0.3, 0.4, 0.3, 0.3, 0.15]),
}
COLOUR = {"q": 0.3, "v": 0.6, "tau": 0.5, "y": 0.7, "w": 0.4}  # of an AR(1) process
ENCODER = 2e-4  # rad, resolution; its share of the angle's noise is 2e-4 / sqrt(12)
FORCE_STEP, MOMENT_STEP = 0.1, 0.05  # N, N m, resolution of the sensor's signals
# of the record: 10 um and 5 urad transducers, tachometer and current converters
STEPS: dict[str, Array] = {
    "v": np.full(3, 5e-4),
    "tau": np.full(3, 0.05),
    "y": np.array([1e-5] * 3 + [5e-6] * 3),
}
JITTER = 0.03  # of a sample, standard deviation of a time stamp
BURST = 6  # samples, a lost link stays lost


def coloured(std: Array, colour: float, samples: int, rng: np.random.Generator) -> Array:
    """Return AR(1) noise.

    Args:
        std: (k,) standard deviations.
        colour: correlation of neighbouring samples.
        samples: N.
        rng: of the draws.

    Returns:
        (N, k).
    """
    fresh = rng.standard_normal((samples + 50, len(std)))
    gain = np.sqrt(1 - colour**2)
    path = scipy.signal.lfilter([gain], [1.0, -colour], fresh, axis=0)[50:]
    return np.asarray(path * std)


def draw_noise(samples: int, rng: np.random.Generator, lost: float = 0.0) -> NoiseSamples:
    """Return noise of one run.

    Args:
        samples: N.
        rng: of the draws.
        lost: share of wrench packets lost.
    """
    std = dict(STD)
    std["q"] = np.sqrt(STD["q"] ** 2 - ENCODER**2 / 12)
    parts = {k: coloured(std[k], COLOUR[k], samples, rng) for k in STD}
    return NoiseSamples(**parts, lost=losses(samples, lost, rng))


def losses(samples: int, share: float, rng: np.random.Generator) -> Array:
    """Return 1 where a packet is lost, in bursts; more with a larger share only.

    Args:
        samples: N.
        share: of packets.
        rng: of the draws.

    Returns:
        (N,).
    """
    chance = rng.random(samples // BURST + 1).repeat(BURST)[:samples]
    out = (chance < share).astype(float)
    out[0] = 0.0
    return out


def converted(record: Array) -> Array:
    """Return a record as its converters show it."""
    out = record.copy()
    for name, step in STEPS.items():
        columns = CHANNELS[name]
        out[:, columns] = np.round(out[:, columns] / step) * step
    return out


def digital(setup: MachineSetup) -> MachineSetup:
    """Return the machine with encoders and converters of finite resolution."""
    return setup.edit(
        encoder=np.full(3, ENCODER),
        resolution=np.array([FORCE_STEP] * 3 + [MOMENT_STEP] * 3),
    )


def stamps(samples: int, dt: float, clock: float, rng: np.random.Generator) -> Array:
    """Return strictly increasing time stamps of a clock that runs off and jitters.

    Args:
        samples: N.
        dt: step [s].
        clock: relative error of its rate.
        rng: of the jitter.

    Returns:
        (N,) s.
    """
    shake = np.clip(JITTER * rng.standard_normal(samples), -0.2, 0.2)
    shake[0] = 0.0
    late = (np.arange(samples) * (1 + clock) + shake) * dt
    return np.asarray(np.round(late, 6))  # the clock counts microseconds
