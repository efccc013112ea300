"""Mistakes in logs are asked about, each by its name; physics is not."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis import thesis_laboratory as lab
from tests.diagnosis.logs import recorded, with_noise
from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.data.measured_run import run_of_signals
from ves_gym.diagnosis.data.sanity_checks import (
    require_as_logged,
    suspected_mistake,
)
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inputs import _heavier, system_inputs
from ves_gym.diagnosis.machines.joint_library import MjcfJoint
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.mjcf_mapping import machine_of
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
    """What is asked before a diagnosis begins, if anything."""
    try:
        inputs = system_inputs(log if isinstance(log, list) else [log], final=0)
        require_as_logged(inputs.machine, inputs.runs, inputs.mistakes)
    except ParameterError as error:
        return str(error)
    return None


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


def stated(log, system, noise):
    """The log with noise in every signal, which it states, and the system described."""
    noisy = with_noise(log, noise, np.random.default_rng(0))
    return dataclasses.replace(noisy, meta={**noisy.meta, "system": system.to_dict()})


@pytest.fixture(scope="module")
def machines():
    """Runs of 7 s in space and in the laboratory, nothing missing."""
    motions = excitation_motions(1, duration=6.0, seed=1)
    noise = {"q": 1e-5, "v": 2e-4, "tau": 0.1, "y": 5e-5, "w": 0.3}
    space = stated(play_motions(System(), motions, settle=1.0).log(0), System(), noise)
    (on_earth,) = recorded(lab.SYSTEM, seed=3, duration=6.0, settle=1.0)
    return {"space": space, "lab": stated(on_earth, lab.SYSTEM, lab.STD)}


def put(log, **fields):
    return dataclasses.replace(log, **{k: change(log) for k, change in fields.items()})


def dead(key, i):
    def still(log):
        out = getattr(log, key).copy()
        out[:, i] = out[0, i]
        return out

    return still


def every(log, count):
    values = {f.name: getattr(log, f.name) for f in dataclasses.fields(log)}
    thin = {k: v[::count] for k, v in values.items() if np.shape(v)[:1] == log.t.shape}
    return dataclasses.replace(log, **thin)


def heavier(log, factor):
    arm = _heavier(System.from_dict(log.meta["system"]).arm, factor)
    system = System.from_dict(log.meta["system"]).replace(arm=arm)
    return dataclasses.replace(log, meta={**log.meta, "system": system.to_dict()})


def wrapped(log):
    turn = log.q + np.array([np.pi - log.q[len(log.t) // 2, 0], 0.0, 0.0])
    return (turn + np.pi) % (2 * np.pi) - np.pi


DEGREES, W = 180 / np.pi, ["w", "wg"]
MISTAKES = {  # what was done to a log -> what must be asked
    "space": {
        "joints late": (lambda k: late(k, ["q", "v"], 0.1), "is q 100 ms late"),
        "torques late": (lambda k: late(k, ["tau"], 0.1), "is tau 100 ms late"),
        "tracker late": (lambda k: late(k, ["y", "yd"], 0.1), "is y 100 ms late"),
        "amplifier late": (lambda k: late(k, ["w"], 0.1), "is w 100 ms late"),
        "torques exchanged": (
            lambda k: changed(k, ["tau"], swap(3, 0, 1)), "is tau_1 exchanged with tau_2"
        ),
        "forces exchanged": (
            lambda k: changed(k, ["w"], swap(6, 0, 1)), "is w F_x exchanged with w F_y"
        ),
        "forces and moments": (
            lambda k: changed(k, ["w"], np.eye(6)[[3, 4, 5, 0, 1, 2]]),
            "are forces and moments of w exchanged",
        ),
        "angle's sign": (
            lambda k: changed(k, ["q", "v"], flip(3, 1)), "has q_2 the other sign"
        ),
        "joint's sign": (lambda k: changed(k, JOINT, flip(3, 2)), "has joint 3 the other sign"),
        "moment's sign": (
            lambda k: changed(k, ["w"], flip(6, 5)), "has w M_z the other sign"
        ),
        "degrees": (
            lambda k: changed(k, ["q", "v"], DEGREES * np.eye(3)), "is it in degrees"
        ),
        "millimetres": (
            lambda k: changed(k, ["y"], factor(6, range(3), 1e3)), "is it in millimetres"
        ),
        "attitude in degrees": (
            lambda k: changed(k, ["y"], factor(6, range(3, 6), DEGREES)),
            "are the angles in y in degrees, not rad",
        ),
        "rates in degrees": (
            lambda k: changed(k, ["v"], DEGREES * np.eye(3)), "is v in degrees, not rad"
        ),
        "torque in N mm": (
            lambda k: changed(k, ["tau"], 1e3 * np.eye(3)), "is tau in N mm, not N m"
        ),
        "forces in kgf": (
            lambda k: changed(k, ["w"], factor(6, range(3), 1 / 9.80665)),
            "are the forces in w in kgf, not N",
        ),
        "a clock in ms": (lambda k: put(k, t=lambda x: 1e3 * x.t), "is the clock in ms"),
        "a gap": (
            lambda k: put(k, t=lambda x: x.t + (x.t > 3.0)), "cut the log at the gap"
        ),
        "one second": (lambda k: beginning(k, 1.0), "is too short, need 1.25 s"),
        "slow samples": (lambda k: every(k, 4), "needs at least 48 Hz"),
        "a dead cable": (lambda k: put(k, w=dead("w", 0)), "is w F_x dead"),
        "a dead encoder": (lambda k: put(k, q=dead("q", 1)), "is q_2 dead"),
        "a wrapped angle": (lambda k: put(k, q=wrapped), "jumps by 6.28 rad; is it wrapped"),
        "grams": (lambda k: heavier(k, 1e3), "are masses and inertias described in g"),
        "one file twice": (lambda k: [k, k], "log 2: is log 1 again"),
    },
    "lab": {
        "tracker late": (lambda k: late(k, ["y", "yd"], 0.1), "is y 100 ms late"),
        "command late": (lambda k: late(k, ["y_cmd"], 0.1), "is y_cmd 100 ms late"),
        "joints late": (lambda k: late(k, ["q", "v"], 0.1), "is q (95|100) ms late"),
        "torques late": (lambda k: late(k, ["tau"], 0.1), "is tau 100 ms late"),
        "amplifier late": (lambda k: late(k, W, 0.1), "is w 100 ms late"),
        "angles for commands": (
            lambda k: put(k, q=lambda x: x.q_cmd, q_cmd=lambda x: x.q,
                          v=lambda x: x.v_cmd, v_cmd=lambda x: x.v),
            "are q and q_cmd exchanged",
        ),
        "moment's sign": (
            lambda k: changed(k, W, flip(6, 5)), "has w and wg M_z the other sign"
        ),
        "kgf": (
            lambda k: changed(k, W, factor(6, range(3), 1 / 9.80665)), "in w and wg in kgf"
        ),
        "grams": (lambda k: heavier(k, 1e3), "are masses and inertias described in g"),
    },
}  # fmt: skip
TABLE = [
    pytest.param(machine, change, text, id=f"{machine}: {what}",
                 marks=[pytest.mark.slow] if machine == "lab" else [])
    for machine, kinds in MISTAKES.items()
    for what, (change, text) in kinds.items()
]  # fmt: skip


@pytest.mark.parametrize(("machine", "change", "text"), TABLE)
def test_a_mistake_in_a_log_is_asked_about(machines, machine, change, text):
    """Through the noise of a pose that is differentiated twice, larger than its own signal."""
    assert re.search(text, asked(change(machines[machine])) or "")


@pytest.mark.parametrize("machine", MISTAKES)
def test_a_log_as_it_is_is_not_questioned(machines, machine):
    """Nor one with what an effect does: a recorder that is late by 10 ms, a joint that rubs."""
    log = machines[machine]
    assert asked(log) is None
    assert asked(late(log, ["q", "v"], 0.0125)) is None
    assert asked(late(log, ["y"], 0.0125)) is None


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


def test_a_rate_in_degrees_is_asked_about():
    """A machine without a model: the rate logged against that of the position logged."""
    t = np.arange(3000) * 5e-3
    q = np.stack([np.sin(t), np.cos(1.7 * t)], axis=1)
    v = np.stack([np.cos(t), -1.7 * np.sin(1.7 * t)], axis=1)
    machine = MjcfMachine("two", [MjcfJoint("a"), MjcfJoint("b")])
    noise = 1e-6 * np.random.default_rng(0).standard_normal(q.shape)
    good, bad = (run_of_signals(t, {"q": q + noise, "v": x}, "run") for x in (v, np.rad2deg(v)))
    assert suspected_mistake(machine, good) is None
    either = "is q, without its rate, in rad twice converted from degrees"
    assert suspected_mistake(machine, bad).text == f"is v in degrees, not rad, or {either}"
    with pytest.raises(ParameterError, match=rf"run: is v .*, or {either}\? At port velocity"):
        require_as_logged(machine, [good, bad])


@pytest.fixture
def mapped():
    """A run of one joint whose file has names of its own, and units as asked."""
    t = np.arange(3000) * 5e-3

    def run(clock=1.0, band=12.0, seconds=15.0, **units):
        table = {"schema": "ves-machine/1", "name": "one", "band": band, "joint": [{
            "name": "a", "position": {"column": "A1_pos"}, "velocity": {"column": "A1_vel"},
        }], "time": {"column": "stamp", "gain": clock}}  # fmt: skip
        file, machine = machine_of(table, Path("map.toml"))
        noise = 1e-6 * np.random.default_rng(0).standard_normal(t.shape)
        pos, vel = units.get("pos", 1.0) * np.sin(t) + noise, units.get("vel", 1.0) * np.cos(t)
        columns = {"stamp": t, "A1_pos": pos, "A1_vel": vel}
        return machine, file.run({k: x[t < seconds] for k, x in columns.items()}, "run")

    return run


def test_a_question_names_the_column_of_the_file(mapped):
    """And both of two that explain as well: without a model no log tells them apart."""
    machine, run = mapped(pos=180 / np.pi, vel=180 / np.pi)
    assert suspected_mistake(machine, run) is None
    machine, run = mapped(vel=180 / np.pi)
    asked = "run: is v (A1_vel) in degrees, not rad, or is q (A1_pos), without its rate, in rad"
    assert suspected_mistake(machine, run).sentence.startswith(asked)


@pytest.mark.parametrize(
    ("read", "said"),
    [
        ({"clock": 1e-3}, "need 1.25 s; is the clock in s, read as ms?"),
        ({"seconds": 1.0}, "0.995 s is too short, need 1.25 s$"),
        ({"band": 500.0}, "at least 2000 Hz: take a band up to 50 Hz, or is the clock in ms?"),
        ({"clock": 10.0}, "at least 48 Hz: take a band up to 5 Hz, or is the clock in ms?"),
    ],
)
def test_a_clock_or_a_band_that_does_not_fit_is_asked_about(mapped, read, said):
    with pytest.raises(ParameterError, match=said.replace("?", r"\?")):
        mapped(**read)


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
    assert "is tau_3 in N mm, not N m" in asked(milli)
