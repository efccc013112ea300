"""Claim: the Model Method on 47 poses and two iterations predicts the weight as well as in
Table 3-1, and ten times better without the sensor's noise.

The sensor has 1 % cross-talk and gain errors and an arbitrary zero, both unknown; its noise
and drift are the nominal budget (`effects.LABORATORY_ERRORS`). Test motion as in 3.4.6:
joint 1 turns by 180 deg very slowly while the platform tilts from +5 to -5 deg about x and
y. Bounds: 0.5 N and 1.0 N m, the largest axes of the thesis's Table 3-1.
"""

import functools

import numpy as np
import pytest

from ves_gym.effects import LABORATORY_ERRORS, SensorBias, SensorCalibration
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.gravity_calibration import (
    Errors,
    calibration_poses,
    fit,
    predict_errors,
)
from ves_gym.simulation.playback import play_motions, weigh_poses
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

SLOWLY = 180.0  # s
ARM = System(vehicle=BENT_THESIS).arm


def true_sensor():
    error = np.random.default_rng(3).normal(0, 0.01, (6, 6))
    error[3:, :3] *= 0.3  # m
    return (
        SensorCalibration(error=tuple(map(tuple, error.tolist()))),
        SensorBias(force=(5.0, -3.0, 8.0), moment=(2.0, 1.0, -1.0)),
    )


def table_3_1(noise, *, iterations=2, draws=1):
    """Errors of the prediction, of every draw of noise and drift."""
    effects = (*true_sensor(), *noise)
    q, y = calibration_poses(ARM, 47)
    system = System(vehicle=BENT_THESIS, mode="emulated", effects=effects)
    run, out = slow_turn(effects, draws), []
    for draw in range(draws):
        log = weigh_poses(system, q, y, seed=draw + 1)
        some = {"iterations": iterations or 1, "estimate_matrix": iterations > 0}
        found = fit(ARM, log.q, log.y, log.w, **some)
        out.append(predict_errors(found, ARM, run.q[draw], run.y[draw], run.w[draw]))
    return out


@functools.cache
def slow_turn(effects, draws):
    """The test motion, as many times side by side."""
    arm = Motion.straight(np.deg2rad([-90, 0, 0]), np.deg2rad([90, 0, 0]), SLOWLY)
    tilt = Motion.straight(np.deg2rad([5.0, 5.0]), np.deg2rad([-5.0, -5.0]), SLOWLY)

    def platform(t):
        sample, pose, rate = tilt.at(t), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        pose[:, 3:5], rate[:, 3:5] = sample.q, sample.v
        return pose, rate

    told = EmulatorSettings(operation="position")
    system = System(vehicle=BENT_THESIS, mode="emulated", emulator=told, effects=effects)
    start = platform(np.zeros(1))[0][0]
    return play_motions(system, [arm] * draws, settle=0.0, y=start, platform=platform, seed=11)


def rms(errors):
    return np.sqrt((errors.rms[:3] ** 2).mean()), np.sqrt((errors.rms[3:] ** 2).mean())


@pytest.fixture(scope="module")
def noisy():
    """Three draws of noise and drift together: 180 s hold few independent values of a drift."""
    draws = table_3_1(LABORATORY_ERRORS, draws=3)
    pooled = np.sqrt(np.mean([k.rms**2 for k in draws], axis=0))
    return Errors(pooled, np.max([k.max for k in draws], axis=0))


@pytest.fixture(scope="module")
def clean():
    return table_3_1(())[0]


def test_weight_is_predicted_as_in_table_3_1(noisy):
    assert (noisy.rms[:3] <= 0.5).all()
    assert (noisy.rms[3:] <= 1.0).all()
    print("rms", noisy.rms.round(3), "largest", noisy.max.round(2))
    force, moment = rms(noisy)
    assert force <= 0.5 and moment <= 1.0


@pytest.mark.slow
def test_noise_is_what_limits_it(noisy, clean):
    print("times better:", np.array(rms(noisy)) / np.array(rms(clean)))
    for with_noise, without in zip(rms(noisy), rms(clean), strict=True):
        assert without <= with_noise / 10


@pytest.mark.slow
def test_without_the_matrix_it_fails(clean):
    """3.4.5: the manufacturer's matrix left several Newtons."""
    kept = table_3_1((), iterations=0)[0]
    print("rms with the manufacturer's matrix", kept.rms.round(2))
    assert rms(kept)[0] > 1.0 > 20 * rms(clean)[0]
