"""The Learning Method on a clean machine: it converges, and it stops where it must."""

import dataclasses

import numpy as np
import pytest

from ves_gym._util.params import ParameterError
from ves_gym.effects import LABORATORY_ERRORS, GravityMass, SensorNoise
from ves_gym.hardware.stewart import VES
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.gravity import GravityModel
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS
from ves_gym.simulation import gravity_learning
from ves_gym.simulation.gravity_learning import learn_gravity
from ves_gym.simulation.playback import play_motions, weigh_poses
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

MOTION = Motion.straight([0.0, 0.0, 0.0], [0.6, 0.5, -0.4], 1.0)
SYSTEM = System(vehicle=BENT_THESIS, mode="emulated")
ADMITTANCE = SYSTEM.replace(emulator=EmulatorSettings(operation="admittance"))
# legs that may move by 2 mm
TINY = dataclasses.replace(
    VES,
    length_min=float(VES.home_lengths.min()) - 2e-3,
    length_max=float(VES.home_lengths.max()) + 2e-3,
)


def learn(system=SYSTEM, *, iterations=4, slow=4.0, settle=0.5, **options):
    return learn_gravity(
        system, MOTION, iterations=iterations, slow=slow, settle=settle, **options
    )


@pytest.fixture(scope="module")
def learnt():
    return learn()


@pytest.fixture(scope="module")
def exact():
    """The same run with an exact model of gravity."""
    return play_motions(SYSTEM, [MOTION], settle=0.5)


# ------------------------------------------------------------------------- converges


def test_iterations_converge_geometrically(learnt):
    """Each round changes the base motion by less than a third of what the one before did."""
    changes = np.array([k.change.max() for k in learnt.iterations])
    assert len(changes) == 4
    assert changes[0] > 5e-3
    assert (changes[1:] < changes[:-1] / 3).all()
    for before, after in zip(learnt.iterations, learnt.iterations[1:], strict=False):
        np.testing.assert_array_equal(after.change, np.abs(after.y - before.y).max(axis=0))
    assert learnt.aborted is None


def test_what_is_learnt_is_the_motion_under_exact_compensation(learnt, exact):
    """What is left is the dynamics of the slow phase: it falls with slow^2.

    Against the exact gravity model on the same machine, 9 mm of motion. Tolerance: a
    factor 3 to 5.5 for the 4 that twice as slow should bring.
    """
    np.testing.assert_allclose(learnt.t, exact.t, atol=1e-12)
    left = np.abs(learnt.iterations[-1].y - exact.y[0]).max()
    assert left < 0.1 * np.abs(exact.y).max()
    slower = learn(slow=8.0)
    assert 3 < left / np.abs(slower.iterations[-1].y - exact.y[0]).max() < 5.5


def test_the_gravity_model_is_not_used(learnt):
    """A wrong model and a wrong mass in it change nothing of what is learnt, to the bit."""
    wrong = GravityModel(mass=10.0, P=(0.0,) * 9)
    system = SYSTEM.replace(
        emulator=EmulatorSettings(gravity=wrong), effects=(GravityMass(error=5.0),)
    )
    got = learn(system, iterations=2)
    for a, b in zip(got.iterations, learnt.iterations, strict=False):
        np.testing.assert_array_equal(a.y, b.y)


# ---------------------------------------------------------------------------- aborts


def test_a_workspace_that_is_left_at_once_keeps_nothing():
    got = learn(SYSTEM.replace(emulator=EmulatorSettings(stewart=TINY)))
    assert got.iterations == ()
    assert got.recording is None
    assert "outside the workspace" in got.aborted.reason
    assert 0 < got.aborted.time < 1.5


