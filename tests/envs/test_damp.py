"""The task damp: a displaced base, damped by moving the arm."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.runs import controlled, unscaled
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.spatial import quadratic

CONTROLS = ("torque", "pd_gains", "acceleration")
# the beam of the docstring's numbers
THESIS = {"system": {"vehicle": "bent-thesis", "physics_dt": 2.5e-3}}


# ------------------------------------------------------------------------- contract


# Largest share of clipped values in a column. The finite-element beam's flange is light and
# shakes faster than the observed modes, whose internal ones follow the pose: under random
# actions 1.7 % of the energies of its fourth mode are clipped, nothing else.
CLIPPED = {"bent-thesis": 0.0, "bent": 0.02}


# ----------------------------------------------------------------------- beginnings


def test_the_base_starts_with_the_stated_strain_energy():
    """E(0) = 1/2 Y'KY = 25 J, Y' = 0, the displacement anywhere on the sphere."""
    env = VesVectorEnv(500, "damp")
    env.reset(seed=0)
    s, K = env.batch.scene, env.task.system.base.K
    np.testing.assert_allclose(quadratic(K, s.y), 25.0, rtol=1e-12)
    np.testing.assert_allclose(s.strain, 25.0, rtol=1e-9)
    np.testing.assert_allclose(s.energy, 25.0, rtol=1e-9)
    assert not s.yd.any() and not s.v.any() and not s.y[:, 3:].any()
    along = s.y[:, :3] / np.linalg.norm(s.y, axis=1)[:, None]
    np.testing.assert_allclose(along.mean(axis=0), 0, atol=0.1)  # 4 / sqrt(3 * 500)
    np.testing.assert_allclose((along**2).mean(axis=0), 1 / 3, atol=0.06)
    reach = np.abs(np.rad2deg(s.q) - [45, 0, 0]).max(axis=0)
    assert ((reach > 29) & (reach <= 30)).all()


# In motion the internal modes of the finite-element beam do not quite follow the pose, as the
# observed modes assume: these miss up to 18.2 % of E.
@pytest.mark.parametrize(("vehicle", "missed"), [("bent-thesis", 0.03), ("bent", 0.19)])
def test_modes_observed_hold_the_energy(vehicle, missed):
    """At rest their strain is the base's, anywhere; in motion at home they hold E nearly."""
    home = np.tile(np.deg2rad([45.0, 0, 0]), (8, 1))
    env = VesVectorEnv(8, "damp", vehicle=vehicle, control="pd_gains")
    observation, _ = env.reset(seed=0, options={"q": home})
    seen = unscaled(env.task, observation)
    np.testing.assert_allclose((seen["mode_shift"] ** 2).sum(axis=1), 25.0, rtol=1e-5)
    assert not seen["mode_rate"].any()
    for _ in range(40):
        observation = env.step(np.ones((8, 6)))[0]  # stiffest gains
    seen, s = unscaled(env.task, observation), env.batch.scene
    parts = seen["mode_shift"] ** 2 + seen["mode_rate"] ** 2
    np.testing.assert_allclose(seen["mode_energy"], parts, atol=1e-5)
    np.testing.assert_allclose(seen["mode_energy"].sum(axis=1), s.energy, rtol=missed)


def test_options_choose_the_start():
    env = gym.make("ves/PumaDamp-v0").unwrapped
    env.reset(seed=0, options={"q": [0.5, 0.1, 0], "y": [0.1, 0.1, 0.1, 0, 0, 0]})
    s = env.batch.scene
    np.testing.assert_array_equal(s.q[0], [0.5, 0.1, 0])
    assert s.strain[0] == pytest.approx(82.3, abs=0.05)  # THEORY.md: thesis 4.3.2


# ------------------------------------------------------------------ reward and ends


def test_the_cost_is_the_strain_integral():
    """By rectangles, in that of locked joints; it meets `E_int` by trapezoids."""
    env, _, costs, info = controlled(get_controller("random"), 8, "damp", duration=2.0)
    assert set(costs) == {"energy", "astray"}
    locked = env.batch.scene.goal[:, 3]
    E, missed = info["energy/E_int"] / locked, 25.0 * env.batch.dt / locked
    np.testing.assert_allclose(costs["energy"], E, atol=missed.max())


def test_leaving_the_box_costs_and_the_limit_fails():
    env = gym.make("ves/PumaDamp-v0")
    env.reset(seed=0, options={"q": np.deg2rad([45.0, 105.0, 0.0])})  # 45 deg beyond the box
    astray = []
    for _ in range(80):
        _, _, terminated, _, info = env.step([0, 1, 0])
        astray.append(info["reward/astray"])
        if terminated:
            break
    assert terminated and info["reward/failure"] < -0.5
    expected = -0.2 * 0.0125 * np.deg2rad(45.0)
    assert astray[0] == pytest.approx(expected, rel=0.02)
    assert max(astray) < 0
