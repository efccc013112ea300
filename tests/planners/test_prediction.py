"""The linear prediction of base energy and disturbance, and the form that E_mean is."""

import dataclasses

import numpy as np
import pytest
import scipy.signal

from tests.arms import with_modes
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.link import Mount
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, get_vehicle
from ves_gym.planners.linear_response import predict_disturbance
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.prediction import (
    BaseState,
    LinearBase,
    predict,
    spectral_energy,
)
from ves_gym.planners.query import Query
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import TAIL
from ves_gym.system.frequency_weight import FrequencyWeight
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

START = np.array([0.4, -0.6, 0.9])
SMALL = Motion.straight(
    START, START + np.array([1e-3, -2e-3, 1.5e-3]), 1.0
)  # inertia hardly changes
LARGE = Motion.straight(START, START + np.array([0.8, 0.6, -1.2]), 1.0)


def test_a_motion_that_stands_still_predicts_nothing():
    still = Motion.straight(START, START, 1.0)
    nothing = {"E_mean": 0.0, "E_res": 0.0, "E_peak": 0.0}
    assert predict(BENT, still, HIGH_GAINS).to_dict() == nothing
    assert spectral_energy(BENT, still) == 0.0


def test_the_servo_counts_on_motor_drives_only():
    motor, prescribed = (BENT, System(vehicle=BENT_THESIS, drive="prescribed"))
    assert predict(prescribed, LARGE, HIGH_GAINS) == predict(prescribed, LARGE)
    assert predict(motor, LARGE) == predict(prescribed, LARGE)
    assert predict(motor, LARGE, HIGH_GAINS) != predict(motor, LARGE)
    stiff = dataclasses.replace(HIGH_GAINS, kp=(1e8,) * 3, kd=(1e5,) * 3)
    assert predict(motor, LARGE, stiff).E_mean == pytest.approx(
        predict(motor, LARGE).E_mean, rel=1e-3
    )


# ------------------------------------------------------- a base that moves at the start

MOVING = BaseState(y=(0.01, 0.02, -0.01, 0.001, 0.0, 0.002), yd=(0.02, 0.0, 0.03, 0, 0.001, 0))
TO_REST = Motion.to_rest(START, [0.3, -0.2, 0.4], [0.5, 0.0, -0.5], START + 0.2, 1.0)


@pytest.mark.parametrize("servo", [None, HIGH_GAINS], ids=["exact joints", "servo"])
@pytest.mark.parametrize("motion", [LARGE, TO_REST], ids=["rest", "moving joints"])
@pytest.mark.parametrize("base", [None, MOVING], ids=["base at rest", "base moving"])
def test_along_a_motion_the_form_is_the_prediction(servo, motion, base):
    """Two texts of the same steps: equal to rounding."""
    u = inertia(BENT.arm, motion.start)[:6, 6:] @ motion.at([0.0]).v[0]
    form = MeanEnergy(BENT, motion, 1.0, servo, base=base, momentum=u)
    expected = predict(BENT, motion, servo, base=base).E_mean
    assert form.of(motion) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("motion", [LARGE, TO_REST], ids=["rest", "moving joints"])
def test_a_moving_base_is_predicted_as_it_is_simulated(motion):
    """Tolerance: 1 % for rotations of the base of milliradians, which the linear base lacks."""
    run = play_motions(BENT, [motion], y=MOVING.y, yd=MOVING.yd)
    simulated = run.energies()[0]
    predicted = predict(BENT, motion, HIGH_GAINS, base=MOVING)
    assert predicted.E_mean == pytest.approx(simulated.E_mean, rel=0.01)
    assert predicted.E_mean != pytest.approx(predict(BENT, motion, HIGH_GAINS).E_mean, 0.1)


def test_internal_modes_are_part_of_the_base():
    """Those tied to nothing keep their energy 1/2 w^2 u^2; tied, they change the rest."""
    six = predict(BENT, LARGE, HIGH_GAINS, base=MOVING).E_mean
    base = dataclasses.replace(MOVING, u=(0.5, -0.2), ud=(0.0, 0.0))
    assert LinearBase(with_modes(0.0), HIGH_GAINS).size == 11
    apart = predict(with_modes(0.0), LARGE, HIGH_GAINS, base=base).E_mean
    assert apart == pytest.approx(six + (4.0 * 0.5**2 + 25.0 * 0.2**2) / 2, rel=1e-4)
    tied = with_modes(3.0)
    expected = predict(tied, LARGE, HIGH_GAINS, base=base).E_mean
    assert expected != pytest.approx(apart, rel=0.01)
    form = MeanEnergy(tied, LARGE, 1.0, HIGH_GAINS, base=base)
    assert form.of(LARGE) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("base", [None, MOVING], ids=["base at rest", "base moving"])
def test_internal_modes_are_predicted_as_they_are_simulated(base):
    """Tolerance: that of six coordinates; without the modes it is off by much more."""
    system = with_modes(7.0)
    start = {} if base is None else {"y": base.y, "yd": base.yd}
    run = play_motions(system, [LARGE], **start)
    simulated = run.energies()[0].E_mean
    assert predict(system, LARGE, HIGH_GAINS, base=base).E_mean == pytest.approx(
        simulated, rel=0.02
    )
    assert predict(BENT, LARGE, HIGH_GAINS, base=base).E_mean != pytest.approx(
        simulated, rel=0.05
    )


