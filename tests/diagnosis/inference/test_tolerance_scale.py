"""How far off a description is, weighed against what it may lack.

Errors of many numbers, each several times what the description states, are no hidden effect;
one number far off is.
"""

import dataclasses

import numpy as np
import pytest

import ves_gym.effects as E
from ves_gym.diagnosis.diagnose import NOTHING, WEAK, diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.tolerance_scale import ToleranceExcess, sentence
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

DESCRIBED = System(vehicle=BENT_THESIS)
NOISE = {"tau": 0.3, "q": 1e-4, "w": 0.3}


def logs_of(system, seed=3, count=2):
    motions = excitation_motions(count, system.arm, duration=8.0, seed=seed)
    recording = play_motions(system, motions, settle=0.5, record_dt=0.01, seed=seed)
    rng = np.random.default_rng(seed)
    out = []
    for log in (recording.log(i) for i in range(count)):
        noisy = {k: getattr(log, k) for k in NOISE}
        noisy = {k: x + NOISE[k] * rng.standard_normal(x.shape) for k, x in noisy.items()}
        out.append(dataclasses.replace(log, **noisy))
    return out


def with_errors(factor, seed=5):
    """The machine with all inertias and rotors off, uniformly by 1 % times a factor."""
    rng = np.random.default_rng(seed)
    links = []
    for link in DESCRIBED.arm.links:
        off = 1 + 0.01 * factor * rng.uniform(-1, 1, 2)
        inertia = tuple(map(tuple, (np.array(link.inertial.inertia) * off[0]).tolist()))
        inertial = dataclasses.replace(link.inertial, inertia=inertia)
        rotor = link.rotor_inertia * off[1]
        links.append(dataclasses.replace(link, inertial=inertial, rotor_inertia=rotor))
    arm = dataclasses.replace(DESCRIBED.arm, links=tuple(links))
    return DESCRIBED.replace(arm=arm)


def told(logs):
    inputs = system_inputs(logs, DESCRIBED, final=0)
    library = [c for c in inputs.candidates if "joint" in c.ports]
    return diagnose(inputs.machine, inputs.runs, inputs.final, candidates=library)


def test_many_numbers_far_off_are_no_effect():
    """Errors of up to ten times what is stated: rotors were named, p = 1.00 each."""
    found = told(logs_of(with_errors(10.0)))
    assert found.verdict in (NOTHING, WEAK), found.sentence
    assert found.tolerances > 1
    assert "times as large as it says" in found.sentence
    assert found.off
    assert all(abs(e.sigma) > 3 for e in found.off)


@pytest.mark.parametrize("errors", [0.0, 1.0])
def test_a_single_number_far_off_is_named_beside_tolerances_as_stated(errors):
    heavy = with_errors(errors).replace(effects=(E.JointRotorInertia(added=(0.0, 0.8, 0.0)),))
    found = told(logs_of(heavy))
    assert [f.candidate.name for f in found.explanations] == ["joint/rotor_inertia at joint 2"]
    assert found.tolerances == 1.0
    assert found.off == ()


def test_what_is_far_off_is_said_in_a_sentence():
    off = (
        ToleranceExcess("rotor of joint 2", -0.32, -11.0),
        ToleranceExcess("mass of link 3", 0.008, 9.0),
    )
    assert sentence(1.0, ()) == ""
    assert sentence(10.0, off) == (
        " The description's errors are about 10 times as large as it says"
        " (rotor of joint 2 -0.32, mass of link 3 +0.008)."
    )
