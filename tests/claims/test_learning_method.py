"""Claims of thesis 3.3 and 3.5: the Learning Method converges, and both methods agree.

The 180 deg shoulder turn in 2 s on the horizontal straight beam (A.3), repeated slowly 20
times slower; the sensor has gain errors, cross-talk and an arbitrary zero, unknown to it.
Bounds: 1 mm and 0.001 rad within nine iterations (Fig. 3-4).
"""

import numpy as np
import pytest

from tests.claims.test_model_method import true_sensor
from ves_gym.effects import SensorNoise
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import STRAIGHT_HORIZONTAL_THESIS
from ves_gym.simulation.gravity_learning import learn_gravity
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

pytestmark = pytest.mark.slow  # quick: tests/simulation/test_gravity_learning.py
TURN = Motion.straight(np.deg2rad([-90, 0, 0]), np.deg2rad([90, 0, 0]), 2.0)
SETTLE = 1.0  # s; it is repeated slowly as well


def emulation(*effects):
    return System(vehicle=STRAIGHT_HORIZONTAL_THESIS, mode="emulated", effects=effects)


@pytest.fixture(scope="module")
def learnt():
    system = emulation(*true_sensor())
    return learn_gravity(system, TURN, iterations=6, settle=SETTLE)


def test_converges_within_nine_iterations(learnt):
    for k in learnt.iterations:
        print(f"changed by {1e3 * k.change[:3].max():.3f} mm, {k.change[3:].max():.1e} rad")
    assert learnt.aborted is None
    assert learnt.iterations[-1].change.max() < 1e-4  # and goes on


def test_both_methods_give_the_same_base_motion(learnt):
    """Fig. 3-8's "close correlation". The Model Method here knows the weight exactly."""
    model = play_motions(emulation(), [TURN], settle=SETTLE).y[0]
    gap = learnt.iterations[-1].y - model
    for part in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(model[:, part], axis=1).max()
        print(f"methods differ by {np.linalg.norm(gap[:, part], axis=1).max() / size:.2%}")
        # a 1 % wrong calibration matrix is a 1 % wrong dynamic wrench; nothing else is left
        assert np.linalg.norm(gap[:, part], axis=1).max() < 0.03 * size


def test_noise_is_all_that_is_left():
    """3.5: unrepeatable noise cannot be learnt; the changes level off at millimetres."""
    noise = SensorNoise(force=(0.35, 0.2, 0.4), moment=(0.3, 0.3, 0.05))
    result = learn_gravity(emulation(noise), TURN, iterations=9, settle=3.0)
    last = [k.change[:3].max() for k in result.iterations[-3:]]
    print("last changes", last, "m")
    assert 1e-4 < max(last) < 5e-3
