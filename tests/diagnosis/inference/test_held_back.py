"""Runs held back count like those fitted: what they contradict does not stand."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import ves_gym.effects as E
from tests.diagnosis import logs
from ves_gym.diagnosis.diagnose import MORE, NAMED, NOTHING, UNKNOWN
from ves_gym.diagnosis.inference.fit import fit, fit_residual
from ves_gym.diagnosis.inference.held_back import gaps, likeliness
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.mechanics.vehicle import DECOUPLED, MatrixVehicle
from ves_gym.system.system import System

NONE = np.zeros(0)
DESCRIBED = System(vehicle=DECOUPLED)
RUBBING = DESCRIBED.replace(effects=(E.JointCoulomb(torque=(12.0, 0.0, 0.0)),))


def recorded(system, seed):
    return logs.recorded(system, seed, described=DESCRIBED, duration=8.0)[0]


def told(some, kinds=("joint/coulomb", "joint/viscous"), final=1):
    return logs.told(DESCRIBED, some, lambda c: c.kind in kinds, final)


@pytest.fixture(scope="module")
def made():
    """Log of each system, fitted and held back."""
    less = DESCRIBED.replace(effects=(E.JointCoulomb(torque=(6.0, 0.0, 0.0)),))
    systems = {"described": DESCRIBED, "rubbing": RUBBING}
    some = {(k, seed): recorded(s, seed) for k, s in systems.items() for seed in (1, 2)}
    return {**some, ("less", 2): recorded(less, 2)}


def residuals_of(fitted, held_back):
    """Of both runs, and the candidate that may be named."""
    inputs = system_inputs([fitted, held_back], DESCRIBED, final=1)
    coulomb = next(c for c in inputs.candidates if c.name == "joint/coulomb at joint 1")
    return *(WhitenedResiduals(inputs.machine, r) for r in (inputs.runs, inputs.final)), coulomb


def test_a_name_that_holds_is_kept(made):
    found = told([made["rubbing", 1], made["rubbing", 2]])
    assert found.verdict == NAMED, found.sentence
    assert [f.candidate.name for f in found.explanations] == ["joint/coulomb at joint 1"]
    assert found.explanations[0].values == pytest.approx(12.0, rel=0.02)


@pytest.mark.parametrize(("turns", "kept"), [(0.7, True), (0.6, False)])
def test_what_repeats_is_named_after_two_thirds_of_a_period(made, turns, kept):
    """Within less neither need turn nor change its curvature: a cable is no ripple."""
    residuals, _, coulomb = residuals_of(made["rubbing", 1], made["rubbing", 2])
    repeats = replace(coulomb, periods=lambda x: turns)
    f = fit(residuals, [repeats], [np.array([10.0])])
    assert f.is_told(0) == kept


def test_a_number_at_the_edge_of_its_range_is_no_name(made):
    residuals, _, coulomb = residuals_of(made["rubbing", 1], made["rubbing", 2])
    f = fit(residuals, [replace(coulomb, high=(8.0,))], [np.array([5.0])])
    assert f.values[0][0] == 8.0 and not f.is_told(0)


def test_runs_held_back_are_judged_by_the_form_that_a_law_has_taken():
    """Claim: friction that builds up over a distance holds on runs held back.

    A fit may have it in part (docs/diagnosis.md, other forms of an effect); by the plain law
    alone a Stribeck friction of the trial made the run held back worse than none.
    """
    building = DESCRIBED.replace(effects=(E.JointMemory(
        lasting=(12.0, 0.0, 0.0), rested=(0.0,) * 3, rested_fast=(0.0,) * 3,
        rested_slow=(0.0,) * 3,
    ),))  # fmt: skip
    fitted, last, coulomb = residuals_of(recorded(building, 1), recorded(building, 2))
    null, named = fit(fitted, (), ()), fit(fitted, [coulomb], [np.array([10.0])])
    assert named.forms[0] > 0.5  # of the difference to the form that it truly has
    for unseen in (False, True):
        runs = last if unseen else fitted
        z, plain = (
            fit_residual(runs, f, not unseen) for f in (named, replace(named, forms=NONE))
        )
        assert np.mean(z**2) < 0.5 * np.mean(plain**2), unseen
    built, plain, none = (
        likeliness(last, fit_residual(last, f, False))
        for f in (named, replace(named, forms=NONE), null)
    )
    assert built < min(plain - 30, none)


def test_a_name_that_runs_held_back_contradict_is_withdrawn(made):
    found = told([made["rubbing", 1], made["described", 2]])
    assert not found.explanations, found.sentence


def test_a_silence_that_runs_held_back_contradict_is_unknown(made):
    found = told([made["described", 1], made["rubbing", 2]])
    assert found.verdict == UNKNOWN, found.sentence
    assert found.beliefs["none of these"] > 0.99


def test_a_silence_that_holds_is_kept(made):
    found = told([made["described", 1], made["described", 2]])
    assert found.verdict == NOTHING, found.sentence
    assert found.beliefs["nothing"] > 0.99


def test_what_has_no_name_has_a_place_and_a_quantity(made):
    """Coulomb friction without its name: laws without one at its joint, on both runs."""
    found = told([made["rubbing", 1], made["rubbing", 2]], ("joint/ripple",))
    assert found.verdict == UNKNOWN and not found.explanations, found.sentence
    assert {c.slot for c in found.unnamed.candidates} == {"joint 1"}
    assert "what is at joint 1 is written" in found.sentence
    gap = next(g for g in found.final if (g.port, g.channel) == ("joint", "tau_1"))
    assert gap.after**2 - 1 < 0.1 * (gap.before**2 - 1)


@pytest.mark.parametrize(
    ("pose", "times", "worse"),
    [pytest.param(2e-4, 1, False, marks=pytest.mark.slow), (5e-5, 1, False), (5e-5, 3, True)],
)
def test_noise_that_an_effect_passes_on_makes_no_channel_worse(pose, times, worse):
    """Seven times the damping multiplies the noise of a pose: more is left, all of it noise.

    Three times as large as it is the same effect leaves more than its noise.
    """
    M, K = np.diag([420.0] * 3 + [160.0] * 3), np.diag([120e3] * 3 + [90e3] * 3)
    D = 0.05 * 2 * np.sqrt(K * M)
    vehicle = MatrixVehicle(M=M.tolist(), D=D.tolist(), K=K.tolist(), source="this test")
    described = System(vehicle=vehicle)
    damped = described.replace(effects=(E.BaseDamping(error=6.0),))
    sizes = {"y": pose, "w": 0.3, "q": 1e-4, "tau": 0.3}
    noisy = []
    for seed in (1, 2):
        (log,) = logs.recorded(damped, seed, described=described, duration=8.0)
        noisy.append(logs.with_noise(log, sizes, np.random.default_rng(seed)))
    inputs = system_inputs(noisy, described, final=1)
    candidate = next(c for c in inputs.candidates if c.kind == "base/damping")
    fitted, last = (WhitenedResiduals(inputs.machine, k) for k in (inputs.runs, inputs.final))
    null = fit(fitted, (), ())
    found = fit(fitted, (candidate,), (np.array([6.0]),))
    assert found.values[0][0] > 3
    found = replace(found, values=(times * found.values[0],))
    there = [g for g in gaps(last, found, null, False) if g.port == "base"]
    more = any(g.after > 1.05 * max(g.before, 1.0) for g in there)
    assert more == (pose > 1e-4 or worse)
    assert any(g.worse and g.ratio_interval[0] > 1 for g in there) == worse


def test_a_name_with_other_numbers_in_another_run_is_withdrawn(made):
    """Claim: friction of 12 N m in one run and 6 N m in the next is no Coulomb friction."""
    found = told([made["rubbing", 1], made["less", 2]], final=0)
    assert found.verdict in (MORE, UNKNOWN), found.sentence
    assert len(found.selection.fit.candidates) == len(found.explanations)


@dataclass(frozen=True, kw_only=True)
class Thinning(E.JointViscous):
    """Friction whose damping falls with the square of the rate."""

    def law(self, q, v, tau):
        return -self.damping * v * (1 - 0.3 * v * v)


def test_grease_that_thins_is_viscous_friction_still():
    """Claim: damping that falls by a sixth at 0.75 rad/s is named, with its number at rest."""
    thins = Thinning(damping=(12.0, 0.0, 0.0))
    logs = [recorded(DESCRIBED.replace(effects=(thins,)), seed) for seed in (1, 2)]
    found = told(logs, final=0)
    assert found.verdict == NAMED, found.sentence
    (viscous,) = found.explanations
    assert viscous.candidate.kind == "joint/viscous"
    assert viscous.values[0] == pytest.approx(12.0, rel=0.02)
    plain = replace(viscous.candidate, blurs=())
    runs = found.residuals
    more = fit(runs, [plain], [viscous.values]).deviance
    assert more - fit(runs, [viscous.candidate], [viscous.values]).deviance > 100
