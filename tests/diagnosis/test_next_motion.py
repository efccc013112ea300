"""The experiment designed keeps all limits, is worth more than runs at hand, and decides."""

import dataclasses
import types

import numpy as np
import pytest

from tests.diagnosis.logs import told, with_noise
from tests.diagnosis.thesis_laboratory import SYSTEM
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis import next_motion as next_motion_module
from ves_gym.diagnosis.constants import POWER
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.next_motion import next_motion
from ves_gym.effects import JointDriveGain, JointTorqueLimit, SensorNoise
from ves_gym.mechanics.limits import check_reference, limits_of
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.simulation.playback import play_motions

KINDS = ("joint/drive_gain", "joint/torque_offset", "joint/coulomb", "joint/viscous")
NOISE = SensorNoise(force=(0.3,) * 3, moment=(0.1,) * 3)
TRUTH = JointDriveGain(error=(0.0, 0.007, 0.0))


def measured(motion, seed, effects=(TRUTH,)):
    """Log of the machine whose second drive gives 0.7 % more than described."""
    true = SYSTEM.replace(effects=(*effects, NOISE))
    log = play_motions(true, [motion], servo=HIGH_GAINS, settle=0.0, record_dt=5e-3).log(0)
    log = with_noise(
        log, {"q": 2e-5, "tau": 0.3, "y": 1e-5}, np.random.default_rng(seed), False
    )
    meta = {k: v for k, v in log.meta.items() if k != "controller"}  # it would tell them apart
    return dataclasses.replace(log, meta={**meta, "system": SYSTEM.to_dict()})


def diagnosed(logs, kinds=KINDS):
    return told(None, logs, lambda c: c.kind in kinds)


@pytest.fixture(scope="module")
def at_hand():
    """A joint that carries its weight and hardly turns: a gain off, or an offset?"""
    log = measured(Motion.straight([0.3, 0.5, 0.4], [0.4, 0.54, 0.37], 4.0), 1)
    return log, diagnosed([log])


@pytest.fixture(scope="module")
def designed(at_hand):
    return next_motion(at_hand[1], pool=2, rounds=1)


@pytest.fixture(scope="module")
def after(at_hand, designed):
    return diagnosed([at_hand[0], measured(designed.motion, 2)])


def test_rivals_get_a_motion_that_keeps_every_limit(at_hand, designed):
    assert at_hand[1].verdict == d.ONE_OF
    assert designed.between == ("joint/drive_gain at joint 2", "joint/torque_offset at joint 2")
    arm, ends = SYSTEM.arm, designed.motion.at([0.0, designed.motion.duration])
    limits = limits_of(arm, a_max=tuple(arm.column("a_max")))
    assert check_reference(arm, designed.motion, limits).inside
    assert np.abs([ends.v, ends.a]).max() < 1e-9
    simulated = {"position", "velocity", "torque", "stroke", "leg speed", "force", "moment"}
    assert set(designed.limits) == simulated and max(designed.limits.values()) <= 0.95


def test_it_is_worth_more_than_the_run_at_hand_and_decides(designed, after):
    assert designed.least > POWER and designed.least > 2 * designed.at_hand > 0
    assert designed.tried >= 5
    assert after.verdict == d.NAMED and len(after.explanations) == 1
    assert after.explanations[0].candidate.name == "joint/drive_gain at joint 2"
    assert after.explanations[0].values[0] == pytest.approx(0.007, rel=0.1)
    assert next_motion(after) is None  # nothing is open


def test_the_separation_predicted_is_that_which_the_run_has(at_hand, designed, after):
    """The deviance between full fits on both runs grows as linear fits had foreseen it."""
    gaps = []
    for residuals in (at_hand[1].residuals, after.residuals):
        rivals = at_hand[1].selection.rivals[0][:2]
        fits = [fit(residuals, [r.candidate], [r.values]) for r in rivals]
        gaps.append(fits[1].deviance - fits[0].deviance)
    expected = designed.sigma[0][1] ** 2
    spread = 2 * np.sqrt(expected)  # of a deviance between two fixed models
    assert gaps[1] - gaps[0] == pytest.approx(expected, abs=3 * spread)


@pytest.mark.slow
def test_what_could_not_be_seen_gets_a_motion_that_shows_it():
    still = measured(Motion.straight([0.3, 0.5, 0.4], [0.301, 0.501, 0.401], 4.0), 4, ())
    before = diagnosed([still])
    assert before.verdict == d.WEAK
    designed = next_motion(before, pool=2, rounds=0)
    assert not designed.separates and set(designed.between) <= set(before.weak)
    assert designed.least > 2 * designed.at_hand
    assert "at their usual size" in designed.sentence


@pytest.mark.slow
def test_a_limit_that_no_run_came_near_is_reached():
    """A motor of joint 3 that gives 0.6 less than said, at hand a move of 1 mrad."""
    kinds, truth = (*KINDS, "joint/torque_limit"), JointTorqueLimit(fraction=(0.0, 0.0, 0.6))
    still = Motion.straight([0.3, 0.5, 0.4], [0.301, 0.501, 0.401], 4.0)
    first = measured(still, 4, (truth,))
    before = diagnosed([first], kinds)
    assert before.verdict == d.WEAK
    best = next_motion(before, pool=4, rounds=1)
    assert max(best.limits.values()) <= 0.95
    after = diagnosed([first, measured(best.motion, 5, (truth,))], kinds)
    assert [f.candidate.name for f in after.explanations] == ["joint/torque_limit at joint 3"]
    assert after.explanations[0].values[0] == pytest.approx(0.6, abs=0.01)


def test_what_every_run_at_hand_came_near_may_be_come_near_again(at_hand):
    """A drive that is weaker than said is at its limit in any motion."""
    search = next_motion_module._search_of(at_hand[1])
    (near,) = search.played(search.rivals[0], search.at_hand())
    near = dataclasses.replace(near, limits={**near.limits, "torque": 1.0})
    assert not search.allowed(near)
    search.allow_again([types.SimpleNamespace(played=near)])
    assert search.allowed(near)
    assert not search.allowed(
        dataclasses.replace(near, limits={**near.limits, "velocity": 0.96})
    )


def test_a_motion_is_a_table_for_a_controller(designed):
    rows = np.array([r.split(",") for r in designed.table(5e-3).split()[1:]], float)
    t, q = rows[:, 0], rows[:, 1:4]
    assert np.diff(t) == pytest.approx(5e-3) and t[-1] == pytest.approx(4.0)
    assert q == pytest.approx(designed.motion.at(t).q, abs=1e-8)
    assert np.gradient(q, t, axis=0)[5:-5] == pytest.approx(rows[5:-5, 4:], abs=2e-3)
