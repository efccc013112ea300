"""The linear prediction of base energy and its quadratic form."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm import matrix
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.spatial import matvec
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES, MatrixVehicle
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.prediction import (
    BaseState,
    LinearBase,
    joint_momentum,
    predict,
    spectral_energy,
)
from ves_gym.planners.query import Query
from ves_gym.simulation.playback import play_motions
from ves_gym.system.energy import energies
from ves_gym.system.system import System

BENT = System(vehicle=BENT_THESIS)

START = np.array([0.4, -0.6, 0.9])
SMALL = Motion.straight(
    START, START + np.array([1e-3, -2e-3, 1.5e-3]), 1.0
)  # inertia hardly changes
LARGE = Motion.straight(START, START + np.array([0.8, 0.6, -1.2]), 1.0)


def quadratic_form(system, motion, servo):
    """E_mean by `MeanEnergy`, inertia frozen in the middle of the motion."""
    energy = MeanEnergy(system, motion.at(motion.duration / 2).q, motion.duration, servo)
    s = motion.at(energy.t)
    u = matvec(inertia(system.arm, s.q)[..., :6, 6:], s.v).ravel()
    return 0.5 * u @ energy.hessian @ u


@pytest.mark.parametrize(
    "vehicle", ["bent-thesis", "straight-vertical-thesis", "decoupled", "free-floating"]
)
@pytest.mark.parametrize("servo", [None, HIGH_GAINS], ids=["exact joints", "servo"])
def test_the_quadratic_form_is_the_prediction_where_inertia_is_constant(vehicle, servo):
    """Tolerance: milliradians change the inertia by 1e-3 relative."""
    system = System(vehicle=VEHICLES[vehicle])
    form = quadratic_form(system, SMALL, servo)
    assert form == pytest.approx(predict(system, SMALL, servo).E_mean, rel=2e-3)
    assert form > 0


def test_a_motion_that_stands_still_predicts_nothing():
    still = Motion.straight(START, START, 1.0)
    assert predict(BENT, still, HIGH_GAINS).to_dict() == {
        "E_mean": 0.0,
        "E_res": 0.0,
        "E_peak": 0.0,
    }
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
    u = joint_momentum(BENT, motion, np.zeros(1))[0]
    form = MeanEnergy(BENT, motion, 1.0, servo, base=base, momentum=u)
    expected = predict(BENT, motion, servo, base=base).E_mean
    assert form.of(motion) == pytest.approx(expected, rel=1e-10)


def test_the_linear_term_is_the_slope():
    form = MeanEnergy(BENT, LARGE, 1.0, HIGH_GAINS, nodes=12, base=MOVING)
    u = joint_momentum(BENT, LARGE, form.t).ravel()
    step = np.random.default_rng(0).normal(size=u.size)
    slope = (form.value(u + step) - form.value(u - step)) / 2  # exact of a quadratic
    assert slope == pytest.approx(form.force(u) @ step, rel=1e-9)
    assert form.constant > 0
    at_rest = MeanEnergy(BENT, LARGE, 1.0, HIGH_GAINS, nodes=12)
    assert at_rest.constant == 0.0
    assert not at_rest.gradient.any()


@pytest.mark.parametrize("motion", [LARGE, TO_REST], ids=["rest", "moving joints"])
def test_a_moving_base_is_predicted_as_it_is_simulated(motion):
    """Tolerance: 1 % for rotations of the base of milliradians, which the linear base lacks."""
    run = play_motions(BENT, [motion], y=MOVING.y, yd=MOVING.yd)
    simulated = energies(run.system, run.t, run.q, run.y, run.yd, duration=1.0)[0]
    predicted = predict(BENT, motion, HIGH_GAINS, base=MOVING)
    assert predicted.E_mean == pytest.approx(simulated.E_mean, rel=0.01)
    assert predicted.E_mean != pytest.approx(predict(BENT, motion, HIGH_GAINS).E_mean, 0.1)


def with_modes(coupling):
    """The bent beam with two internal modes tied to its pose, or to nothing."""
    bent = BENT.base
    P = coupling * np.eye(6)[:, [0, 4]]
    vehicle = MatrixVehicle(
        **{name: matrix(getattr(bent, name)) for name in "MDK"},
        coupling=matrix(P),
        omega=(2.0, 5.0),
    )
    return System(vehicle=vehicle)


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
