"""Noise in what a number multiplies pulls the number to no side.

A base's M, D, K multiply a measured pose and its derivatives, and least squares would make
them smaller, because that leaves less noise. `python
tests/diagnosis/inference/test_errors_in_variables.py bent 5 9` tells the verdicts of four
draws of pose noise on exactly described logs in mode ideal.
"""

import dataclasses
import sys

import numpy as np
import pytest
import scipy
import scipy.signal

import ves_gym.effects as E
from ves_gym.diagnosis.diagnose import NOTHING, WEAK, diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.variance_groups import InnerProducts, solve
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.diagnosis.machines.tolerances import StatedErrors
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, STRAIGHT_VERTICAL_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

POSE_NOISE = np.array([2e-4] * 3 + [1e-4] * 3)  # m, rad
VEHICLES = {
    "bent": BENT_THESIS,
    "straight": STRAIGHT_VERTICAL_THESIS,
    "satellite": FREE_FLOATING,
}


def noisy_products(rng, claimed):
    """Products of y = 0.7 x read with unit noise in both; `claimed` times its variance."""
    n, true = 4000, 0.7
    x = 2.0 * rng.standard_normal(n)
    seen, y = x + rng.standard_normal(n), true * x + rng.standard_normal(n)
    z, X = y / np.sqrt(claimed), -seen / np.sqrt(claimed)
    return InnerProducts(
        np.array([float(n)]),
        np.array([z @ z]),
        np.array([[X @ z]]),
        np.array([[[X @ X]]]),
        np.array([float(n)]),
        np.zeros((1, 1)),
        np.array([[[float(n)]]]),
    ), (seen, y)


def test_a_slope_is_that_of_deming():
    """Against the closed form of Deming's regression (both variables equally noisy)."""
    p, (x, y) = noisy_products(np.random.default_rng(1), claimed=1.3)
    xx, yy, xy = x @ x, y @ y, x @ y
    deming = (yy - xx + np.sqrt((yy - xx) ** 2 + 4 * xy**2)) / (2 * xy)
    plain = InnerProducts(p.n, p.zz, p.xz, p.xx)
    assert solve(plain, 0).x[0] == pytest.approx(xy / xx, rel=1e-9)  # a fifth too small
    solution = solve(p, 0)
    assert solution.x[0] == pytest.approx(deming, rel=1e-3)  # six passes
    assert solution.x[0] == pytest.approx(0.7, abs=0.04)


def test_the_deviance_is_the_gaussian_density():
    """Against scipy's density of y - b x, whose noise has a variance of at most 1 + b^2."""
    p, (x, y) = noisy_products(np.random.default_rng(2), claimed=1.3)
    solution = solve(p, 0)
    b, n = solution.x[0], int(p.n[0])
    left = y - b * x
    assert left @ left / n < 1.3 * (1 + b**2)
    density = scipy.stats.norm(scale=np.sqrt(left @ left / n)).logpdf(left).sum()
    expected = -2 * density - n * np.log(2 * np.pi * 1.3)  # in units of the noise described
    assert solution.deviance == pytest.approx(expected, rel=1e-9)


def test_a_combination_that_is_mostly_noise_stays_where_its_prior_has_it():
    """Taken off whole, its curvature is negative, and numbers of thousands fit 200 draws."""
    rng = np.random.default_rng(3)
    n, signal = 200, rng.standard_normal(200)
    X = np.stack([signal + rng.standard_normal(n), 3.0 * rng.standard_normal(n)], axis=1)
    z = -0.5 * signal + rng.standard_normal(n)
    noise = np.diag([float(n), 12.0 * n])  # said to be more than there is: 9 n
    p = InnerProducts(
        np.array([float(n)]),
        np.array([z @ z]),
        np.array([X.T @ z]),
        np.array([X.T @ X]),
        np.array([float(n)]),
        np.zeros((1, 2)),
        noise[None],
    )
    x = solve(p, 2).x  # both with a prior of deviation 1
    assert x[0] == pytest.approx(0.5, abs=0.2)
    assert abs(x[1]) < 0.1
    assert np.linalg.eigvalsh(p.xx[0] - noise)[0] < 0  # what least squares less noise has


