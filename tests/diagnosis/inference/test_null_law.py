"""The law of the best of a library where nothing is missing, against closed forms and draws.

Sensors that wander are told from what is missing, and the colour of noise from motion.
"""

import dataclasses
import types

import numpy as np
import pytest
import scipy

import ves_gym.effects as E
from tests.diagnosis.test_every_effect import STD, SYSTEM, library_of, noisy, played
from ves_gym._util.signals import SensorNoiseModel
from ves_gym.diagnosis.data.measured_run import run_of, with_shared_colour
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.null_law import null_law
from ves_gym.diagnosis.inference.signatures import SignatureBlock, Signatures
from ves_gym.diagnosis.inference.slow_noise import MEMORIES, MOST, slow_noise
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
        usual=np.ones(n),
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


@pytest.mark.parametrize("curvature", [1e-26, 0.01])
def test_what_does_nothing_is_not_looked_at(curvature):
    """Rounding of effects that do nothing is large beside their own curvature."""
    law = alone(np.diag([1.0] * 5 + [curvature] * 40), OFFSET)
    assert law.tests == (5 if curvature < 1e-6 else 45)
    rare = scipy.stats.chi2.isf(1e-4 / law.tests, 1)
    assert law.chance(rare, OFFSET) == pytest.approx(1e-4, rel=0.2)


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
    return min(
        law.chance(null.deviance - s.deviance, signatures.candidates[s.candidate])
        for s in scores
        if np.isfinite(s.deviance)
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


def test_an_effect_that_is_there_is_no_chance():
    rubbing = played(SYSTEM, E.JointCoulomb(torque=(0.0, 1.5, 0.0)))
    _, signatures, null = at_joints(noisy(rubbing))
    law = null_law(signatures, null.size)
    assert chance_of(law, signatures, signatures.residuals.null) < 1e-3


SHARE = 0.2


def wandering(log, seed, memory):
    """The log with slow noise on torques, a fifth of the variance of the noise stated."""
    correlation = np.full(3, np.exp(-(log.t[1] - log.t[0]) / memory))
    drawn = SensorNoiseModel(STD["tau"], correlation).draw(
        np.random.default_rng(seed), 1, len(log)
    )
    return dataclasses.replace(log, tau=log.tau + np.sqrt(SHARE) * drawn[0])


def at_servos(logs, slow=None):
    machine = SystemMachine(SYSTEM)
    machine.ports = tuple(p for p in machine.ports if p.name == "servo")
    runs = [run_of(k, f"run-{i}") for i, k in enumerate(logs)]
    return WhitenedResiduals(machine, with_shared_colour(runs, runs), slow=slow)


def share(residuals):
    found = slow_noise(residuals).get("servo")
    return 0.0 if found is None else found.share


@pytest.mark.slow
@pytest.mark.parametrize("memory", MEMORIES)
def test_a_wander_of_most_channels_is_noise_and_not_a_gap(healthy, memory, monkeypatch):
    still = [noisy(healthy, seed) for seed in range(4)]
    moved = [wandering(k, seed, memory) for seed, k in enumerate(still)]
    assert share(at_servos(still)) < 0.05
    residuals = at_servos(moved)
    found = slow_noise(residuals)
    assert 0 < found["servo"].share <= MOST
    lowest = [k for k, g in enumerate(residuals.groups) if g.low == 0]
    before, after = (fit(r, (), ()).size[lowest] for r in (residuals, at_servos(moved, found)))
    # share and memory trade off: what they do to the lowest frequencies is what can be told
    assert before.mean() > 4 and 0.6 < after.mean() < 1.2
    # as on an axis alone, where the median may be friction that was taken for a wander
    monkeypatch.setattr("ves_gym.diagnosis.inference.slow_noise._FEWEST", 4)
    assert slow_noise(residuals) == {}


def test_an_offset_of_one_joint_is_no_wander(healthy):
    pushed = [
        noisy(dataclasses.replace(healthy, tau=healthy.tau + np.array([0, 5, 0])), k)
        for k in range(2)
    ]
    assert share(at_servos(pushed)) < 0.05


def test_runs_share_the_colour_of_the_one_that_moves_least(healthy):
    hiss = np.random.default_rng(0).standard_normal(healthy.tau.shape)
    shaken = dataclasses.replace(noisy(healthy, 1), tau=noisy(healthy, 1).tau + hiss)
    calm, loud = (run_of(k, "run") for k in (noisy(healthy, 0), shaken))
    assert loud.noise["tau"].correlation.max() < 0.2 < calm.noise["tau"].correlation.min()
    shared = with_shared_colour([loud], [calm, loud])[0].noise["tau"]
    assert shared.correlation == pytest.approx(calm.noise["tau"].correlation)
    assert shared.std == pytest.approx(STD["tau"])
