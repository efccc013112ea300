"""Every port is silent on the simulator's own logs, and speaks of its own effects only.

What swings between samples is no disagreement, nor does it hide one; nor is a drift that is
described, which may take any course, in every run its own.
"""

import dataclasses

import numpy as np
import pytest
import scipy

import ves_gym.effects as E
from tests.diagnosis.logs import recorded
from tests.running_blocks import pose_platform
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.between_samples import _driven, between_samples
from ves_gym.diagnosis.machines.drift import courses
from ves_gym.diagnosis.machines.platform import platform_gap
from ves_gym.diagnosis.machines.platform_response import platform_response
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import SensorLag
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.leg_servo import FILTERED, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

LAB = EmulatorSettings(
    platform=PoseServo(bandwidth=10.0),
    sensor=ForceSensor(cutoff=40.0),
    payload_compensation=False,
    joint_balance=False,
)
IDEAL = System(vehicle=BENT_THESIS, control_dt=5e-3)
EMULATED = System(vehicle=BENT_THESIS, mode="emulated", control_dt=5e-3, emulator=LAB)
SIGNALS = {
    "joint": "tau", "servo": "tau", "wrench": "w", "gravity": "weight", "admittance": "w",
    "platform": "y", "base": "w", "velocity": "v",
}  # fmt: skip
# each shows at its own ports and nowhere else
SHOWN = {
    ("joint",): E.JointCoulomb(torque=(0.0, 5.0, 0.0)),
    ("joint", "wrench"): E.PayloadMass(mass=2.0),
    ("servo", "velocity", "joint"): E.JointVelocityLag(time_constant=(0.0, 0.02, 0.0)),
    ("wrench",): E.SensorBias(force=(5.0, 0.0, 0.0)),
    ("gravity",): E.GravityMass(error=2.0),
    ("admittance",): E.BaseStiffness(error=0.1),
    ("platform",): E.PlatformBandwidth(error=-0.3),
}


def played(system, effects=()):
    motion = Motion.straight(np.array([0, -0.2, 0.1]), [0.8, 0.5, -0.6], duration=1.5)
    recording = play_motions(system.replace(effects=tuple(effects)), [motion], settle=2.0)
    return run_of(recording.log(0), "run")


def shares(system, run):
    """Port -> RMS of the residual over that of the signal's movement, band and edges alike."""
    machine = SystemMachine(system)
    names = [p.name for p in machine.ports]
    found = machine.residuals(run, [machine.nominal], names)
    out = {}
    for name in names:
        x = run.window.spectrum(found[name][0])
        seen = run[SIGNALS[name]]
        size = np.abs(run.window.spectrum(seen - seen.mean(axis=0))).max(axis=0)
        out[name] = np.abs(x).max() / size.max()
    return out


def left_of(machine, run, model, port):
    """What a model leaves at a port, over what the description leaves."""
    both = machine.residuals(run, [machine.nominal, model], [port])[port]
    gap, left = (np.abs(run.window.spectrum(x)).max() for x in both)
    return left / gap


@pytest.fixture(scope="module")
def healthy():
    return {s.mode: shares(s, played(s)) for s in (IDEAL, EMULATED)}


@pytest.mark.parametrize("mode", ["ideal", "emulated"])
def test_ports_are_silent_on_a_machine_as_described(healthy, mode):
    assert max(healthy[mode].values()) < 3e-3, healthy[mode]


@pytest.mark.parametrize("ports", SHOWN, ids=["+".join(p) for p in SHOWN])
def test_an_effect_shows_at_its_own_ports_and_a_model_with_it_is_silent(healthy, ports):
    run, machine = played(EMULATED, [SHOWN[ports]]), SystemMachine(EMULATED)
    model, found = machine.model([SHOWN[ports]]), shares(EMULATED, run)
    for port in ports:
        assert left_of(machine, run, model, port) < 0.1, port
    for port, share in found.items():
        if port in ports:
            assert share > 10 * healthy["emulated"][port], port
        else:  # a platform 30 % slower moves otherwise between samples too: 2.1e-4 at wrench
            assert share < 3 * healthy["emulated"][port] + 2e-4, port


@pytest.mark.parametrize(
    "effect",
    [
        E.PayloadMass(mass=2.0),
        E.PayloadCom(offset=(0.05, 0.02, 0.03)),
        E.JointElasticity(compliance=(1e-4,) * 3, damping=(20.0,) * 3),
    ],
    ids=lambda e: e.kind,
)
def test_weight_carried_outside_the_motors_is_that_of_the_arm_as_it_is(effect):
    """Claim: with `joint_balance` a model with the effect is silent (docs/physics.md 9).

    Balanced by the arm as described, a payload of 2 kg left 16 N m. Tolerance: a fifth, for
    gears, whose port leaves a tenth of the gap without weight, too.
    """
    balanced = EMULATED.replace(emulator=dataclasses.replace(LAB, joint_balance=True))
    run, machine = played(balanced, [effect]), SystemMachine(balanced)
    assert left_of(machine, run, machine.model([effect]), "joint") < 0.2


