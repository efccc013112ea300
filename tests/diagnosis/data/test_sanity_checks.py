"""Mistakes in logs are asked about, each by its name; physics is not."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.data.measured_run import require_plausible, run_of, run_of_signals
from ves_gym.diagnosis.data.sanity_checks import require_as_logged, suspected_mistake
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inputs import _heavier
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import JointCoulomb
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.motion import Motion
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

JOINT = ("q", "v", "q_cmd", "v_cmd", "tau")


@pytest.fixture(scope="module")
def log(hidden):
    """A run in which a joint rubs, too: mistakes are found beside what is missing."""
    return hidden(("joint/coulomb", 1, 3.0), seed=5, runs=(0,))[0]


def asked(log):
    system = System.from_dict(log.meta["system"])
    require_plausible(log, system, "run")
    question = suspected_mistake(SystemMachine(system), run_of(log, "run"))
    return question and question.text


def changed(log, keys, matrix):
    return dataclasses.replace(log, **{k: getattr(log, k) @ np.array(matrix).T for k in keys})


def beginning(log, seconds):
    count = int(np.searchsorted(log.t, log.t[0] + seconds))
    values = {f.name: getattr(log, f.name) for f in dataclasses.fields(log)}
    cut = {k: v[:count] for k, v in values.items() if np.shape(v)[:1] == log.t.shape}
    return dataclasses.replace(log, **cut)


def flip(n, i):
    return np.diag([-1.0 if k == i else 1.0 for k in range(n)])


def swap(n, i, j):
    return np.eye(n)[[j if k == i else i if k == j else k for k in range(n)]]


def factor(n, rows, f):
    return np.diag([f if k in rows else 1.0 for k in range(n)])


def slowly(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("keys", "matrix", "text"),
    [
        slowly(["tau"], swap(3, 0, 1), "is tau_1 exchanged with tau_2"),
        slowly(["q", "v"], flip(3, 1), "has q_2 the other sign"),
        slowly(JOINT, flip(3, 2), "has joint 3 the other sign"),
        (["tau"], 1e3 * np.eye(3), "is tau in N mm, not N m"),
        slowly(
            ["y"],
            factor(6, range(3, 6), 180 / np.pi),
            "are the angles in y in degrees, not rad",
        ),
        slowly(["wg"], flip(6, 0), "has wg F_x the other sign"),
        slowly(
            ["w", "wg"], factor(6, range(3), 1 / 9.80665), "are the forces in w and wg in kgf"
        ),
    ],
    ids=lambda x: x.replace(" ", "-")[:40] if isinstance(x, str) else "",
)
def test_a_mistake_in_the_log_is_asked_about(log, keys, matrix, text):
    """The first 3 s tell it: what a unit or a sign does is large from the start."""
    assert asked(changed(beginning(log, 3.0), keys, matrix)).startswith(text)


def late(log, keys, seconds):
    """A log in which one recorder reads what was there before."""
    count = round(seconds / float(np.median(np.diff(log.t))))
    return dataclasses.replace(
        log,
        **{
            k: np.concatenate([getattr(log, k)[:1].repeat(count, 0), getattr(log, k)[:-count]])
            for k in keys
        },
    )


@pytest.fixture(scope="module")
def in_space():
    """A noisy run in space of 7 s, and nothing missing."""
    motions = excitation_motions(1, duration=6.0, seed=1)
    log = play_motions(System(), motions, settle=1.0).log(0)
    noise = {"q": 1e-5, "v": 2e-4, "tau": 0.1, "y": 5e-5, "w": 0.3}
    rng = np.random.default_rng(0)
    parts = {
        k: getattr(log, k) + s * rng.standard_normal(getattr(log, k).shape)
        for k, s in noise.items()
    }
    meta = {**log.meta, "system": System().to_dict(), "noise_std": noise}
    return dataclasses.replace(log, meta=meta, **parts)


@pytest.mark.parametrize("keys", [["q", "v"], ["tau"], ["y", "yd"], ["w"]], ids=lambda k: k[0])
def test_a_late_recorder_is_asked_about(in_space, keys):
    """100 ms, through the noise of a pose that is differentiated twice; 10 ms are an effect."""
    assert asked(late(in_space, keys, 0.1)) == f"is {keys[0]} 100 ms late"
    assert asked(late(in_space, keys, 0.0125)) is None


def test_what_noise_hides_is_still_asked_about(in_space):
    """At port base the noise of the pose is larger than the signal."""
    assert asked(in_space) is None
    swapped = changed(in_space, ["w"], swap(6, 0, 1))
    assert asked(swapped) == "is w F_x exchanged with w F_y"
    short = beginning(in_space, 1.0)
    with pytest.raises(ParameterError, match=r"s is too short, need 1.25 s"):
        asked(short)


@pytest.mark.slow
def test_physics_is_no_mistake(log, hidden):
    """A tenth of the torque lost and a slow platform: large, and still no unit or sign."""
    assert asked(log) is None
    effects = (
        ("joint/drive_gain", 0, -0.1),
        ("platform/bandwidth", 0, -0.3),
    )
    for one in hidden(*effects, seed=6, runs=(1, 3)):
        assert asked(one) is None


@pytest.mark.slow
def test_masses_in_grams_are_asked_about(log):
    system = System.from_dict(log.meta["system"])
    stated = system.replace(arm=_heavier(system.arm, 1e3))
    with pytest.raises(ParameterError, match=r"run: are masses .* in g, not kg\?.*--as-logged"):
        require_as_logged(
            SystemMachine(stated),
            [run_of(log, "run")],
            [("are masses and inertias described in g, not kg", SystemMachine(system))],
        )


def test_a_rate_in_degrees_is_asked_about():
    """A machine without a model: the rate logged against that of the position logged."""
    t = np.arange(3000) * 5e-3
    q = np.stack([np.sin(t), np.cos(1.7 * t)], axis=1)
    v = np.stack([np.cos(t), -1.7 * np.sin(1.7 * t)], axis=1)
    machine = MjcfMachine("two", [MjcfJoint("a"), MjcfJoint("b")])
    noise = 1e-6 * np.random.default_rng(0).standard_normal(q.shape)
    good, bad = (run_of_signals(t, {"q": q + noise, "v": x}, "run") for x in (v, np.rad2deg(v)))
    assert suspected_mistake(machine, good) is None
    assert suspected_mistake(machine, bad).text == "is v in degrees, not rad"
    with pytest.raises(
        ParameterError, match=r"run: is v in degrees, not rad\? At port velocity"
    ):
        require_as_logged(machine, [good, bad])


@pytest.mark.slow
def test_a_joint_of_six_that_rubs_is_not_in_another_unit():
    """Six torques are no wrench: one that is small beside the others is looked at like them."""
    arm = get_arm("puma560-wrist")
    nominal = System(arm=arm)
    machine = nominal.replace(effects=(JointCoulomb(torque=(0.0, 0.0, 3.0, 0.0, 0.0, 0.0)),))
    motion = Motion.straight(np.zeros(6), (0.6, 0.3, 0.3, 0.2, 0.4, 0.5), duration=4.0)
    log = play_motions(machine, [motion], settle=1.0, record_dt=5e-3).log(0)
    log = dataclasses.replace(log, meta={**log.meta, "system": nominal.to_dict()})
    assert asked(log) is None
    milli = dataclasses.replace(log, tau=log.tau * np.array([1, 1, 1e3, 1, 1, 1]))
    assert asked(milli) == "is tau_3 in N mm, not N m"
