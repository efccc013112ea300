"""Claims of thesis 3.2.2 and 3.2.3: how errors of the gravity estimate move the base.

Reference: the same emulation without the error. The arm turns its shoulder by 180 deg in
2 s (thesis A.5).
"""

import numpy as np
import pytest

from ves_gym.effects import GravityScale, SensorBias
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import BENT_THESIS, STRAIGHT_HORIZONTAL_THESIS
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

TURN = Motion.straight(np.deg2rad([-90, 0, 0]), np.deg2rad([90, 0, 0]), 2.0)


def base(vehicle, *effects):
    system = System(vehicle=vehicle, mode="emulated", effects=effects)
    run = play_motions(system, [TURN], settle=8.0)
    assert not run.events
    return run.y[0]


@pytest.fixture(scope="module")
def straight():
    return base(STRAIGHT_HORIZONTAL_THESIS)


@pytest.mark.parametrize(("error", "least"), [(0.005, 5.0), (0.01, 10.0)])
def test_small_gravity_errors_hide_the_vertical_motion(straight, error, least):
    """Fig. 3-2 shows z: at 1 % its error is several times the true motion (13 here)."""
    wrong = base(STRAIGHT_HORIZONTAL_THESIS, GravityScale(error=error)) - straight
    print(error, np.abs(wrong[:, 2]).max(), np.abs(straight[:, 2]).max(), "m in z")
    assert np.abs(wrong[:, 2]).max() > least * np.abs(straight[:, 2]).max()


def test_one_percent_moves_the_base_more_than_the_arm_does(straight):
    wrong = base(STRAIGHT_HORIZONTAL_THESIS, GravityScale(error=0.01)) - straight
    true = np.linalg.norm(straight[:, :3], axis=1).max()
    assert np.linalg.norm(wrong[:, :3], axis=1).max() > 1.5 * true


@pytest.mark.parametrize("vehicle", [BENT_THESIS])
def test_one_newton_keeps_the_motion_accurate_to_a_few_percent(vehicle):
    """3.2.3: 1 N and 1.5 N m, in the direction (1, 1, 1), on the thesis's bent beam."""
    side = 1 / np.sqrt(3)
    bias = SensorBias(force=(side,) * 3, moment=(1.5 * side,) * 3)
    true = base(vehicle)
    wrong = base(vehicle, bias) - true
    for part in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(true[:, part], axis=1).max()
        print(f"{np.linalg.norm(wrong[:, part], axis=1).max() / size:.1%} of the bent beam's")
        assert np.linalg.norm(wrong[:, part], axis=1).max() < 0.04 * size


def test_one_newton_is_too_much_on_the_straight_beam(straight):
    """The other side: on the softer beam the same error is a sixth of the motion."""
    side = 1 / np.sqrt(3)
    bias = SensorBias(force=(side,) * 3, moment=(1.5 * side,) * 3)
    wrong = base(STRAIGHT_HORIZONTAL_THESIS, bias) - straight
    size = np.linalg.norm(straight[:, :3], axis=1).max()
    print(f"{np.linalg.norm(wrong[:, :3], axis=1).max() / size:.1%} of the straight beam's")
    assert np.linalg.norm(wrong[:, :3], axis=1).max() > 0.1 * size
