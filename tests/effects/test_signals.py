"""Effects on signals: commands and measurements that are late, legs that end too soon."""

import numpy as np
import pytest

from ves_gym.effects import (
    BaseAmplitudeDamping,
    CommandDelay,
    JointMeasurementDelay,
    PlatformDelay,
    PlatformStroke,
)
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.simulation.stability import linearise
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

POSITION = EmulatorSettings(operation="position", platform=PoseServo(bandwidth=8.0))
H = System(vehicle=BENT_THESIS).physics_dt
LIMIT = System(vehicle=BENT_THESIS).arm.column("tau_max")


def angles(system, commands):
    """Joint angles at the control period under bare torques (k + 1, 3)."""
    sim = Simulator(system, servo=None)
    per, out = system.substeps, [sim.state.q[0]]
    for j in range((len(commands) - 1) // per):
        sim.play(commands[None, j * per : (j + 1) * per + 1])
        out.append(sim.state.q[0])
    return np.array(out)


@pytest.mark.parametrize("delay", [3 * H, 3.5 * H])
def test_a_late_command_is_the_same_command_later(delay):
    """The run is that of a command shifted by hand, whole steps or not."""
    t = np.arange(81) * H

    def torque(t):
        return np.stack([5 * t, -8 * t, 3 * t], axis=-1) * (t > 0)[:, None]

    late = System(vehicle=BENT_THESIS, drive="motor", effects=(CommandDelay(delay=delay),))
    shifted = torque(np.maximum(t - delay, 0.0))
    if delay == 3.5 * H:  # linear between two steps: the kink at the start is smoothed
        shifted = (torque(np.maximum(t - 3 * H, 0)) + torque(np.maximum(t - 4 * H, 0))) / 2
        tolerance = 1e-9
    else:
        tolerance = 1e-13
    got, want = angles(late, torque(t)), angles(System(vehicle=BENT_THESIS), shifted)
    np.testing.assert_allclose(got, want, atol=tolerance)


def test_the_log_shows_the_command_sent_and_the_torque_by_what_has_arrived():
    """Motor torque is what the drives give: a machine's log has no other."""
    motion = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 1.0)
    steps = 8
    system = System(vehicle=BENT_THESIS, effects=(CommandDelay(delay=steps * H),))
    run, plain = (
        play_motions(k, [motion], settle=0.3, record_dt=H)
        for k in (system, System(vehicle=BENT_THESIS))
    )
    np.testing.assert_array_equal(run.q_cmd, plain.q_cmd)
    kp, kd = np.array(run.servo.kp), np.array(run.servo.kd)
    arrived, sent = (k.tau[0] + kp * k.q[0] + kd * k.v[0] for k in (run, plain))
    np.testing.assert_allclose(arrived[steps:], sent[:-steps], atol=1e-9)
    np.testing.assert_allclose(arrived[:steps], sent[:1] + 0 * arrived[:steps], atol=1e-9)
    # the wrench recorded is that of the motion: momentum of the base follows from it
    assert np.abs(run.w - plain.w).max() > 1.0


def test_an_old_measurement_is_that_of_then():
    delay = 4.5 * H
    system = System(vehicle=BENT_THESIS, effects=(JointMeasurementDelay(delay=delay),))
    sim = Simulator(system)
    seen, true = [], []
    for k in range(40):
        sim.play(np.full((1, 2, 3), 30.0 * np.sin(0.1 * k)))
        seen.append(sim.measured[0][0])
        true.append(sim.state.q[0])
    seen, true = np.array(seen), np.array(true)
    np.testing.assert_allclose(
        seen[5:], (true[1:-4] + true[:-5])[: len(seen) - 5] / 2, atol=1e-15
    )


def test_the_servo_acts_on_what_it_sees():
    """tau = command - kp q(t - d) - kd v(t - d), exactly, at every step."""
    sim = Simulator(
        System(vehicle=BENT_THESIS, effects=(JointMeasurementDelay(delay=3.3 * H),))
    )
    sim.reset(q=[0.0, 0.05, 0.1])
    for _ in range(30):
        sim.play(np.zeros((1, 2, 3)))
        q, v = sim.measured
        told = np.clip(-sim.servo_command(q, v), -LIMIT, LIMIT)
        np.testing.assert_allclose(sim.evaluate(0.0)[0], told, rtol=1e-12, atol=1e-12)
    assert np.abs(sim.measured[0] - sim.state.q).max() > 1e-4


def test_a_snapshot_remembers_what_is_under_way():
    system = System(
        vehicle=BENT_THESIS,
        effects=(CommandDelay(delay=0.02), JointMeasurementDelay(delay=0.005)),
    )
    sim = Simulator(system)
    for k in range(5):
        sim.step(float(k))
    kept, ends = sim.snapshot(), []
    for _ in range(2):
        sim.restore(kept)
        for k in range(5):
            sim.step(-float(k))
        ends.append(sim.state)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(*ends, strict=True))


# ------------------------------------------------------------------------ platform


