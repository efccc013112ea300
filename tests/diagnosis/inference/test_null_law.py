"""The law of the best of a library where nothing is missing, against closed forms and draws."""

import types

import numpy as np
import pytest
import scipy

import ves_gym.effects as E
from tests.diagnosis.test_every_effect import SYSTEM, library_of, noisy, played
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.null_law import NullLaw, best_chance, null_law
from ves_gym.diagnosis.inference.signatures import SignatureBlock, Signatures
from ves_gym.diagnosis.inference.variance_groups import products, solve
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.system import SystemMachine

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)
FEW = ("coulomb", "viscous", "drive_gain", "rotor_inertia", "torque_offset", "asymmetry")
OFFSET = next(c for c in library(3, ["joint"], "ideal") if c.kind == "joint/torque_offset")
COULOMB = next(c for c in library(3, ["joint"], "ideal") if c.kind == "joint/coulomb")


def alone(covariance, candidate):
    """The law of candidates of one number each whose scores have this covariance (n, n)."""
    n = len(covariance)
    signatures = types.SimpleNamespace(
        candidates=(candidate,) * n,
        blocks=[SignatureBlock(i, (i,), candidate.starts[0], (0,)) for i in range(n)],
        score_law=lambda size: (covariance, covariance),
        squares=lambda size: np.diag(covariance),
    )
    return null_law(signatures, np.ones(1), draws=4000)


@pytest.mark.parametrize("gain", [2.0, 6.0, 10.0, 25.0])
def test_candidates_that_are_alike_count_once_and_others_apart(gain):
    """Closed forms: the chance of one, and of the best of n that are independent."""
    one = scipy.stats.chi2.sf(gain, 1)
    same = alone(np.ones((40, 40)) * 3.0, OFFSET).chance(gain, OFFSET)
    apart = alone(np.diag(np.linspace(1, 9, 40)), OFFSET).chance(gain, OFFSET)
    assert same == pytest.approx(one, rel=0.5, abs=0.02)
    assert apart == pytest.approx(1 - (1 - one) ** 40, rel=0.5, abs=0.02)
    signed = alone(np.diag(np.linspace(1, 9, 40)), COULOMB).chance(gain, COULOMB)
    assert signed == pytest.approx(1 - (1 - one / 2) ** 40, rel=0.5, abs=0.02)


@pytest.mark.parametrize("law", [NullLaw(200), alone(np.eye(30), OFFSET)])
@pytest.mark.parametrize("chance", [0.2, 0.005, 1e-6])
def test_the_gain_that_is_needed_has_the_chance_asked_for(law, chance):
    got = law.chance(law.gain(chance, OFFSET), OFFSET)
    assert got == pytest.approx(chance, rel=0.1)


@pytest.fixture(scope="module")
def healthy():
    return played(SYSTEM)


def at_joints(log, kinds=FEW):
    """Residuals of the joints of a log, their library, and the null fit."""
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name == "joint")
    run = run_of(log, "run")
    residuals = WhitenedResiduals(machine, [run])
    every = library_of(machine, [run])
    some = [c for c in every if kinds is None or c.kind.removeprefix("joint/") in kinds]
    return residuals, Signatures(residuals, some), fit(residuals, (), ())


def chance_of(law, signatures, z):
    """The chance of the best of a library on a residual (N,)."""
    residuals = signatures.residuals
    none = np.zeros((residuals.length, 0))
    null = solve(products(residuals, z, none), len(residuals.nuisances))
    scores = signatures.scores(z, none, null.size)
    return best_chance(
        law,
        (
            (null.deviance - s.deviance, signatures.candidates[s.candidate])
            for s in scores
            if np.isfinite(s.deviance)
        ),
    )


def drawn(residuals, size, rng):
    """A residual (N,) under the null model: noise of these sizes (G,) and tolerances."""
    z = rng.standard_normal(residuals.length)
    for group, s in zip(residuals.groups, size, strict=True):
        z[group.part] *= np.sqrt(s)
    return z - residuals.slopes @ rng.standard_normal(residuals.slopes.shape[1])


def assert_uniform(chances):
    assert scipy.stats.kstest(chances, "uniform").pvalue > 0.02, np.sort(chances)


def test_chances_are_uniform_where_nothing_is_missing(healthy):
    """Profile likelihood of simulated residuals, sizes of the groups and tolerances unknown."""
    residuals, signatures, null = at_joints(noisy(healthy))
    law, rng = null_law(signatures, null.size), np.random.default_rng(1)
    assert_uniform(
        [chance_of(law, signatures, drawn(residuals, null.size, rng)) for _ in range(60)]
    )


@pytest.mark.slow
def test_chances_over_the_whole_library_are_nearly_uniform(healthy):
    """Missed: not uniform. Nine groups of 50 numbers, whose sizes are estimated each time, let
    the best of 254 gain a little more than the law says: KS distance 0.11 of 300 draws."""
    residuals, signatures, null = at_joints(noisy(healthy), None)
    law, rng = null_law(signatures, null.size), np.random.default_rng(1)
    chances = [chance_of(law, signatures, drawn(residuals, null.size, rng)) for _ in range(300)]
    assert scipy.stats.kstest(chances, "uniform").statistic < 0.15


@pytest.mark.slow
def test_chances_are_no_smaller_than_uniform_in_logs_of_exact_descriptions(healthy):
    """New noise on the signals each time, its shape estimated. Tolerances, which the law draws,
    are all zero here, so chances are larger (KS distance 0.38), never smaller."""
    chances = []
    for seed in range(40):
        _, signatures, null = at_joints(noisy(healthy, seed))
        law = null_law(signatures, null.size)
        chances.append(chance_of(law, signatures, signatures.residuals.null))
    assert scipy.stats.kstest(chances, "uniform", alternative="greater").pvalue > 0.02


@pytest.mark.parametrize(
    "effect",
    [
        E.JointCoulomb(torque=(0.0, 1.5, 0.0)),
        pytest.param(E.JointDriveGain(error=(0.0, 0.03, 0.0)), marks=pytest.mark.slow),
        pytest.param(E.JointTorqueOffset(torque=(0.0, 1.5, 0.0)), marks=pytest.mark.slow),
    ],
)
def test_an_effect_that_is_there_is_no_chance(effect):
    _, signatures, null = at_joints(noisy(played(SYSTEM, effect)))
    law = null_law(signatures, null.size)
    assert chance_of(law, signatures, signatures.residuals.null) < 1e-3
