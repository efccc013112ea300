"""The equations of motion, run on numbers, against MuJoCo: what is traced is this text."""

import numpy as np
import pytest

import ves_gym as vg
from ves_gym.engine.kernel.numbers import model_of
from ves_gym.mechanics.equations import motion

N = 16


@pytest.mark.parametrize("vehicle", ["bent-thesis", "decoupled", "free-floating"])
@pytest.mark.parametrize("arm", ["puma560", "ur5e"])
def test_accelerations_are_those_of_mujoco(vehicle, arm):
    """States at random; 1e-9 relative is rounding through two solves of one mass matrix."""
    system = vg.System(arm=vg.mechanics.get_arm(arm), vehicle=vg.get_vehicle(vehicle))
    n, rng = system.arm.n, np.random.default_rng(0)
    q, v, command = rng.uniform(-1, 1, (3, N, n))
    y, yd = 0.1 * rng.uniform(-1, 1, (2, N, 6))
    sim = vg.Simulator(system, N, servo=None, backend="mujoco")
    sim.reset(q=q, v=v, y=y, yd=yd)
    _, expected = sim.backend.evaluate(command)
    x = np.concatenate([y, q, yd, v], axis=1)
    found = motion(model_of(system), x, np.concatenate([np.zeros((N, 6)), command], axis=1))
    assert found.acceleration == pytest.approx(expected, rel=1e-9, abs=1e-9)