def ride(effects, rate, periods=60):
    """Pose along x of a platform told to move at a steady rate [m/s], from rest at home."""
    system = System(vehicle=BENT_THESIS, mode="emulated", emulator=POSITION, effects=effects)
    sim = Simulator(system, warn_at=None)
    out = []
    for k in range(periods):
        pose = np.zeros((1, 12))
        pose[0, 0], pose[0, 6] = rate * k * system.control_dt, rate
        sim.step(sim.servo_command(np.zeros((1, 3)), np.zeros((1, 3))), platform=pose)
        out.append(sim.readings.y[0, 0])
    return np.array(out)


@pytest.mark.parametrize("delay", [0.0125, 0.03])
def test_a_late_platform_lags_by_rate_times_delay(delay):
    """Steady motion is followed without lag (rate feed-forward), but for the delay."""
    plain, late = (ride(k, 0.05) for k in ((), (PlatformDelay(delay=delay),)))
    assert plain[-1] - late[-1] == pytest.approx(0.05 * delay, rel=1e-6)


def test_a_short_stroke_stops_the_platform_silently():
    """Along x a leg stretches by the cosine it makes with it; here 0.4 m * 2 % of stroke."""
    effects = (PlatformStroke(travel=0.98),)
    system = System(vehicle=BENT_THESIS, mode="emulated", emulator=POSITION, effects=effects)
    stewart = system.emulator_settings.stewart
    x = ride(effects, 0.05, 120)[-1]
    pose = np.array([x, 0, 0, 0, 0, 0])
    stretch = np.abs(stewart.leg_lengths(pose) - stewart.home_lengths).max()
    assert stretch == pytest.approx(0.02 * 0.4, rel=0.02)
    assert x < 0.05 * 119 * system.control_dt / 2


def test_slow_legs_limit_the_rate():
    """The fastest leg moves at 2 % of what it should, once the platform has set off."""
    x = ride((PlatformStroke(speed=0.98),), 0.05, 120)
    system = System(vehicle=BENT_THESIS, mode="emulated", emulator=POSITION)
    stewart, poses = system.emulator_settings.stewart, np.zeros((120, 6))
    poses[:, 0] = x
    rate = np.abs(np.diff(stewart.leg_lengths(poses), axis=0)).max(axis=1) / system.control_dt
    np.testing.assert_allclose(rate[60:], 0.02 * stewart.speed_max, rtol=0.01)


def test_within_reach_nothing_happens():
    want = ride((), 0.05)
    np.testing.assert_array_equal(ride((PlatformStroke(travel=0.2, speed=0.2),), 0.05), want)


def test_delays_are_in_the_loop_that_is_judged():
    """The linearised loop answers a wrench as late, or as badly held, as the machine."""
    plain, push = System(mode="emulated", vehicle=DECOUPLED), [50.0, 0, 0, 0, 0, 20.0]
    want = linearise(plain).step(push, 25)
    for effect in (PlatformDelay(delay=0.0125), JointMeasurementDelay(delay=0.003)):
        got = linearise(plain.replace(effects=(effect,))).step(push, 25)
        assert np.abs(got - want).max() > 1e-5 * np.abs(want).max()
    null = (PlatformDelay(), PlatformStroke(), JointMeasurementDelay(), CommandDelay())
    np.testing.assert_array_equal(linearise(plain.replace(effects=null)).A, linearise(plain).A)


# ------------------------------------------------------------- amplitude-dependent damping


@pytest.mark.parametrize("mode", ["ideal", "emulated"])
def test_damping_grows_with_the_amplitude(mode):
    """The drag's logarithmic decrement is 8/3 c A / m: twice at twice the amplitude.

    One free mode, x of the decoupled vehicle with the arm on it. The linear damper beside it
    lets the amplitude fall within the cycle, by one factor whatever the amplitude.
    """
    c, A = 100.0, 0.05
    lost = []
    for amplitude in (A, A / 2):
        ends = []
        for effects in ((), (BaseAmplitudeDamping(coefficient=(c, 0, 0, 0, 0, 0)),)):
            system = System(mode=mode, vehicle=DECOUPLED, drive="prescribed", effects=effects)
            sim = Simulator(system, warn_at=None)
            y = np.zeros(6)
            y[0] = amplitude
            sim.reset(y=y)
            path = [amplitude]
            for _ in range(400):
                sim.step(0.0)
                path.append(sim.state.y[0, 0])
            ends.append(np.array(path))
        peaks = [path[200:].max() for path in ends]  # after a full cycle of 3.9 s
        lost.append(np.log(peaks[0]) - np.log(peaks[1]))
    assert lost[0] / lost[1] == pytest.approx(2.0, rel=0.15)


def test_drag_is_in_the_energy_account():
    effects = (BaseAmplitudeDamping(coefficient=(1e4,) * 6),)
    motion = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 1.0)
    system = System(vehicle=BENT_THESIS, effects=effects)
    run = play_motions(system, [motion], settle=0.5, record_dt=H)
    assert EnergyBalance.of(run.log(0)).relative < 1e-5
