"""A law has the same numbers in every run and throughout it; else its name is withdrawn."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import ves_gym.effects as E
from tests.diagnosis.inference.test_held_back import DESCRIBED, RUBBING, recorded
from ves_gym.diagnosis.diagnose import NAMED, UNKNOWN, diagnose
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.reliability import gain
from ves_gym.diagnosis.inference.steadiness import in_run, in_third, unsteadiness
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.inputs import system_inputs

LESS = DESCRIBED.replace(effects=(E.JointCoulomb(torque=(6.0, 0.0, 0.0)),))


@pytest.fixture(scope="module")
def logs():
    return {"as before": recorded(RUBBING, 2), "less": recorded(LESS, 2)}


@pytest.fixture(scope="module")
def first():
    return recorded(RUBBING, 1)


@pytest.fixture(scope="module")
def named(first, logs):
    """Residuals of two runs with the same friction, and its fit."""
    inputs = system_inputs([first, logs["as before"]], DESCRIBED, final=0)
    residuals = WhitenedResiduals(inputs.machine, inputs.runs)
    coulomb = next(c for c in inputs.candidates if c.name == "joint/coulomb at joint 1")
    return residuals, fit(residuals, [coulomb], [np.array([10.0])])


def test_a_law_that_holds_is_steady(named):
    residuals, f = named
    more, count = unsteadiness(f, 0, residuals)
    assert count == 3  # a run and two thirds
    assert more < 0.01 * gain(residuals, f, 0)


@pytest.mark.parametrize("part", [in_run, in_third])
def test_one_that_is_there_in_a_part_alone_is_not(named, part):
    residuals, f = named
    slope = f.tangents[:, len(f.forms) :]
    share = 0.3 * f.values[0] * part(residuals, slope, 0)[:, 0]
    more, _ = unsteadiness(replace(f, residual=f.residual + share), 0, residuals)
    assert more > 0.1 * gain(residuals, f, 0)


def test_parts_together_are_the_whole(named):
    residuals, f = named
    x, measured = f.tangents, residuals.measured
    runs = sum(in_run(residuals, x, k) for k in range(2))
    thirds = sum(in_third(residuals, x, k) for k in range(3))
    assert np.array_equal(runs[measured], x[measured])
    np.testing.assert_allclose(thirds[measured], x[measured], atol=1e-9 * np.abs(x).max())


@pytest.mark.parametrize(("second", "verdict"), [("as before", NAMED), ("less", UNKNOWN)])
def test_a_name_with_other_numbers_in_another_run_is_withdrawn(first, logs, second, verdict):
    """Claim: friction of 12 N m in one run and 6 N m in the next is no Coulomb friction."""
    inputs = system_inputs([first, logs[second]], DESCRIBED, final=0)
    library = [c for c in inputs.candidates if c.kind in ("joint/coulomb", "joint/viscous")]
    found = diagnose(inputs.machine, inputs.runs, (), candidates=library)
    assert found.verdict == verdict, found.sentence
    withdrawn = any("with other numbers in each run" in s for s in found.selection.steps)
    assert withdrawn == (verdict == UNKNOWN)


@dataclass(frozen=True, kw_only=True)
class Thinning(E.JointViscous):
    """Friction whose damping falls with the square of the rate."""

    def law(self, q, v, tau):
        return -self.damping * v * (1 - 0.3 * v * v)


def test_grease_that_thins_is_viscous_friction_still():
    """Claim: damping that falls by a sixth at 0.75 rad/s is named, with its number at rest."""
    thins = Thinning(damping=(12.0, 0.0, 0.0))
    logs = [recorded(DESCRIBED.replace(effects=(thins,)), seed) for seed in (1, 2)]
    inputs = system_inputs(logs, DESCRIBED, final=0)
    names = ("joint/viscous at joint 1", "joint/coulomb at joint 1")
    library = [c for c in inputs.candidates if c.name in names]
    found = diagnose(inputs.machine, inputs.runs, (), candidates=library)
    assert found.verdict == NAMED, found.sentence
    (viscous,) = found.explanations
    assert viscous.candidate.kind == "joint/viscous"
    assert viscous.values[0] == pytest.approx(12.0, rel=0.02)
    plain = replace(viscous.candidate, blurs=())
    runs = WhitenedResiduals(inputs.machine, inputs.runs)
    more = fit(runs, [plain], [viscous.values]).deviance
    assert more - fit(runs, [viscous.candidate], [viscous.values]).deviance > 100
