"""Effects on arm and vehicle: what is there differs, what is believed does not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.effects.values import effect
from ves_gym._util.params import ParameterError
from ves_gym.effects import (
    BaseDamping,
    BaseMode,
    BaseStiffness,
    JointRotorInertia,
    PayloadMass,
)
from ves_gym.effects.base import modes_of
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.gravity import GRAVITY
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import HIGH_GAINS
from ves_gym.mechanics.vehicle import BENT_THESIS, FREE_FLOATING, MatrixVehicle
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.energy_balance import EnergyBalance
from ves_gym.system.system import System

BACKENDS = ("kernel", "mujoco")
Q = np.array([0.3, -0.4, 0.7])
PLANT = tuple(
    effect(kind)
    for kind in (
        "base/damping",
        "base/stiffness",
        "base/virtual_mass",
        "joint/rotor_inertia",
        "payload/com",
        "payload/mass",
    )
)


def test_a_system_without_such_effects_is_its_own():
    plain = System(vehicle=BENT_THESIS, effects=(effect("joint/viscous"),))
    assert plain.actual is plain
    null = System(
        vehicle=BENT_THESIS, effects=(PayloadMass(), BaseStiffness(), effect("joint/viscous"))
    )
    assert null.actual == plain
    assert null.actual.arm is null.arm
    assert null.actual.base is null.base


def test_the_actual_system_is_the_one_with_other_numbers():
    """The same as a system described that way, effects on arm and vehicle taken out."""
    system = System(vehicle=BENT_THESIS, effects=(*PLANT, effect("joint/viscous")))
    there = system.actual
    assert [e.kind for e in there.effects] == ["joint/viscous"]
    np.testing.assert_allclose(there.base.K, 0.8 * system.base.K)
    np.testing.assert_allclose(there.base.D, 1.5 * system.base.D)
    np.testing.assert_allclose(there.base.M, 1.2 * system.base.M)
    assert there.arm.mass == pytest.approx(system.arm.mass + 2.0)
    assert there.arm.links[1].rotor_inertia == system.arm.links[1].rotor_inertia + 1.0


@pytest.mark.parametrize(("backend", "mode"), [("mujoco", "ideal"), ("kernel", "emulated")])
def test_the_run_is_that_of_the_arm_so_described(mode, backend):
    """Without a model of the arm in the loop the two cannot be told apart, to the bit."""
    emulator = None
    if mode == "emulated":
        emulator = EmulatorSettings(operation="admittance", payload_compensation=False)
    system = System(vehicle=BENT_THESIS, mode=mode, emulator=emulator, effects=PLANT)
    runs = []
    for one in (system, system.actual):
        sim = Simulator(one, backend=backend, warn_at=None)
        sim.reset(q=Q)
        for k in range(8):
            sim.step(sim.servo_command(Q + 0.01 * k, 0 * Q))
        runs.append(sim.state)
    for a, b in zip(*runs, strict=True):
        assert a.tobytes() == b.tobytes()


def test_a_payload_weighs_m_g_at_the_tool_and_the_estimate_knows_nothing_of_it():
    """Closed form: force m g, moment r x m g about the platform's origin."""
    payload = PayloadMass(mass=2.0)
    still = EmulatorSettings(operation="microgravity")
    seen = []
    for effects in ((), (payload,)):
        system = System(vehicle=BENT_THESIS, mode="emulated", emulator=still, effects=effects)
        sim = Simulator(system, warn_at=None)
        sim.reset(q=Q)
        seen.append(sim.readings)
    more = seen[1].wrench[0] - seen[0].wrench[0]
    weight = np.array([0.0, 0.0, -2.0 * GRAVITY])
    tool = joint_positions(PUMA_560, Q)[-1]
    np.testing.assert_allclose(more, np.r_[weight, np.cross(tool, weight)], atol=1e-9)
    np.testing.assert_array_equal(seen[0].gravity, seen[1].gravity)


