"""Nothing is missing where a log is of the very system that describes it.

Whatever the laboratory does, on any vehicle and platform, with and without noise: a port is
the loop's own computation, so only rounding, derivatives and noise are left. The slow test
draws 200 of them. From 200 on vehicles are of finite elements or free, in space as often as
not, and some arms have seven joints.
"""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest

import ves_gym as vg
import ves_gym.effects as E
from tests.diagnosis.logs import told
from ves_gym.diagnosis.diagnose import NOTHING
from ves_gym.diagnosis.excitation import excitation_motions
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.inputs import system_inputs
from ves_gym.hardware.leg_servo import FILTERED, leg_clock
from ves_gym.hardware.platform import PoseServo
from ves_gym.mechanics.arm_library import PUMA_560, get_arm
from ves_gym.mechanics.vehicle import (
    BENT,
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    FREE_FLYING,
    STRAIGHT_HORIZONTAL,
    STRAIGHT_VERTICAL,
    STRAIGHT_VERTICAL_THESIS,
    Oscillator,
)
from ves_gym.simulation.playback import play_motions
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

SECONDS = 10.0  # of motion, and a second at rest
SHAKEN = replace(
    DECOUPLED,
    extra=(
        Oscillator(mass=40.0, stiffness=3600.0, damping=10.0, direction=(1.0, 0.0, 0.0)),
        Oscillator(mass=20.0, stiffness=7100.0, damping=2.0, direction=(0.0, 0.6, 0.8)),
    ),
)
VEHICLES = (
    BENT_THESIS,
    STRAIGHT_VERTICAL_THESIS,
    DECOUPLED,
    SHAKEN,
    FREE_FLOATING,
    FREE_FLYING,
)
WIDER = (BENT, STRAIGHT_VERTICAL, STRAIGHT_HORIZONTAL, FREE_FLOATING, FREE_FLYING)
NARROW = 200  # seeds of the thesis's arm on condensed vehicles
FRICTION = (E.JointCoulomb(torque=(3.0, 2.0, 1.0)), E.JointViscous(damping=(2.0, 2.0, 1.0)))
ERRORS = ((), FRICTION, E.LABORATORY_ERRORS, (*FRICTION, *E.LABORATORY_ERRORS))


def drawn(rng, wider=False):
    """A system, and how far apart its records are [s]."""
    vehicles = WIDER if wider else VEHICLES
    vehicle, errors = vehicles[rng.integers(len(vehicles))], ERRORS[rng.integers(len(ERRORS))]
    arm = PUMA_560
    if wider and rng.random() < 0.15:
        arm, errors = get_arm("iiwa14"), () if errors in ((), FRICTION) else E.LABORATORY_ERRORS
    if rng.random() < (0.5 if wider else 0.1):  # in space, at control period or physics step
        errors = tuple(e for e in errors if "ideal" in e.modes)
        system = System(arm=arm, vehicle=vehicle, effects=errors)
        return system, system.control_dt if rng.random() < 0.5 else system.physics_dt
    servos = PoseServo(), PoseServo(rate_feedforward=False), FILTERED
    platform = servos[rng.choice(3, p=[0.6, 0.3, 0.1])]
    clock = leg_clock(platform) if platform is FILTERED else (12.5e-3, 1.25e-3)
    emulator = EmulatorSettings(
        operation=rng.choice(
            ["microgravity", "admittance", "position"], p=[0.7, 0.15, 0.15]
        ).item(),
        platform=platform,
        payload_compensation=bool(rng.random() < 0.5),
    )
    system = System(
        mode="emulated",
        arm=arm,
        vehicle=vehicle,
        emulator=emulator,
        effects=errors,
        control_dt=clock[0],
        physics_dt=clock[1],
    )
    return system, system.control_dt


def recorded(system, record_dt, seed, count=1):
    """Logs of motions that excite all joints; none where a platform stops early."""
    motions = excitation_motions(count, system.arm, duration=SECONDS, seed=seed)
    options = {}
    if system.mode == "emulated" and system.emulator.operation == "position":
        size, w = np.array([0.01, 0.02, 0.01, 0.02, 0.01, 0.02]), 2 * np.pi * 0.4

        def swing(t):
            return np.outer(1 - np.cos(w * t), size), w * np.outer(np.sin(w * t), size)

        options["platform"] = swing
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of loops that ring
        recording = play_motions(
            system, motions, settle=1.0, record_dt=record_dt, seed=seed, **options
        )
    return [] if recording.events else [recording.log(i) for i in range(count)]


def case(seed):
    """The description of a seed and two logs; draws whose platform stops are drawn again."""
    rng = np.random.default_rng([21, seed])
    while True:
        system, record_dt = drawn(rng, seed >= NARROW)
        try:
            logs = recorded(system, record_dt, seed, count=2)
        except ArithmeticError:  # it diverged
            continue
        if logs:
            return system, *logs


def verdict(system, *logs):
    """Of logs under the system that made them."""
    return told(system, logs).verdict


