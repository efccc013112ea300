"""One run of one machine: from a commanded motion to the measured channels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.benchmark.blind.excitation import DURATION, ExcitationMotion
from ves_gym.diagnosis.benchmark.blind.mechanics import (
    GRAVITY,
    BodyParameters,
    fill_trig,
    inverse_dynamics,
    newton_euler,
)
from ves_gym.diagnosis.benchmark.blind.plant import (
    SIZE,
    BlindPlant,
    PlantInputs,
    Scratch,
    run_plant,
    scratch,
)

CHANNELS = {  # columns of a record
    "q": slice(0, 3),
    "v": slice(3, 6),
    "tau": slice(6, 9),
    "y": slice(9, 15),
    "y_cmd": slice(15, 21),
    "w": slice(21, 27),
    "wg": slice(27, 33),
}
WIDTH = 33
WARM = 1.2  # s under servo control before the record starts
STEP = 6.25e-4  # s, finest integration step
SEARCH_STEP = 1.25e-3  # s, of runs that only compare


class NoiseSamples(NamedTuple):
    """Disturbances of the readings, one row per sample."""

    q: Array
    v: Array
    tau: Array
    y: Array
    w: Array
    lost: Array


def silent(samples: int) -> NoiseSamples:
    """Return no noise at all."""
    three, six = np.zeros((samples, 3)), np.zeros((samples, 6))
    return NoiseSamples(q=three, v=three, tau=three, y=six, w=six, lost=np.zeros(samples))


class Drive(NamedTuple):
    """The arm as the joint servo knows it, for its feed-forward, and its own delay."""

    bodies: BodyParameters
    rotor: Array
    late: float = 0.0  # s, from a command to the servo


def samples_of(dt: float) -> int:
    """Return the number of records of a run, both ends included."""
    return round(DURATION / dt) + 1


def simulate(
    plant: BlindPlant,
    drive: Drive,
    motion: ExcitationMotion,
    noise: NoiseSamples,
    dt: float,
    step: float = STEP,
) -> Array:
    """Return the record of a run, columns as in `CHANNELS`.

    Args:
        plant: machine.
        drive: knowledge and delay of the joint servo.
        motion: commanded.
        noise: of N samples.
        dt: between samples [s].
        step: of the integration, at most [s].

    Returns:
        (N, WIDTH).
    """
    samples, substeps, warm = len(noise.q), round(dt / step), round(WARM / dt)
    t = (np.arange(2 * substeps * (samples + warm) + 1) / (2 * substeps) - warm) * dt
    command = motion.at(t - drive.late)
    ff = inverse_dynamics(drive.bodies, drive.rotor, *command)
    x = np.zeros(SIZE)
    start = command.q[0]
    room = scratch()
    _settle(plant, start, x, room)
    inputs = PlantInputs(
        q=command.q, v=command.v, ff=ff, warm=warm, substeps=substeps, dt=dt,
        noise_q=noise.q, noise_v=noise.v, noise_tau=noise.tau, noise_y=noise.y,
        noise_w=noise.w, lost=noise.lost,
    )  # fmt: skip
    out = np.zeros((samples, WIDTH))
    run_plant(plant, inputs, x, room, out)
    return out


def _settle(plant: BlindPlant, start: Array, x: Array, room: Scratch) -> None:
    """Start with joints sagging under their weight, the sensor under that of the arm."""
    pull, zero = np.array([0.0, 0.0, GRAVITY]), np.zeros(3)
    tau, wrench = np.zeros(3), np.zeros(6)
    q = start.copy()
    for _ in range(5):
        fill_trig(plant.bodies, q, room.trig)
        newton_euler(
            plant.bodies, room.trig, zero, zero, zero, zero, pull, room.work, tau, wrench
        )
        q = start - tau / (plant.gain * plant.kp)
    x[0:3] = x[6:9] = q
    x[30:36] = wrench
