"""Dry friction that builds up over a distance is Coulomb friction. Reference: Dahl's law,
solved here along the motion, beside the torque of a machine that does not rub.
"""

import dataclasses

import numpy as np
import pytest
import scipy

from tests.diagnosis.machines.noisy_arm import RIGID, logged
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.presliding import Presliding
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import JointAsymmetry, JointCoulomb, JointLoadFriction, JointStribeck
from ves_gym.system.effect import joint_torque

LEVEL = 4.0  # N m


def dahl(run, distance):
    """(T,) share of the level by which a joint's contact resists, from rest (Dahl, 1968)."""
    t = run.dt * np.arange(run.length)
    rate = scipy.interpolate.CubicSpline(t, run.joints.v[:, 0])
    solved = scipy.integrate.solve_ivp(
        lambda t, z: (rate(t) - abs(rate(t)) * z) / distance,
        (0, t[-1]),
        [0.0],
        t_eval=t,
        max_step=2e-3,
    )
    return solved.y[0]


@pytest.fixture(scope="module")
def quiet():
    """A run of a machine that does not rub, its torques told by their log alone."""
    return dataclasses.replace(logged(RIGID), by_log=True)


def rubbing(quiet, torque):
    """Residuals of the run with friction (T,) at joint 1, and two laws that may be it."""
    tau = quiet["tau"].copy()
    tau[:, 0] += torque  # what the motor gives beside the motion
    residuals = WhitenedResiduals(SystemMachine(RIGID), [quiet.with_signals({"tau": tau})])
    ports = [p.name for p in residuals.ports]
    every = {c.name: c for c in library(3, ports, "ideal", system=RIGID)}
    return residuals, *(every[f"joint/{k} at joint 1"] for k in ("coulomb", "stribeck"))


@pytest.mark.parametrize("distance", [3e-4, 5e-4, 1e-3])
def test_bristles_of_any_usual_length_are_coulomb_friction(quiet, distance):
    """As told of rates alone it was Stribeck's: a tenth more below 0.2 rad/s (the trial)."""
    residuals, coulomb, stribeck = rubbing(quiet, LEVEL * dahl(quiet, distance))
    null = fit(residuals, (), ()).deviance
    plain = fit(residuals, [coulomb], [np.array([2.0])])
    more = fit(residuals, [stribeck], [np.array([2.0, 0.5, 0.1])])
    print("gain", null - plain.deviance, null - more.deviance, plain.values, plain.forms)
    assert plain.values[0][0] == pytest.approx(LEVEL, rel=0.05)
    assert null - more.deviance < 1.1 * (null - plain.deviance)


def test_a_fit_goes_the_same_way_through_another_form_of_its_law(quiet):
    """Where friction is nearly all of another form, the plain law's slopes led astray."""
    v = quiet.joints.v[:, 0]
    level = LEVEL * (1 + 1.2 * np.exp(-((v / 0.05) ** 2)))
    residuals, _, stribeck = rubbing(quiet, level * dahl(quiet, 5e-4))
    starts = [[2.0, 1.0, 0.1], [4.0, 0.3, 0.05], [6.0, 2.0, 0.1], [5.0, 1.0, 0.2]]
    fits = [fit(residuals, [stribeck], [np.array(x)]) for x in starts]
    print([(f.deviance, f.values[0], f.forms) for f in fits])
    assert np.ptp([f.deviance for f in fits]) < 1
    assert fits[0].values[0][0] == pytest.approx(LEVEL, rel=0.05)
    assert fits[0].values[0][2] == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize(
    "effect",
    [
        JointCoulomb(torque=(3.0,)),
        JointStribeck(coulomb=(2.0,), stiction=(3.0,), fade_speed=0.05),
        JointAsymmetry(coulomb=(3.0,), viscous=(0.0,)),
        JointLoadFriction(coefficient=(0.3,)),
    ],
    ids=lambda e: e.kind,
)
def test_bristles_bear_the_whole_level_however_slowly_they_are_drawn(effect):
    slow = np.array([[1e-4], [-1e-4]])
    tau = np.full((2, 1), 10.0)
    law = joint_torque([effect], slow, Presliding(effect).sliding(slow), tau, np.full(1, 50.0))
    assert np.abs(law) == pytest.approx(3.0, rel=0.01)
    assert np.array_equal(Presliding(effect).sliding(10 * np.sign(slow)), 10 * np.sign(slow))
