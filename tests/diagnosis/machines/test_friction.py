"""Friction that builds up, gears that give, teeth that meet: against closed forms and SciPy.

Dry friction that builds up over a distance is Coulomb friction: Dahl's law, solved here.
"""

import dataclasses

import numpy as np
import pytest
import scipy

from tests.diagnosis.logs import RIGID, logged
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.presliding import Presliding
from ves_gym.diagnosis.machines.recursions import crossing, deflection
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.effects import JointAsymmetry, JointCoulomb, JointLoadFriction, JointStribeck
from ves_gym.system.effect import joint_torque

DT = 5e-3


def test_friction_builds_up_over_its_length():
    v = np.full((400, 1), 2e-2)
    law = np.where(np.arange(400)[:, None] < 1, 0.0, 3.0)
    grown = Presliding(JointCoulomb(torque=(3.0,)), length=1e-2).built_up(law, v, DT)
    distance = v[:, 0] * DT * np.arange(400)
    assert np.allclose(grown[:, 0], 3.0 * -np.expm1(-distance / 1e-2), atol=1e-12)


def test_friction_at_rest_stays_what_it_is():
    law = np.linspace(-1, 1, 50)[:, None]
    grown = Presliding(JointCoulomb(torque=(1.0,))).built_up(law, np.zeros((50, 1)), DT)
    assert (grown == law[0]).all()


def test_a_spring_gives_in_proportion_and_a_damper_takes_its_time():
    torque = np.concatenate([np.zeros(1), np.full(2000, 12.0)])
    assert np.allclose(deflection(torque, 1e4, 0.0, 0.0, DT), torque / 1e4)
    t = DT / 50 * np.arange(2001)
    slow = deflection(torque, 1e4, 500.0, 0.0, DT / 50)
    assert slow == pytest.approx(12e-4 * -np.expm1(-t / 0.05), abs=2e-6)


def test_a_spring_hardens_with_the_cube():
    x = np.linspace(-0.03, 0.03, 61)
    torque = 4e3 * x * (1 + (x / 0.01) ** 2)
    assert deflection(torque, 4e3, 0.0, 0.0, DT, 0.01) == pytest.approx(x, abs=1e-15)
    t = DT / 50 * np.arange(4001)
    push = 60.0 * np.sin(2 * np.pi * t / 0.2)
    found = scipy.integrate.solve_ivp(
        lambda s, x: (np.interp(s, t, push) - 4e3 * x * (1 + (x / 0.01) ** 2)) / 30.0,
        (0.0, t[-1]),
        [0.0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    )
    slow = deflection(push, 4e3, 30.0, 0.0, DT / 50, 0.01)
    assert slow == pytest.approx(found.y[0], abs=5e-5)  # of 9 mrad; one implicit step each


def test_teeth_touch_beyond_half_the_gap():
    torque = np.array([5.0, 5.0, -5.0, -5.0, 0.0])
    x = deflection(torque, 1e4, 0.0, 1e-3, DT)
    assert x[:4] == pytest.approx([1.5e-3, 1.5e-3, -1.5e-3, -1.5e-3])
    rows = deflection(np.tile(torque, (3, 1)), 1e4, 0.0, 1e-3, DT)
    assert (rows == x).all()


@pytest.mark.parametrize("damping", [0.0, 8.0])
def test_a_link_flies_through_its_gap(damping):
    """M x'' + d x' = L from one side, against SciPy; then it stays on the other."""
    M, L, half = 2.0, 3.0, 5e-3
    t = DT * np.arange(60)
    load = np.where(t < 10 * DT, -L, L)
    x = crossing(load, np.full(60, M), damping, half, DT)
    assert (x[:10] == -half).all()
    begin = 9.5 * DT  # where straight lines between samples change sign

    def push(now):
        return np.interp(now, t, load)

    free = scipy.integrate.solve_ivp(
        lambda now, s: [s[1], (push(now) - damping * s[1]) / M],
        (begin, t[-1]), [-half, 0.0], dense_output=True, rtol=1e-10, max_step=DT / 4,
    )  # fmt: skip
    expected = np.minimum(free.sol(np.maximum(t, begin))[0], half)
    landed = int(np.argmax(expected >= half))
    assert 30 < landed < 45
    assert np.abs(x[:landed] - expected[:landed]).max() < 0.04 * half
    assert (x[landed + 1 :] == half).all()


def test_a_link_that_is_pressed_stays_where_teeth_meet():
    load = 2.0 + np.sin(np.arange(100) / 5)
    assert (crossing(load, np.ones(100), 0.0, 1e-3, DT) == 1e-3).all()
    both = crossing(np.stack([load, -load]), np.ones(100), 0.0, 1e-3, DT)
    assert (both[0] == 1e-3).all() and (both[1] == -1e-3).all()


LEVEL = 4.0  # N m


def dahl(run, distance):
    """(T,) share of the level by which a joint's contact resists, from rest (Dahl, 1968)."""
    t = run.dt * np.arange(run.length)
    rate = scipy.interpolate.CubicSpline(t, run.joints.v[:, 0])

    def grows(now, z):
        return (rate(now) - abs(rate(now)) * z) / distance

    return scipy.integrate.solve_ivp(grows, (0, t[-1]), [0.0], t_eval=t, max_step=2e-3).y[0]


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


@pytest.mark.parametrize("distance", [3e-4, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_bristles_of_any_usual_length_are_coulomb_friction(quiet, distance):
    """As told of rates alone it was Stribeck's: a tenth more below 0.2 rad/s (the trial)."""
    residuals, coulomb, stribeck = rubbing(quiet, LEVEL * dahl(quiet, distance))
    null = fit(residuals, (), ()).deviance
    plain = fit(residuals, [coulomb], [np.array([2.0])])
    more = fit(residuals, [stribeck], [np.array([2.0, 0.5, 0.1])])
    assert plain.values[0][0] == pytest.approx(LEVEL, rel=0.05)
    assert null - more.deviance < 1.1 * (null - plain.deviance)


def test_a_fit_goes_the_same_way_through_another_form_of_its_law(quiet):
    """Where friction is nearly all of another form, the plain law's slopes led astray."""
    v = quiet.joints.v[:, 0]
    level = LEVEL * (1 + 1.2 * np.exp(-((v / 0.05) ** 2)))
    residuals, _, stribeck = rubbing(quiet, level * dahl(quiet, 5e-4))
    starts = [[2.0, 1.0, 0.1], [6.0, 2.0, 0.1]]
    fits = [fit(residuals, [stribeck], [np.array(x)]) for x in starts]
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
