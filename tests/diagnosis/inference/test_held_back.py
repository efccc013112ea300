"""Runs held back decide: what they contradict is withdrawn, names and silence alike."""

import dataclasses

import pytest

import ves_gym.effects as E
from ves_gym.diagnosis.diagnose import NAMED, NOTHING, UNKNOWN, diagnose
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.mechanics.vehicle import DECOUPLED
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

DESCRIBED = System(vehicle=DECOUPLED)
RUBBING = DESCRIBED.replace(effects=(E.JointCoulomb(torque=(12.0, 0.0, 0.0)),))


def recorded(system, seed):
    motions = excitation_motions(1, system.arm, duration=8.0, seed=seed)
    recording = play_motions(
        system, motions, settle=1.0, record_dt=system.control_dt, seed=seed
    )
    log = recording.log(0)
    return dataclasses.replace(log, meta={**log.meta, "system": DESCRIBED.to_dict()})


@pytest.fixture(scope="module")
def logs():
    """Log of each system, fitted and held back."""
    systems = {"described": DESCRIBED, "rubbing": RUBBING}
    return {(k, seed): recorded(s, seed) for k, s in systems.items() for seed in (1, 2)}


def told(fitted, held_back, kinds=("joint/coulomb", "joint/viscous")):
    inputs = system_inputs([fitted, held_back], DESCRIBED, final=1)
    library = [c for c in inputs.candidates if c.kind in kinds]
    return diagnose(inputs.machine, inputs.runs, inputs.final, candidates=library)


def test_a_name_that_holds_is_kept(logs):
    found = told(logs["rubbing", 1], logs["rubbing", 2])
    assert found.verdict == NAMED, found.sentence
    assert [f.candidate.name for f in found.explanations] == ["joint/coulomb at joint 1"]
    assert found.explanations[0].values == pytest.approx(12.0, rel=0.02)


def test_a_name_that_runs_held_back_contradict_is_withdrawn(logs):
    found = told(logs["rubbing", 1], logs["described", 2])
    assert found.verdict == UNKNOWN, found.sentence
    assert not found.effects
    assert "withdrawn" in found.selection.steps[-1]
    assert not any(g.worse for g in found.final)


def test_a_silence_that_runs_held_back_contradict_is_unknown(logs):
    found = told(logs["described", 1], logs["rubbing", 2])
    assert found.verdict == UNKNOWN, found.sentence


def test_a_silence_that_holds_is_kept(logs):
    found = told(logs["described", 1], logs["described", 2])
    assert found.verdict == NOTHING, found.sentence


def test_what_has_no_name_has_a_place_and_a_quantity(logs):
    """Coulomb friction without its name: a curve over the speed of its joint, on both runs."""
    found = told(logs["rubbing", 1], logs["rubbing", 2], kinds=("joint/ripple",))
    assert found.verdict == UNKNOWN, found.sentence
    best = found.depends[0]
    assert (best.port, best.channel, best.on) == ("joint", "tau_1", "speed of joint 1")
    assert best.share > 0.9
    assert best.sentence in found.sentence