def test_legs_lead_where_a_log_says_that_the_platform_was():
    """Where it stands, not what bending rods read: 1e-6 m here, 0.5 % at 2.4 Hz."""
    clock = dict(zip(("control_dt", "physics_dt"), leg_clock(FILTERED), strict=True))
    lab = EmulatorSettings(platform=FILTERED)
    system = System(vehicle=BENT_THESIS, mode="emulated", emulator=lab, **clock)
    run = played(system)
    gap = platform_gap(run, [system], system)
    assert np.abs(gap).max() < 1e-12 * np.abs(run["y"]).max()


@pytest.mark.parametrize(("ratio", "feedforward"), [(0.5, True), (1.0, False), (1.4, True)])
def test_a_whole_history_of_poses_is_that_of_its_periods(ratio, feedforward):
    rng = np.random.default_rng(0)
    servo = PoseServo(bandwidth=10.0, damping_ratio=ratio, rate_feedforward=feedforward)
    system = System(
        vehicle=BENT_THESIS, mode="emulated", emulator=EmulatorSettings(platform=servo)
    )
    p = LoopParameters.nominal(system.arm, system.emulator_settings, 2)
    y, yd = rng.standard_normal((2, 2, 6))
    command = rng.standard_normal((2, 60, 12))
    at_once = platform_response(system, p, command, y, yd)
    platform = pose_platform(servo, 2, np.arange(system.substeps + 1) * system.physics_dt)
    platform.reset(np.arange(2), y, yd)
    for k in range(1, 60):
        platform.advance(command[:, k, :6], command[:, k, 6:])
        np.testing.assert_allclose(at_once[:, k], platform.measured(), rtol=0, atol=1e-9)


CLOCK = leg_clock(FILTERED)


def swung(platform, clock=(12.5e-3, 1.25e-3), effects=()):
    """A system under position control, and the log of a platform that moves to and fro."""
    system = System(
        vehicle=BENT_THESIS,
        mode="emulated",
        emulator=EmulatorSettings(operation="position", platform=platform),
        control_dt=clock[0],
        physics_dt=clock[1],
    )
    size, w = np.array([0.01, 0.02, 0.01, 0.02, 0.01, 0.02]), 2 * np.pi * 0.4

    def swing(t):
        return np.outer(1 - np.cos(w * t), size), w * np.outer(np.sin(w * t), size)

    lacking = system.replace(effects=effects)
    (log,) = recorded(lacking, 1, described=system, duration=5.0, platform=swing)
    return system, run_of(log, "run")


def rms(run, x):
    """Of a signal over the band of a run."""
    return np.sqrt(np.mean(np.abs(run.window.spectrum(x)) ** 2, axis=0))


@pytest.mark.parametrize(
    ("platform", "clock", "seen"),
    [(FILTERED, CLOCK, 0.3), (PoseServo(rate_feedforward=False), (12.5e-3, 1.25e-3), 0.05)],
    ids=["legs", "pose"],
)
def test_the_swing_is_accounted_for(platform, clock, seen):
    """What is left is within the floor, 1e-3 of a signal's movement; the swing is not."""
    system, run = swung(platform, clock)
    machine = SystemMachine(system)
    hidden = between_samples(run, system)
    ports = ("joint", "servo", "wrench")
    residuals = machine.residuals(run, [machine.nominal], ports)
    left = rms(run, residuals["wrench"][0])
    swing = rms(run, hidden.reading(system.emulator_settings.sensor.cutoff))
    assert swing[:3].max() > seen  # N
    assert (left < machine.floor(run, "wrench")).all()
    assert left[:3].max() < 0.05 * swing[:3].max()
    for port in ("joint", "servo"):
        assert (rms(run, residuals[port][0]) < machine.floor(run, port)).all(), port


def test_it_is_read_through_the_filter_that_the_sensor_has():
    """A filter five times as fast as described lets more of the swing through."""
    faster = SensorLag(error=4.0)
    system, run = swung(FILTERED, CLOCK, (faster,))
    machine = SystemMachine(system)
    model = machine.model([faster])
    left = machine.residuals(run, [model], ["wrench"])["wrench"][0]
    assert (rms(run, left) < machine.floor(run, "wrench")).all()


