"""Rates logged beside angles. References: a low-pass in closed form, a lag that was hidden."""

import numpy as np
import pytest

import ves_gym.effects as E
from tests.diagnosis.machines.noisy_arm import RIGID, logged
from ves_gym.diagnosis.inference.candidates import library
from ves_gym.diagnosis.inference.fit import fit
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.diagnosis.machines.rates import low_passed
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.mechanics.servo import JointServo

SOFT = JointServo(kp=(3000.0, 2000.0, 100.0), kd=(50.0, 40.0, 5.0))  # joint 3 as a wrist is
LAG = 2e-3  # s


@pytest.mark.parametrize("first", [None, 0.3])
def test_a_ramp_comes_through_a_low_pass_as_in_closed_form(first):
    """T w' = v - w with v = a + b t: w = a + b (t - T) + (w(0) - a + b T) exp(-t / T)."""
    a, b, T, dt = 0.7, -0.4, 0.05, 0.01
    t = dt * np.arange(80)
    v = np.stack([a + b * t, a + b * t], axis=1)
    begins = None if first is None else np.array([first, first])
    out = low_passed(v, np.array([T, 0.0]), dt, begins)
    start = a if first is None else first
    exact = a + b * (t - T) + (start - a + b * T) * np.exp(-t / T)
    assert np.abs(out[:, 0] - exact).max() < 1e-13
    assert np.array_equal(out[:, 1], v[:, 1])


def at_joint_3(run, *left_out):
    """Fit of a lag at joint 3, and what it gains over none."""
    machine = SystemMachine(RIGID)
    machine.ports = tuple(p for p in machine.ports if p.name not in left_out)
    residuals = WhitenedResiduals(machine, [run])
    every = library(3, [p.name for p in machine.ports], "ideal", system=RIGID)
    lag = next(c for c in every if c.name == "joint/velocity_lag at joint 3")
    assert ("velocity" in lag.ports) == ("velocity" not in left_out)
    f = fit(residuals, [lag], [np.array([0.02])])
    return f, fit(residuals, (), ()).deviance - f.deviance


def test_a_lag_that_a_soft_servo_hardly_feels_is_seen_in_the_rates():
    """Gains of 5 N m s/rad make 0.02 N m of it, under 0.4 N m of noise."""
    hidden = E.JointVelocityLag(time_constant=(0.0, 0.0, LAG))
    run = logged(RIGID.replace(effects=(hidden,)), SOFT)
    found, gain = at_joint_3(run)
    _, by_servo = at_joint_3(run, "velocity")
    print("gain", gain, "by the servo alone", by_servo)
    assert gain > 10 * max(by_servo, 10.0)
    assert found.values[0][0] == pytest.approx(LAG, rel=0.15)


def test_no_lag_is_found_where_there_is_none():
    _, gain = at_joint_3(logged(RIGID, SOFT))
    assert gain < 10
