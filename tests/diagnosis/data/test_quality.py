"""Faults of a recording are found, and nothing else is taken for one."""

import dataclasses

import numpy as np
import pytest

from tests.diagnosis.conftest import MOVES, SINES
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.data.quality import faults


@pytest.fixture(scope="module")
def logs(hidden):
    return hidden(seed=1, runs=(SINES, MOVES))


def runs_of(logs, **changed):
    """Runs of the logs with a signal put through a function of it and its time stamps."""
    logs = [
        dataclasses.replace(
            k, **{name: f(getattr(k, name).copy(), k.t) for name, f in changed.items()}
        )
        for k in logs
    ]
    return [run_of(log, f"run-{i}") for i, log in enumerate(logs)]


def test_a_sound_recording_has_none(logs):
    assert faults(runs_of(logs)) == ()


def lossy(share, burst=6):
    def lose(x, t):
        rng = np.random.default_rng(0)
        for at in np.flatnonzero(rng.random(len(x) // burst - 1) < share) * burst + burst:
            x[at : at + burst] = x[at - 1]
        return x

    return lose


def test_lost_samples_are_told_with_their_share(logs):
    (found,) = faults(runs_of(logs, w=lossy(0.05)))
    assert (found.signal, found.kind, found.shared) == ("w", "repeats", False)
    assert found.size == pytest.approx(0.05, rel=0.4)
    assert "repeats itself" in found.sentence


def test_an_arm_at_rest_loses_nothing(logs):
    def hold(x, t):
        x[400:900] = x[400]
        return x

    still = dict.fromkeys(("q", "v", "tau", "y", "w"), hold)
    assert [f for f in faults(runs_of(logs, **still)) if f.kind == "repeats"] == []


def tone(size, frequency):
    return lambda x, t: x + size * np.sin(2 * np.pi * frequency * t)[:, None]


def test_a_tone_is_told_with_its_frequency(logs):
    (found,) = faults(runs_of(logs, w=tone(1.0, 50.0)))
    assert (found.signal, found.kind, found.shared) == ("w", "tone", False)
    assert found.frequency == pytest.approx(50.0, abs=1 / 8 + 0.044)  # a bin of 8 s, a step
    assert faults(runs_of(logs, w=tone(0.01, 50.0))) == ()  # far below the noise


def test_a_tone_that_others_share_may_be_the_machine(logs):
    found = faults(runs_of(logs, w=tone(1.0, 20.0), y=tone(2e-4, 20.0)))
    assert {f.signal for f in found} == {"w", "y"} and all(f.shared for f in found)


def test_a_tone_that_the_joints_are_told_is_motion(logs):
    shaken = {"tau": tone(20.0, 20.0), "v": tone(0.2, 20.0)}
    assert {f.signal for f in faults(runs_of(logs, **shaken))} == {"tau", "v"}
    assert faults(runs_of(logs, **shaken, v_cmd=tone(0.2, 20.0))) == ()
