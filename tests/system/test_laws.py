"""Effects that are torques at the joints: one text for NumPy, MuJoCo and the kernel."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import (
    JointAsymmetry,
    JointCoulomb,
    JointDriveGain,
    JointLoadFriction,
    JointRipple,
    JointStribeck,
    JointTorqueLimit,
    JointViscous,
)
from ves_gym.engine.kernel.numbers import structure
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.effect import Effect, LaboratoryEffect, joint_torque, register_effect
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

FRICTION = (
    JointStribeck(coulomb=(3.0, 4.0, 2.0), stiction=(6.0, 8.0, 4.0), fade_speed=0.3),
    JointViscous(damping=(2.0, 2.0, 1.0)),
    JointCoulomb(torque=(1.0, 0.0, 0.5)),
)
MOTION = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 1.0)


def gap(physics_dt):
    """Largest difference of joint angles between the engines [rad]."""
    system = System(vehicle=BENT_THESIS, effects=FRICTION, physics_dt=physics_dt)
    runs = [play_motions(system, [MOTION], settle=0.5, backend=k) for k in ("kernel", "mujoco")]
    return np.abs(runs[0].q - runs[1].q).max()


def test_engines_agree_as_the_step_shrinks():
    """MuJoCo holds the torque over each step: first order, so a quarter at a quarter step."""
    coarse, fine = gap(1.25e-3), gap(1.25e-3 / 4)
    assert coarse < 2e-5
    assert fine == pytest.approx(coarse / 4, rel=0.1)


def test_friction_is_in_the_energy_account():
    system = System(vehicle=BENT_THESIS, effects=FRICTION)
    log = play_motions(system, [MOTION], settle=0.5, record_dt=system.physics_dt).log(0)
    account = EnergyBalance.of(log)
    assert account.relative < 1e-5
    free = dataclasses.replace(
        log, meta={**log.meta, "system": System(vehicle=BENT_THESIS).to_dict()}
    )
    in_joints = account.dissipated[-1] - EnergyBalance.of(free).dissipated[-1]
    assert in_joints > 1.0  # J


def test_torques_are_those_of_the_formulas():
    q, v = np.zeros((4, 3)), np.array([[0.0] * 3, [5.0] * 3, [-5.0] * 3, [0.1, -0.1, 0.1]])
    torque = joint_torque(FRICTION, q, v, q, np.full(3, 90.0))
    np.testing.assert_array_equal(torque[0], 0)
    np.testing.assert_allclose(torque[1], [-3 - 10 - 1, -4 - 10, -2 - 5 - 0.5], rtol=1e-12)
    np.testing.assert_allclose(torque[2], -torque[1])
    fade = np.exp(-((0.1 / 0.3) ** 2))
    assert torque[3, 0] == pytest.approx(-(3 + 3 * fade) - 0.2 - 1, rel=1e-6)


SLOPE = 0.05  # rad/s, of a user's law


class Smooth(JointCoulomb):
    """A user's effect, whose formula may change without the package knowing."""

    def law(self, q, v, tau):
        return -self.torque * np.tanh(v / SLOPE)


def test_a_changed_constant_of_a_users_law_is_another_kernel(monkeypatch):
    """The text of the class alone would not show it, and the store would serve the old code."""
    one, two = (
        System(vehicle=BENT_THESIS, effects=(Smooth(torque=(k,) * 3),)) for k in (1.0, 2.0)
    )
    before = structure(one)
    assert structure(two) == before
    assert structure(one.replace(effects=(JointCoulomb(torque=(1.0,) * 3),))) != before
    monkeypatch.setitem(globals(), "SLOPE", 0.02)
    assert structure(one) != before


def test_an_effect_must_do_something():
    with pytest.raises(ParameterError, match="must be a subclass of one of LaboratoryEffect, "):

        @register_effect("test/nothing")
        class Nothing(Effect):
            pass


def test_an_effect_must_say_where_it_enters():
    with pytest.raises(
        ParameterError, match=r"port must be one of joint, wrench, .*, got None"
    ):

        @register_effect("test/nowhere")
        class Nowhere(LaboratoryEffect):
            def edit(self, p):
                pass


# ------------------------------------------------------------------ laws, one by one


def torque(effect, q=0.0, v=0.0, tau=0.0, limit=100.0):
    """Torque of one law at the first joint [N m]."""
    given = (np.full((1, 3), k) for k in (q, v, tau))
    return float(joint_torque((effect,), *given, np.full(3, limit))[0, 0])


def test_asymmetric_friction_is_even_in_speed_and_vanishes_at_rest():
    law = JointAsymmetry(coulomb=(2.0,) * 3, viscous=(0.5,) * 3)
    assert torque(law) == 0
    for v in (3.0, -3.0):
        assert torque(law, v=v) == pytest.approx(-2 - 0.5 * 3, rel=1e-12)


def test_load_friction_is_in_proportion_to_the_motor_torque():
    law = JointLoadFriction(coefficient=(0.1,) * 3)
    for tau in (20.0, -20.0):
        assert torque(law, v=1.0, tau=tau) == pytest.approx(-2.0, rel=1e-12)
        assert torque(law, v=-1.0, tau=tau) == pytest.approx(2.0, rel=1e-12)


def test_ripple_repeats_with_the_joint_angle():
    law = JointRipple(amplitude=(2.0,) * 3, cycles=(10.0,) * 3, phase=(np.pi / 2,) * 3)
    assert torque(law) == pytest.approx(2.0, rel=1e-12)
    assert torque(law, q=2 * np.pi / 10) == pytest.approx(2.0, rel=1e-12)
    assert torque(law, q=np.pi / 10) == pytest.approx(-2.0, rel=1e-12)


def test_a_limited_motor_gives_what_it_can():
    law = JointTorqueLimit(fraction=(0.4,) * 3)
    for tau, given in ((50.0, 50.0), (70.0, 60.0), (-100.0, -60.0)):
        assert tau + torque(law, tau=tau) == pytest.approx(given, rel=1e-12)


def test_drive_gain_scales_the_acceleration_and_not_the_log():
    """In free space, at rest: acceleration in proportion to the torque really given."""
    plain, gained = (
        Simulator(System(vehicle=BENT_THESIS, effects=k), servo=None)
        for k in ((), (JointDriveGain(error=(0.1,) * 3),))
    )
    (told, slow), (same, fast) = (k.evaluate([5.0, -3.0, 2.0]) for k in (plain, gained))
    np.testing.assert_array_equal(told, same)
    np.testing.assert_allclose(fast, 1.1 * slow, rtol=1e-9)


def test_an_early_limit_binds_and_the_log_shows_what_was_asked():
    half = JointTorqueLimit(fraction=(0.5,) * 3)
    limit = System(vehicle=BENT_THESIS).arm.column("tau_max")
    sims = [
        Simulator(System(vehicle=BENT_THESIS, effects=k), servo=None) for k in ((half,), ())
    ]
    told, limited = sims[0].evaluate(limit)
    np.testing.assert_allclose(told[0], limit)
    np.testing.assert_allclose(limited, sims[1].evaluate(limit / 2)[1], rtol=1e-9)
