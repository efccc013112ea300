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

import ves_gym.effects as E
from ves_gym.diagnosis.diagnose import NOTHING, WEAK, diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.variance_groups import InnerProducts, solve
from ves_gym.diagnosis.inputs import system_inputs
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
    """Against scipy's density of y - b x, whose noise has the variance 1 + b^2."""
    p, (x, y) = noisy_products(np.random.default_rng(2), claimed=1.3)
    solution = solve(p, 0)
    b, n = solution.x[0], int(p.n[0])
    spread = np.sqrt(1.3 * (1 + b**2))
    density = scipy.stats.norm(scale=spread).logpdf(y - b * x).sum()
    expected = -2 * density - n * np.log(2 * np.pi * spread**2)
    assert solution.deviance == pytest.approx(expected, rel=1e-9)


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


def test_a_heavier_base_is_named_through_the_same_noise():
    system = System(vehicle=BENT_THESIS)
    hidden = system.replace(effects=(E.BaseVirtualMass(error=0.3),))
    found = told(system, with_pose_noise(recorded(hidden, 3), 5))
    assert [f.candidate.name for f in found.explanations] == ["base/virtual_mass"]
    assert found.explanations[0].values == pytest.approx(0.3, abs=0.05)


if __name__ == "__main__":
    name, first, last = sys.argv[1], *map(int, sys.argv[2:])
    described = System(vehicle=VEHICLES[name])
    clean = recorded(described, 3)
    for k in range(first, last):
        found = told(described, with_pose_noise(clean, k), ("joint", "wrench", "base"))
        print(name, k, found.sentence, flush=True)