def recorded(system, seed, count=2):
    motions = excitation_motions(count, system.arm, duration=10.0, seed=seed)
    recording = play_motions(
        system, motions, settle=1.0, record_dt=system.control_dt, seed=seed
    )
    return [recording.log(i) for i in range(count)]


def with_pose_noise(logs, seed):
    rng = np.random.default_rng(seed)
    drawn = [rng.standard_normal(log.y.shape) * POSE_NOISE for log in logs]
    return [dataclasses.replace(log, y=log.y + e) for log, e in zip(logs, drawn, strict=True)]


def told(system, logs, ports=("base",)):
    """The diagnosis, by default with those of the library alone that show at a base."""
    inputs = system_inputs(logs, system, final=0)
    library = [c for c in inputs.candidates if set(ports) & set(c.ports)]
    return diagnose(inputs.machine, inputs.runs, inputs.final, candidates=library)


@pytest.mark.parametrize(
    "name", ["straight", *(pytest.param(k, marks=pytest.mark.slow) for k in VEHICLES)]
)
def test_a_noisy_pose_makes_no_base_lighter(name):
    """0.2 mm and 0.1 mrad: base/virtual_mass and base/stiffness were named, p = 1.00 each."""
    system = System(vehicle=VEHICLES[name])
    found = told(system, with_pose_noise(recorded(system, 3), 5))
    assert found.verdict in (NOTHING, WEAK), found.sentence
    assert not found.explanations


@pytest.mark.slow
def test_a_heavier_base_is_named_through_the_same_noise():
    system = System(vehicle=BENT_THESIS)
    hidden = system.replace(effects=(E.BaseVirtualMass(error=0.3),))
    found = told(system, with_pose_noise(recorded(hidden, 3), 5))
    assert [f.candidate.name for f in found.explanations] == ["base/virtual_mass"]
    assert found.explanations[0].values == pytest.approx(0.3, abs=0.05)


def with_slow_angles(logs, seed, dt, memory=0.02):
    """Noise of a memory [s] on the angles, 0.2 mrad; white on wrench and torque."""
    rng, keep = np.random.default_rng(seed), np.exp(-dt / memory)
    out = []
    for log in logs:
        fresh = np.sqrt(1 - keep**2) * rng.standard_normal(log.q.shape)
        slow = scipy.signal.lfilter([1.0], [1.0, -keep], fresh, axis=0)
        white = {k: getattr(log, k) for k in ("w", "tau")}
        white = {k: x + 0.3 * rng.standard_normal(x.shape) for k, x in white.items()}
        out.append(dataclasses.replace(log, q=log.q + 2e-4 * slow, **white))
    return out


@pytest.mark.parametrize("lag", [0.0, -0.4])
@pytest.mark.slow
def test_noise_of_angles_makes_no_sensor_slower(lag):
    """Tolerances of ten times the usual: sensor/lag was named, gain 51, where none is."""
    system = System(vehicle=BENT_THESIS, mode="emulated")
    hidden = system.replace(effects=(E.SensorLag(error=lag),)) if lag else system
    logs = with_slow_angles(recorded(hidden, 3), 3, system.control_dt)
    inputs = system_inputs(logs, system, final=0, stated=StatedErrors(scale=10.0))
    names = ("sensor/lag", "joint/measurement_delay")
    library = [c for c in inputs.candidates if c.name.startswith(names)]
    found = diagnose(inputs.machine, inputs.runs, inputs.final, candidates=library)
    assert [f.candidate.name for f in found.explanations] == ["sensor/lag"] * bool(lag)


if __name__ == "__main__":
    name, first, last = sys.argv[1], *map(int, sys.argv[2:])
    described = System(vehicle=VEHICLES[name])
    clean = recorded(described, 3)
    for k in range(first, last):
        found = told(described, with_pose_noise(clean, k), ("joint", "wrench", "base"))
        print(name, k, found.sentence, flush=True)