def test_a_base_state_that_is_none():
    with pytest.raises(ParameterError, match=r"BaseState.y must have shape \(6,\)"):
        BaseState(y=(0.1,) * 3)
    with pytest.raises(ParameterError, match=r"BaseState.ud must have shape \(1,\)"):
        BaseState(u=(0.1,), ud=(0.1, 0.1))
    with pytest.raises(ParameterError, match="0 internal coordinates, got 1"):
        predict(BENT, LARGE, base=BaseState(u=(0.1,), ud=(0.0,)))
    with pytest.raises(ParameterError, match="0 internal coordinates, got 1"):
        Query(system=BENT, start=(0, 0, 0), goal=(0, 0, 0), duration=1.0,
              base=BaseState(u=(0.1,), ud=(0.0,)))  # fmt: skip


# ------------------------------------------------------------------ disturbance

NEAR = START + np.array([1e-3, -2e-3, 1.5e-3])  # inertia hardly changes
ARM = dataclasses.replace(
    PUMA_560, mount=Mount(position=(0.3, -0.2, 0.5), angles=(0.0, 0.0, 0.0))
)


def query_of(vehicle="bent-thesis", goal=NEAR, **changes):
    system = System(vehicle=get_vehicle(vehicle), arm=changes.pop("arm", PUMA_560))
    named = {"start": tuple(START), "goal": tuple(goal), "duration": 1.0} | changes
    return Query(system=system, servo=HIGH_GAINS, **named)


@pytest.mark.parametrize("vehicle", ["bent-thesis", "bent", "free-floating"])
def test_the_prediction_is_scipys_linear_simulation(vehicle):
    """M z'' + D z' + K z = -u' by `lsim` at 0.5 ms, the joints on their command.

    Tolerance: 1e-3 of the inertia's change over milliradians, and lsim's mean over the step.
    """
    query = query_of(vehicle, arm=ARM)
    query = dataclasses.replace(query, system=query.system.replace(drive="prescribed"))
    system, motion, h = query.system, query.straight, 5e-4
    t = np.arange(0, 1 + TAIL + h / 2, h)
    H = inertia(system.arm, START)
    M, D, K = system.base.full()
    M[:6, :6] += H[:6, :6]
    b = len(M)
    s = motion.at(np.clip(t, 0, 1))
    du = np.where(t[:, None] < 1, s.a, 0) @ H[:6, 6:].T
    w = 2 * np.pi  # of the high pass at 1 Hz: z less its low pass
    A, B = np.zeros((3 * b, 3 * b)), np.zeros((3 * b, 6))
    A[:b, b : 2 * b] = np.eye(b)
    A[b : 2 * b] = -np.linalg.solve(M, np.hstack([K, D, np.zeros((b, b))]))
    A[2 * b :, :b], A[2 * b :, 2 * b :] = w * np.eye(b), -w * np.eye(b)
    B[b : 2 * b] = -np.linalg.inv(M)[:, :6]
    _, _, x = scipy.signal.lsim((A, B, np.eye(3 * b), np.zeros((3 * b, 6))), du, t)
    rate = x @ A.T + du @ B.T
    z, zd, zdd = x[:, :b], x[:, b : 2 * b], rate[:, b : 2 * b]
    zf, zdf = z - x[:, 2 * b :], zd - rate[:, 2 * b :]
    lever, tool = np.array(ARM.mount.position), joint_positions(system.arm, s.q)[:, -1]
    linear = zdd[:, :3] + np.cross(zdd[:, 3:6], lever)
    tip = np.linalg.norm(z[:, :3] + np.cross(z[:, 3:6], tool), axis=1)
    moved = np.linalg.norm(z[:, :3] + np.cross(z[:, 3:6], lever), axis=1)
    energy = 0.5 * np.sum((zf @ K) * zf + (zdf @ M) * zdf, axis=1)

    def rms(values):
        return np.sqrt(np.trapezoid(np.sum(values**2, axis=1), t) / t[-1])

    def most(values):
        return np.linalg.norm(values, axis=1).max()

    end, turned = np.searchsorted(t, 1 - 1e-9), np.linalg.norm(z[:, 3:6], axis=1)
    expected = {
        "acceleration": rms(linear),
        "acceleration_peak": most(linear),
        "angular": rms(zdd[:, 3:6]),
        "angular_peak": most(zdd[:, 3:6]),
        "tip": rms(tip[:, None]),
        "tip_peak": tip.max(),
        "tip_end": tip[end],
        "displacement_peak": moved.max(),
        "rotation_peak": turned.max(),
        "attitude_end": turned[end],
        "E_weighted": np.trapezoid(energy, t) / t[-1],
    }
    found = predict_disturbance(query, motion).to_dict()
    assert found == pytest.approx(expected, rel=4e-3)


def test_the_filter_of_a_query_is_that_of_its_measure():
    query = query_of(goal=START + 0.3)
    whole = dataclasses.replace(query, weight=FrequencyWeight(corners=(), gains=(1.0,)))
    found = predict_disturbance(whole, query.straight).E_weighted
    mean = predict(query.system, query.straight, HIGH_GAINS, parts=10).E_mean
    assert found == pytest.approx(mean, rel=1e-3)
    assert predict_disturbance(query, query.straight).E_weighted < 0.9 * mean