@pytest.mark.parametrize("call", [2, 3], ids=["slow phase", "full speed"])
def test_a_workspace_that_is_left_later_keeps_what_was_learnt(call, monkeypatch, learnt):
    """From the second iteration on the legs reach 2 mm only: the first is kept."""
    calls = []

    def play(system, *args, **options):
        calls.append(system.emulator_settings.operation)
        if len(calls) > call:
            lab = dataclasses.replace(system.emulator_settings, stewart=TINY)
            system = system.replace(emulator=lab)
        return play_motions(system, *args, **options)

    monkeypatch.setattr(gravity_learning, "play_motions", play)
    got = learn()
    assert (
        calls
        == ["position", "microgravity"] * (call // 2)
        + ["position", "microgravity"][: call % 2 + 1]
    )
    assert len(got.iterations) == 1
    np.testing.assert_array_equal(got.iterations[0].y, learnt.iterations[0].y)
    np.testing.assert_array_equal(got.recording.y[0], got.iterations[0].y)
    assert "outside the workspace" in got.aborted.reason


# --------------------------------------------------------------------------- refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slow": np.nan}, "slow must be >= 1, got nan"),
        ({"iterations": 0}, "iterations must be >= 1, got 0"),
        ({"system": ADMITTANCE}, "needs operation microgravity, got admittance"),
        ({"system": SYSTEM.ideal()}, "mode ideal has no emulator"),
    ],
)
def test_wrong_arguments_are_refused(options, message):
    with pytest.raises(ParameterError, match=message):
        learn(**options)


# -------------------------------------------------------------------- weighing poses

ANGLES = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, -0.4], [1.0, -0.5, 0.8], [-1.0, 1.0, 0.2]])
POSES = np.zeros((4, 6))
POSES[1, 3:] = 0.05, -0.05, 0.1
POSES[2, :3] = 0.02, 0.0, -0.01
POSES[3] = -0.01, 0.02, 0.01, -0.08, 0.1, 0.0


def test_weighing_gives_the_exact_weight_on_a_clean_machine():
    """Whatever the machine does otherwise. Tolerance: the engine's 1e-5 N of 919 N."""
    lab = EmulatorSettings(operation="admittance", zero_at_start=True)
    log = weigh_poses(SYSTEM.replace(emulator=lab), ANGLES, POSES, seconds=0.2)
    want = GravityModel.of(PUMA_560).wrench(PUMA_560, ANGLES, POSES)
    np.testing.assert_allclose(log.w, want, rtol=0, atol=1e-4)
    np.testing.assert_allclose(log.y, POSES, rtol=0, atol=1e-9)
    np.testing.assert_allclose(log.q, ANGLES, rtol=0, atol=1e-9)
    assert len(log.t) == 4


def test_weighing_averages_noise_and_each_pose_has_its_own_drift():
    """Forty equal poses: the mean of 80 readings leaves a part of the noise; the drift of
    0.25 N does not average out. Tolerance: 11 % standard error of a deviation.
    """
    q, y = np.zeros((40, 3)), np.zeros((40, 6))
    quiet = SYSTEM.replace(effects=(SensorNoise(force=(2.0,) * 3),))
    spread = weigh_poses(quiet, q, y).w[:, :3].std(axis=0).mean()
    # neighbours are correlated by 0.44: the mean's variance is 1.9 times that of 80 free ones
    assert spread == pytest.approx(2.0 * np.sqrt(1.9 / 80), rel=0.25)
    drifting = SYSTEM.replace(effects=LABORATORY_ERRORS)
    w = weigh_poses(drifting, q, y, seconds=0.3).w
    assert w[:, 0].std() == pytest.approx(0.25, rel=0.4)
    np.testing.assert_array_equal(w, weigh_poses(drifting, q, y, seconds=0.3).w)
    assert (w != weigh_poses(drifting, q, y, seconds=0.3, seed=1).w).all()


def test_a_pose_out_of_reach_is_named():
    poses = POSES.copy()
    poses[2, 2] = 0.7
    with pytest.raises(
        ParameterError, match=r"pose 3: leg \d would be .*outside the workspace"
    ):
        weigh_poses(SYSTEM, ANGLES, poses, seconds=0.1)