def test_a_log_of_another_clock_says_nothing_of_it():
    motion = Motion.straight(np.zeros(3), [0.3, 0.2, -0.2], duration=1.5)
    system = System(vehicle=BENT_THESIS, mode="emulated")
    log = play_motions(system, [motion], settle=1.0, record_dt=2 * system.control_dt).log(0)
    run = run_of(log, "run", band=8.0)
    hidden = between_samples(run, system)
    assert not hidden.torque.any() and not hidden.rate.any() and not hidden.wrench.any()


def test_joints_follow_a_push_as_their_equation_says():
    rng = np.random.default_rng(0)
    inner = np.array([[3.0, 0.2], [0.2, 0.5]])
    kp, kd, h = np.array([3000.0, 900.0]), np.array([50.0, 20.0]), 1e-3
    ends = rng.standard_normal(41)[:, None] * np.ones(2)  # lines between nodes
    push = np.stack([ends[4 * k : 4 * k + 5] for k in range(10)])
    found = _driven(np.tile(inner, (10, 1, 1)), kp, kd, push, h)

    def rate(t, x):
        load = np.array([np.interp(t, h * np.arange(41), ends[:, i]) for i in range(2)])
        return np.r_[x[2:], np.linalg.solve(inner, -load - kd * x[2:] - kp * x[:2])]

    at = scipy.integrate.solve_ivp(
        rate, (0, 40 * h), np.zeros(4), rtol=1e-10, atol=1e-14, max_step=h / 4,
        t_eval=h * np.arange(1, 41),
    )  # fmt: skip
    np.testing.assert_allclose(found.x[:, -1], at.y[:2, 3::4].T, rtol=0, atol=1e-10)
    rates = found.v[:, 1:].reshape(40, 2)
    np.testing.assert_allclose(rates, at.y[2:].T, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found.v[1:, 0], found.v[:-1, -1])
    np.testing.assert_allclose(
        found.a[-1, -1], rate(40 * h, at.y[:, -1])[2:], rtol=0, atol=1e-5
    )


PLAIN = System(
    vehicle=BENT_THESIS, mode="emulated", emulator=EmulatorSettings(operation="position")
)
DRIFT = E.SensorDrift(moment=(2.0, 0.0, 0.0), time=20.0)
HISS = E.SensorNoise(force=(0.35, 0.2, 0.4), moment=(0.3, 0.3, 0.05))


@pytest.fixture(scope="module")
def runs():
    logs = recorded(PLAIN.replace(effects=(HISS, DRIFT)), 1, 2, duration=5.0)
    return [run_of(log, f"run-{i}") for i, log in enumerate(logs)]


def slowest(residuals, size):
    """Mean square of the lowest frequencies of M_x."""
    at = [(g.port, g.channel, g.low) for g in residuals.groups].index(("wrench", 3, 0.0))
    return size[at]


def test_courses_add_up_to_the_covariance(runs):
    run, std, time = runs[0], np.array([0, 0, 0, 2.0, 0, 0]), 20.0
    found = courses(run, std, time)
    assert {path.channel for path, _ in found} == {3}
    paths = np.stack([size * path.of(run) for path, size in found])
    t = run.dt * np.arange(run.length)
    for lag in (0, 100, 300):  # on the average along the run
        pairs = np.einsum("kt,kt->t", paths[:, : len(t) - lag], paths[:, lag:]).mean()
        assert pairs == pytest.approx(4 * np.exp(-run.dt * lag / time), rel=0.02)


def test_a_described_drift_is_no_disagreement(runs):
    sizes = []
    for effects in ((HISS,), (HISS, DRIFT)):
        residuals = WhitenedResiduals(SystemMachine(PLAIN.replace(effects=effects)), runs)
        sizes.append(slowest(residuals, fit(residuals, (), ()).size))
    assert sizes[0] > 1  # of noise, where the description knows of none
    assert sizes[1] < 0.1 * sizes[0]


def test_a_run_held_back_takes_a_course_of_its_own(runs):
    machine = SystemMachine(PLAIN.replace(effects=(HISS, DRIFT)))
    first, last = (WhitenedResiduals(machine, [run]) for run in reversed(runs))
    names = [k.name for k in last.nuisances[last.shared :]]
    assert "drift of M_x in run-0" in names
    assert all(name.endswith(" in run-0") for name in names)
    x = fit(first, (), ()).nuisances

    def mean_square(z):
        return slowest(last, [np.mean(z[g.part] ** 2) for g in last.groups])

    left = last.less_nuisances(last.null, x, fitted=False)
    assert mean_square(left) < 0.2 * mean_square(last.null)
    np.testing.assert_allclose(
        first.less_nuisances(first.null, x, fitted=True), first.null + first.slopes @ x
    )
