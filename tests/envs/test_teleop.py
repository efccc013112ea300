"""Keys move the arm, the base answers, and a script does the same every time."""

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import LABORATORY_ERRORS
from ves_gym.effects.sensor import SensorBias
from ves_gym.envs.teleop import SPEEDS, Press, Teleop, read_script
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.system.system import System

START = np.deg2rad([0.0, 60.0, -90.0])
SWING = [Press(0.1, "q", 0.8), Press(0.5, "d", 0.5), Press(1.1, "a", 0.5)]
LABORATORY = System(vehicle=BENT_THESIS, mode="emulated", effects=LABORATORY_ERRORS)


def driven(script, seconds=2.0, system=None, **options):
    teleop = Teleop(system or System(vehicle=BENT_THESIS), start=START, record=True, **options)
    teleop.play(script, seconds)
    return teleop


# ------------------------------------------------------------------------------ motion


@pytest.mark.parametrize(("key", "joint", "way"), [("q", 0, 1), ("s", 1, -1), ("e", 2, 1)])
def test_a_key_moves_its_joint_while_it_is_held(key, joint, way):
    log = driven([Press(0.2, key, 1.0)]).log()
    arm = System(vehicle=BENT_THESIS).arm
    speed = way * SPEEDS[3] * arm.column("v_max")[joint]
    rate = log.v_cmd[:, joint]
    held = (log.t > 0.5) & (log.t < 1.15)
    np.testing.assert_allclose(rate[held], speed, rtol=1e-9)
    assert rate[(log.t < 0.19) | (log.t > 1.5)] == pytest.approx(0, abs=1e-12)
    others = np.arange(3) != joint
    assert np.abs(log.v_cmd[:, others]).max() == 0
    # the time that the ramps up and down take cancels
    assert log.q_cmd[-1, joint] - START[joint] == pytest.approx(speed * 1.0, abs=0.02)
    assert np.abs(log.q - log.q_cmd).max() < np.deg2rad(0.5)


def test_speed_goes_in_steps_with_an_end():
    teleop = Teleop(System(vehicle=BENT_THESIS))
    for _ in range(20):
        teleop.press("-")
    assert teleop.pace == 0 and "speed 2 %" in teleop.readings()[0]
    for _ in range(20):
        teleop.press("=")
    assert SPEEDS[teleop.pace] == 1.0


def test_the_reference_stays_within_rates_accelerations_and_limits():
    """Every joint at full speed into its limit, and back."""
    arm = System(vehicle=BENT_THESIS).arm
    keys = [Press(0.0, "+") for _ in range(9)]
    keys += [Press(0.1, key, 6.0) for key in "qwe"] + [Press(6.1, key, 6.0) for key in "asd"]
    log = driven(keys, 12.5).log()
    assert (np.abs(log.v_cmd) <= arm.column("v_max") * (1 + 1e-9)).all()
    change = np.abs(np.diff(log.v_cmd, axis=0)) / System(vehicle=BENT_THESIS).control_dt
    assert (change <= 0.2 * arm.column("a_max") * (1 + 1e-6)).all()
    assert (log.q_cmd <= arm.column("q_max")).all() and (log.q_cmd >= arm.column("q_min")).all()
    np.testing.assert_allclose(log.q_cmd.max(axis=0), arm.column("q_max"), atol=0.02)
    np.testing.assert_allclose(log.q_cmd.min(axis=0), arm.column("q_min"), atol=0.02)


# -------------------------------------------------------------------------------- base


def test_zeroing_takes_the_sensors_offset_out():
    """App. E steps 9 and 10: measured and estimated wrench then agree."""
    bias = SensorBias(force=(5.0, -3.0, 8.0), moment=(1.0, 2.0, -1.0))
    teleop = Teleop(System(vehicle=BENT_THESIS, mode="emulated", effects=(bias,)), start=START)
    gap = teleop.batch.sim.readings.wrench - teleop.batch.sim.readings.gravity
    assert np.abs(gap).max() > 1
    teleop.press("z")
    now = teleop.batch.sim.readings
    np.testing.assert_allclose(now.wrench, now.gravity, atol=1e-6)
    measured, estimated = teleop.readings()[1:3]
    assert measured.split()[1:] == estimated.split()[1:]


def test_the_panic_button_freezes_until_the_start():
    teleop = Teleop(System(vehicle=BENT_THESIS, mode="emulated"), start=START, record=True)
    teleop.play([*SWING, Press(1.0, "p")], 2.0)
    (event,) = teleop.batch.sim.events
    assert event.reason == "panic button" and event.time == pytest.approx(1.0)
    assert "panic button" in teleop.readings()[-1]
    log = teleop.log()
    rest = log.t > 1.3  # the platform's servo has come to rest
    assert np.ptp(log.y[rest], axis=0).max() < 1e-4 < np.ptp(log.y[~rest], axis=0).max()
    assert log.meta["events"] == [{"time": event.time, "reason": "panic button"}]
    teleop.press("x")
    assert teleop.batch.sim.events == []
    np.testing.assert_array_equal(teleop.batch.scene.q[0], START)
    teleop.play([Press(0.0, "q", 0.5)], 1.0)
    assert np.abs(teleop.batch.scene.y).max() > 1e-4
    assert teleop.log().t[0] == 0  # the record began again, too


# ------------------------------------------------------------------------------ scripts


def test_a_script_does_the_same_every_time():
    """Sensor noise and drift included; another seed draws others."""
    first, again = (driven(SWING, 1.0, LABORATORY, seed=3).log() for _ in range(2))
    assert first.digest == again.digest
    assert driven(SWING, 1.0, LABORATORY, seed=4).log().digest != first.digest


def test_lines_of_a_script():
    lines = ["# swing", "", "0.5 q 1.5  # for a while", "1 +", "2 = 0.3"]
    script = read_script(lines, ["q", "+"], "keys.txt")
    assert script == [Press(0.5, "q", 1.5), Press(1.0, "+"), Press(2.0, "=", 0.3)]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("q 0.5", "keys.txt, line 2: expected TIME KEY"),
        ("0.5", "keys.txt, line 2: expected TIME KEY"),
        ("0.5 q 1 1", "TIME KEY"),
        ("-1 q", "TIME KEY"),
        ("nan q", "TIME KEY"),
        ("1 q 0", "TIME KEY"),
        ("1 Q", "key must be one of q a, got 'Q'"),
    ],
)
def test_bad_lines_are_named(line, expected):
    with pytest.raises(ParameterError) as error:
        read_script(["0 q", line], ["q", "a"], "keys.txt")
    assert expected in str(error.value)


def test_what_cannot_be_driven_is_refused():
    with pytest.raises(ParameterError, match="joint 2 must be within"):
        Teleop(System(vehicle=BENT_THESIS), start=np.deg2rad([0, 120, 0]))
    with pytest.raises(ParameterError, match="nothing was recorded"):
        Teleop(System(vehicle=BENT_THESIS)).log()
