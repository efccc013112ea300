"""One physical cause has one name, and there are as many names as the evidence bears.

Machine, motion and noise are those of `test_every_effect`.
"""

import pytest

import ves_gym as vg
from tests.diagnosis.test_every_effect import SYSTEM, noisy, played
from ves_gym.diagnosis import diagnose as d
from ves_gym.diagnosis.machines.base import WRENCH
from ves_gym.diagnosis.machines.causes import FRICTION
from ves_gym.effects import (
    BaseDamping,
    BaseStiffness,
    GravityMass,
    JointCoulomb,
    JointViscous,
    SensorBias,
)

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)
VISCOUS, COULOMB = (9.0, 14.0, 6.0), (4.0, 6.0, 3.0)
BIAS = SensorBias(force=(1.0, -2.0, 1.5), moment=(0.8, 0.6, -0.7))
RUBBING = (JointViscous(damping=VISCOUS), JointCoulomb(torque=COULOMB))


def told(*effects, **options):
    """The diagnosis of one log of a machine with something hidden."""
    return vg.diagnose(noisy(played(SYSTEM, *effects)), as_logged=True, **options)


def named(found):
    return [f.candidate.kind for f in found.explanations]


def test_a_bias_of_all_six_signals_is_one_cause_and_friction_of_all_joints_another():
    """With their twelve numbers, which the better description has and reads back."""
    found = told(BIAS, *RUBBING)
    by_kind = {f.candidate.kind: f for f in found.explanations}
    assert by_kind.keys() == {"sensor/bias", FRICTION}, found.sentence
    bias = [*BIAS.force, *BIAS.moment]
    assert by_kind["sensor/bias"].values == pytest.approx(bias, abs=0.1)
    assert by_kind[FRICTION].values == pytest.approx([*VISCOUS, *COULOMB], rel=0.2)
    assert all(signal in found.sentence for signal in WRENCH)
    written = {e.kind: e for e in found.system.effects}
    assert written.keys() == {"joint/viscous", "joint/coulomb", "sensor/bias"}
    assert written["joint/viscous"].damping == pytest.approx(VISCOUS, rel=0.2)
    better = written["sensor/bias"]
    assert [*better.force, *better.moment] == pytest.approx(bias, abs=0.1)
    assert vg.System.from_dict(found.system.to_dict()) == found.system
    before, after = (
        max(getattr(g, side) for g in found.gaps if g.port == "joint")
        for side in ("before", "after")
    )
    assert before > 30 and after < 3


@pytest.mark.slow
def test_friction_of_two_joints_is_said_by_joint():
    found = told(JointViscous(damping=(0.0, 14.0, 0.0)), JointCoulomb(torque=(4.0, 0.0, 0.0)))
    places = {(f.candidate.kind, f.candidate.slot) for f in found.explanations}
    assert places == {("joint/viscous", "joint 2"), ("joint/coulomb", "joint 1")}


@pytest.mark.slow
def test_there_are_as_many_names_as_the_evidence_bears():
    hidden = (
        SensorBias(force=(0.5, -0.6, 0.4), moment=(0.4, 0.3, -0.3)),
        *RUBBING,
        GravityMass(error=0.3),
        BaseStiffness(error=0.08),
        BaseDamping(error=0.6),
    )
    found = told(*hidden)
    kinds = {"sensor/bias", FRICTION, "gravity/mass", "base/stiffness", "base/damping"}
    assert set(named(found)) == kinds and len(found.explanations) == 5, found.sentence
    assert max(g.after for g in found.gaps) < 3
    assert len(told(*hidden, most=2).explanations) == 2


@pytest.mark.slow
def test_causes_are_quiet_where_nothing_is_missing():
    found = told()
    assert found.verdict == d.NOTHING, found.sentence
    kinds = {c.kind for c in found.signatures.candidates}
    assert {"sensor/bias", FRICTION} <= kinds