QUICK = {
    "nominal": System(vehicle=BENT_THESIS, mode="emulated"),
    "friction": System(vehicle=BENT_THESIS, mode="emulated", effects=FRICTION),
    "laboratory errors": System(
        vehicle=BENT_THESIS, mode="emulated", effects=E.LABORATORY_ERRORS
    ),
    "no compensation": System(
        vehicle=BENT_THESIS,  # a loop that rings at 13.6 Hz
        mode="emulated",
        emulator=EmulatorSettings(payload_compensation=False),
    ),
    "straight": System(mode="emulated", vehicle=STRAIGHT_VERTICAL_THESIS),  # rings at 25.8 Hz
    "satellite": System(mode="emulated", vehicle=FREE_FLOATING),
    "legs": System(  # they swing within each period
        mode="emulated",
        vehicle=DECOUPLED,
        emulator=EmulatorSettings(
            operation="position", platform=FILTERED, payload_compensation=False
        ),
        control_dt=leg_clock(FILTERED)[0],
        physics_dt=leg_clock(FILTERED)[1],
    ),
}

LONGER = tuple(k for k in QUICK if k != "legs")


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=pytest.mark.slow) if k in LONGER else k for k in QUICK]
)
def test_nothing_is_missing_in_an_exact_description(name):
    system = QUICK[name]
    recordings = (recorded(system, system.control_dt, k) for k in range(3, 30))
    logs = itertools.chain.from_iterable(recordings)
    # a loop that rings stops at lively motions, and one of the others says too little
    logs = itertools.islice(logs, 2 if name == "no compensation" else 1)
    assert verdict(system, *logs) == NOTHING


@pytest.mark.slow
def test_an_error_below_the_swing_between_samples_is_named():
    """2e-3 of F_x at F_z, 0.03 N, where the legs' swing alone adds 0.5 N to the reading."""
    system, error = QUICK["legs"], np.zeros((6, 6))
    error[2, 0] = 2e-3
    hidden = E.SensorCalibration(error=tuple(map(tuple, error.tolist())))
    logs = recorded(system.replace(effects=(hidden,)), system.control_dt, 138, count=2)
    found = told(system, logs)
    assert [f.candidate.name for f in found.explanations] == ["sensor/calibration at F_z"]
    assert found.explanations[0].values == pytest.approx(error[2], abs=1e-4)


@pytest.mark.slow
def test_friction_of_a_joint_that_turns_round_quickly_is_that_described():
    """By a rate of the band alone joint 1 had up to 15 times what means nothing."""
    system, *logs = case(409)
    inputs = system_inputs(logs, system, final=0)
    inputs.machine.ports = tuple(p for p in inputs.machine.ports if p.name == "joint")
    residuals = WhitenedResiduals(inputs.machine, inputs.runs)
    groups = residuals.groups
    assert max(np.mean(residuals.null[g.part] ** 2) for g in groups) < 1
    assert all(0.9 < g.floor <= 1 + 1e-9 for g in groups)  # logs without noise


def test_what_inertia_changes_within_a_swing_is_no_torque():
    """Of seven joints on a satellite, below 1.2 Hz; held over each period: 0.02 to 0.05 N m."""
    system, *logs = case(287)
    inputs = system_inputs(logs, system, final=0)
    for run in inputs.runs:
        left = inputs.machine.residuals(run, [inputs.machine.nominal], ["joint"])["joint"][0]
        slow = run.window.spectrum(left)[..., run.window.frequencies < 1.2, :]
        assert np.sqrt(np.mean(np.abs(slow) ** 2, axis=-2)).max() < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [51, 87])
def test_joints_rub_by_the_mean_of_a_swing(seed):
    """A platform that answers steps swings joints within each period, as fast as a creep."""
    assert verdict(*case(seed)) == NOTHING


@pytest.mark.slow
def test_legs_are_where_they_stand_when_the_vehicle_rings():
    """phi_z swings by 0.04 rad at 2.4 Hz, of which bending rods read 0.5 % less."""
    assert verdict(*case(183)) == NOTHING


@pytest.mark.slow
def test_nothing_is_missing_in_any_of_twenty():
    verdicts = {k: verdict(*case(k)) for k in range(0, 200, 10)}
    assert {k: v for k, v in verdicts.items() if v != NOTHING} == {}


@pytest.mark.slow
def test_a_calm_plan_tells_an_exact_description_from_one_without_its_friction():
    """Inner modes of 12 Hz ring for a second of twelve when the joint breaks away and stops."""
    system = System(effects=(E.JointCoulomb(torque=(0.0, 0.0, 3.0)),))
    plan = vg.plan([0, 0, 0], np.deg2rad([40, 20, -20]), duration=2.0)
    log = vg.simulate(plan.motion, system)
    exact = vg.diagnose(log)
    assert (exact.verdict, exact.remaining) == (NOTHING, 0.0)
    found = vg.diagnose(log, System())
    assert [f.candidate.name for f in found.explanations] == ["joint/coulomb at joint 3"]
    assert found.explanations[0].values == pytest.approx([3.0], abs=0.01)
