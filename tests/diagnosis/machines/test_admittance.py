"""The port of the admittance: the loop's own computation, forwards or backwards."""

import dataclasses

import numpy as np
import pytest

import ves_gym.effects as E
from ves_gym.diagnosis.data.measured_run import run_of
from ves_gym.diagnosis.machines.ringing import loop_rings
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.hardware.force_sensor import ForceSensor
from ves_gym.hardware.leg_servo import FILTERED, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS, JointServo
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    STRAIGHT_VERTICAL,
    STRAIGHT_VERTICAL_THESIS,
    Oscillator,
)
from ves_gym.simulation.playback import play_motions
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

pytestmark = pytest.mark.filterwarnings(
    "ignore::ves_gym.simulation.loop_linearisation.EmulationWarning"
)
SHAKEN = dataclasses.replace(
    DECOUPLED,
    extra=(Oscillator(mass=40.0, stiffness=3600.0, damping=10.0, direction=(0.6, 0.0, 0.8)),),
)
DRAGGED = dataclasses.replace(DECOUPLED, drag=(200.0,) * 6)


def lab(compensated=True, clock=(12.5e-3, 1.25e-3), effects=(), **changes):
    vehicle = changes.pop("vehicle", None)
    system = System(
        vehicle=BENT_THESIS,
        mode="emulated",
        control_dt=clock[0],
        physics_dt=clock[1],
        effects=tuple(effects),
        emulator=EmulatorSettings(payload_compensation=compensated, **changes),
    )
    return system if vehicle is None else system.replace(vehicle=vehicle)


FAST = {"platform": PoseServo(bandwidth=10.0), "sensor": ForceSensor(cutoff=40.0)}
NOISY = (*E.LABORATORY_ERRORS, E.PlatformBandwidth(error=-0.2), E.SensorLag(error=0.2))
MACHINES = {
    "bent-thesis": lab(),
    "bent, errors": lab(effects=NOISY),
    "bent, as read": lab(compensated=False),
    "straight": lab(vehicle=STRAIGHT_VERTICAL_THESIS),  # with modes too stiff for its commands
    "oscillators": lab(vehicle=SHAKEN),
    "drag": lab(vehicle=DRAGGED),
    "satellite": lab(vehicle=FREE_FLOATING),
    "satellite, as read": lab(compensated=False, vehicle=FREE_FLOATING),
    "legs": lab(platform=FILTERED, clock=leg_clock(FILTERED)),
    "weight and all": lab(operation="admittance"),
    "no delay": lab(delay=0),
    "two periods": lab(delay=2),
    "lengths only": lab(platform=PoseServo(rate_feedforward=False)),
    "prescribed": lab().replace(drive="prescribed"),
}
SHOWN = {
    "stiffness": E.BaseStiffness(error=0.1),
    "damping": E.BaseDamping(error=1.0),
    "mass": E.BaseVirtualMass(error=0.1),
    "drag": E.BaseAmplitudeDamping(coefficient=(500.0,) * 6),
    "mode": E.BaseExtraMode(mass=20.0, frequency=2.0),
    "inertia": E.PayloadInertia(error=0.1),
}


def recorded(system, record_dt=None, duration=1.5):
    motion = Motion.straight(np.array([0, -0.2, 0.1]), [0.8, 0.5, -0.6], duration=duration)
    return play_motions(system, [motion], settle=1.0, record_dt=record_dt).log(0)


def gap(system, run, effects=()):
    """Residual at the port over the reading's movement, the ends left out."""
    machine = SystemMachine(system)
    x = machine.residuals(run, [machine.model(effects)], ["admittance"])["admittance"][0]
    skip = run.window.skip
    return np.abs(x[skip:-skip]).max() / np.ptp(run["w"], axis=0).max()


LONGER = ("bent, errors", "satellite, as read", "weight and all", "two periods", "prescribed")


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.slow) if k in LONGER else k for k in MACHINES]
)
def test_a_machine_as_described_leaves_rounding(name):
    """Tolerance: y_cmd rounds at 1e-17 m, and two differences over 12.5 ms make 1e-13 m/s^2."""
    system = MACHINES[name]
    assert gap(system, run_of(recorded(system), "run")) < 1e-9


@pytest.mark.parametrize(  # as read, nothing has a model of the arm
    ("name", "compensated"),
    [*((k, True) for k in SHOWN), ("stiffness", False), ("mode", False)],
)
def test_an_effect_shows_and_a_model_with_it_is_silent(name, compensated):
    system, effect = lab(compensated, vehicle=DECOUPLED), SHOWN[name]
    run = run_of(recorded(system.replace(effects=(effect,))), "run")
    before, after = gap(system, run), gap(system, run, [effect])
    assert before > 1e-4 and after < 1e-2 * before


def test_many_models_at_once_are_each_of_them():
    system = lab(vehicle=DECOUPLED)
    machine, run = SystemMachine(system), run_of(recorded(system), "run")
    models = [machine.nominal, *(machine.model([e]) for e in SHOWN.values())]
    together = machine.residuals(run, models, ["admittance"])["admittance"]
    for model, x in zip(models, together, strict=True):
        alone = machine.residuals(run, [model], ["admittance"])["admittance"][0]
        np.testing.assert_allclose(x, alone, rtol=0, atol=1e-9)


@pytest.mark.parametrize("compensated", [True, False])
def test_a_log_that_begins_in_the_middle_needs_no_start(compensated):
    """What joints and filters did before is forgotten at the rate of the joint servo."""
    system = lab(compensated, vehicle=DECOUPLED)
    log = recorded(system).slice(0.5, 10.0)
    assert gap(system, run_of(log, "run")) < 3e-3


@pytest.mark.parametrize("compensated", [True, False])
def test_a_log_of_every_second_period_is_filled_in(compensated):
    system = lab(compensated, clock=(5e-3, 1.25e-3), **FAST)
    run = run_of(recorded(system, record_dt=1e-2), "run")
    assert run.dt == pytest.approx(1e-2)
    assert gap(system, run) < 3e-3


def test_a_loop_rings_at_its_own_modes_alone():
    gains, home = JointServo(kp=HIGH_GAINS.kp, kd=HIGH_GAINS.kd), [np.zeros(3)]
    straight = lab(vehicle=STRAIGHT_VERTICAL_THESIS)
    assert loop_rings(straight, gains, home, 25.8)  # `transition` says 25.84 Hz
    assert not loop_rings(straight, gains, home, 20.0)
    assert not loop_rings(lab(), gains, home, 25.8)
    assert not loop_rings(lab(operation="position"), gains, home, 25.8)
    assert not loop_rings(System(vehicle=BENT_THESIS), gains, home, 25.8)
    tube = System(vehicle=STRAIGHT_VERTICAL)  # in space, of finite elements
    assert loop_rings(tube, gains, home, 26.7)  # `in_space` says 26.60 and 26.82 Hz
    assert not loop_rings(tube, gains, home, 30.0)
    assert not loop_rings(tube, None, home, 30.0)