@pytest.mark.parametrize(
    ("more", "tolerance"),
    [((), 1e-5), ((effect("joint/drive_gain"), effect("joint/asymmetry")), 1e-4)],
    ids=["plant", "with laws"],
)
def test_the_energy_account_closes(more, tolerance):
    """Laws that follow the motor are sampled: Simpson's rule at the step, 1e-4."""
    motion = Motion.straight(np.zeros(3), np.deg2rad([60, 40, -30]), 1.0)
    system = System(vehicle=BENT_THESIS, effects=(*PLANT, *more))
    run = play_motions(system, [motion], settle=0.5, record_dt=system.physics_dt)
    assert EnergyBalance.of(run.log(0)).relative < tolerance


def test_feed_forward_goes_by_the_description():
    motion = Motion.straight(np.zeros(3), Q, 1.0)
    runs = [
        play_motions(
            System(vehicle=BENT_THESIS, effects=k), [motion], servo=HIGH_GAINS, settle=0.1
        )
        for k in ((), (PayloadMass(mass=5.0),))
    ]
    error = [np.abs(run.q - run.q_cmd).max() for run in runs]
    assert error[1] > 1.5 * error[0]


# ------------------------------------------------------------------------- refused


@pytest.mark.parametrize("kind", ["stiffness", "damping", "amplitude_damping", "unknown"])
def test_nothing_holds_a_satellite(kind):
    with pytest.raises(ParameterError, match=r"would do nothing: it needs a vehicle (with|of)"):
        System(vehicle=FREE_FLOATING, effects=(effect(f"base/{kind}"),))


def test_an_undamped_vehicle_has_no_damping_to_be_wrong():
    for vehicle in (replace(BENT_THESIS, damping_ratio=0.0), undamped()):
        with pytest.raises(ParameterError, match="it needs a vehicle with damping"):
            System(vehicle=vehicle, effects=(BaseDamping(error=0.1),))


def undamped():
    eye = tuple(map(tuple, np.eye(6).tolist()))
    none = tuple(map(tuple, np.zeros((6, 6)).tolist()))
    return MatrixVehicle(M=eye, D=none, K=eye)


def test_a_mode_is_one_that_the_vehicle_has():
    """No vehicle is pushed away by what holds it; its own modes never ask for that."""
    foreign = BaseMode(error=-0.4, frequency=30.0, momentum=(100.0, 50.0, 3.0, 4.0, 5.0, 6.0))
    with pytest.raises(ParameterError, match=r"base/mode needs a mode .* got 30 Hz"):
        System(vehicle=BENT_THESIS, effects=(foreign,))
    M, _, K = System(vehicle=BENT_THESIS).base.condensed()
    for frequency, momentum in modes_of(M, K):
        own = BaseMode(error=-0.5, frequency=frequency, momentum=tuple(momentum))
        System(vehicle=BENT_THESIS, effects=(own,))


def test_no_rotor_is_lighter_than_nothing():
    with pytest.raises(
        ParameterError, match=r"of joint 3 must be >= -0.5 kg m\^2, .* got -0.8"
    ):
        link = replace(PUMA_560.links[2], rotor_inertia=0.5)
        arm = replace(PUMA_560, links=(*PUMA_560.links[:2], link))
        System(
            vehicle=BENT_THESIS, arm=arm, effects=(JointRotorInertia(added=(0.0, 0.0, -0.8)),)
        )


def test_an_admittance_of_ones_own_leaves_no_vehicle_to_be_wrong():
    def g(X, W):
        return np.concatenate([X[:, 6:], W / 500 - 2 * X[:, :6]], axis=-1)

    system = System(vehicle=BENT_THESIS, mode="emulated", effects=(BaseStiffness(error=0.1),))
    with pytest.raises(
        ParameterError, match="base/stiffness would do nothing: an `admittance`"
    ):
        Simulator(system, admittance=g)
