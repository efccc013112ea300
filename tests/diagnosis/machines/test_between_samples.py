"""What swings between the samples of a log is no disagreement, nor does it hide one."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.machines.between_samples import _driven, between_samples
from ves_gym.diagnosis.machines.platform_response import Platforms
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import SensorLag
from ves_gym.hardware.leg_servo import FILTERED, Legs, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.blocks.block import LoopShape
from ves_gym.simulation.blocks.platform import LegSensors, LegServos, PosePlatform
from ves_gym.simulation.blocks.wiring import Wiring
from ves_gym.simulation.playback import play_motions
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

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

    motions = excitation_motions(1, system.arm, duration=5.0, seed=1)
    lacking = system.replace(effects=effects)
    recording = play_motions(lacking, motions, settle=1.0, platform=swing)
    return system, run_of(recording.log(0), "run")


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
    window = run.window

    def rms(x):
        return np.sqrt(np.mean(np.abs(window.spectrum(x)) ** 2, axis=0))

    left = rms(residuals["wrench"][0])
    swing = rms(hidden.reading(system.emulator_settings.sensor.cutoff))
    assert swing[:3].max() > seen  # N
    assert (left < machine.floor(run, "wrench")).all()
    assert left[:3].max() < 0.05 * swing[:3].max()
    for port in ("joint", "servo"):
        assert (rms(residuals[port][0]) < machine.floor(run, port)).all(), port


def test_it_is_read_through_the_filter_that_the_sensor_has():
    """A filter five times as fast as described lets more of the swing through."""
    faster = SensorLag(error=4.0)
    system, run = swung(FILTERED, CLOCK, (faster,))
    machine = SystemMachine(system)
    model = machine.model([faster])
    left = machine.residuals(run, [model], ["wrench"])["wrench"][0]
    left = np.sqrt(np.mean(np.abs(run.window.spectrum(left)) ** 2, axis=0))
    assert (left < machine.floor(run, "wrench")).all()


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


@pytest.mark.parametrize("platform", [FILTERED, PoseServo()], ids=["legs", "pose"])
def test_compiled_platforms_are_the_blocks(platform):
    clock = CLOCK if platform is FILTERED else (12.5e-3, 1.25e-3)
    system = System(
        vehicle=BENT_THESIS,
        mode="emulated",
        emulator=EmulatorSettings(platform=platform),
        control_dt=clock[0],
        physics_dt=clock[1],
    )
    rng = np.random.default_rng(0)
    y, yd = 1e-2 * rng.standard_normal((2, 3, 6))
    p = LoopParameters.nominal(system.arm, system.emulator_settings, 3)
    platforms = Platforms(system, p, y, yd)
    if platform is FILTERED:
        legs = Legs(platform, system.emulator_settings.stewart, *clock)
        first, others = LegServos(legs), [LegSensors(legs)]
    else:
        shape = LoopShape(system.substeps + 1, system.arm.n, *clock)
        first, others = PosePlatform(platform, shape), []
    wiring = Wiring([first, *others], [], ["command_received"])
    numbers = {b.name: b.parameters(p, SimpleNamespace()) for b in wiring.blocks}
    x = {f"platform.{k}": v for k, v in first.start({}, {"X": np.c_[y, yd]})[0].items()}
    for _ in range(20):
        command = np.concatenate([y, 0 * yd], axis=1) + 3e-3 * rng.standard_normal((3, 12))
        x, signals = wiring.run(wiring.before, numbers, x, {"command_received": command})
        for name, values in platforms.advance(command).items():
            size = np.abs(signals[name]).max()
            np.testing.assert_allclose(values, signals[name], rtol=0, atol=1e-9 * max(1, size))
