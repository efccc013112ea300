"""The task damp: a displaced base, damped by moving the arm."""

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from tests.envs.runs import EMULATED, controlled, unscaled
from ves_gym._util.params import ParameterError
from ves_gym.baselines.registry import get_controller
from ves_gym.engine.linear import linearise_ideal
from ves_gym.envs.build import build_task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.spatial import quadratic
from ves_gym.mechanics.vehicle import DECOUPLED

CONTROLS = ("torque", "pd_gains", "acceleration")
# the beam of the docstring's numbers
THESIS = {"system": {"vehicle": "bent-thesis", "physics_dt": 2.5e-3}}


class Feedback:
    """LQR for the energy of the base, linearised at home; saturates at the action's bounds."""

    def reset(self, env, ids):
        task = env.task
        system, home, joints = task.system.ideal(), np.asarray(task.home), slice(6, 9)
        plant = linearise_ideal(system, home, servo=task.control.servo)
        A, B = plant.discretise(system.control_dt)
        shift, rate = task._modes
        Q = np.zeros((18, 18))
        Q[:6, :6], Q[9:15, 9:15] = shift @ shift.T, rate @ rate.T
        Q[joints, joints], Q[15:, 15:] = 3.0 * np.eye(3), 0.1 * np.eye(3)
        R = 3e-4 * np.eye(3)
        P = solve_discrete_are(A, B, Q, R)
        self.gain = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)

    def act(self, env, observation):
        s, task = env.batch.scene, env.task
        x = np.concatenate([s.y_seen, s.q - np.asarray(task.home), s.yd_seen, s.v], axis=1)
        full = task.control.torque(np.ones((1, 3)), task.system.arm)
        return np.clip(-x @ self.gain.T / full, -1, 1)


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
    assert s.goal[0, 3] == pytest.approx(s.strain[0])
    before = env.snapshot()[0][1][1].number.copy()
    for options, why in (
        ({"y": np.zeros(6)}, "must strain the base"),
        ({"q": [3.0, 0, 0]}, "joint 1 must be within"),
        ({"goal": [0, 0, 0]}, "unknown option 'goal'; known: index, q, y"),
    ):
        with pytest.raises(ParameterError, match=why):
            env.reset(options=options)
    assert env.snapshot()[0][1][1].number == before


def test_what_does_not_fit_is_refused():
    for settings, why in (
        ({"control": "guided"}, "control must be torque or pd_gains or acceleration"),
        ({"vehicle": "free-floating"}, "positive definite stiffness, got Satellite"),
        ({"home": [3.0, 0, 0]}, "must start within the joint limits"),
        ({"energy": 0.0}, "energy"),
    ):
        with pytest.raises(ParameterError, match=why):
            build_task("damp", **settings)
    assert build_task("damp", vehicle=DECOUPLED).system.vehicle is DECOUPLED


# ------------------------------------------------------------------ reward and ends


def test_reward_is_minus_the_strain_integral():
    """Terms sum exactly; the integral by rectangles meets `E_int` by trapezoids."""
    env, total, terms, info = controlled(get_controller("random"), 8, "damp", duration=2.0)
    assert set(terms) == {"energy", "astray", "failure"}
    np.testing.assert_allclose(sum(terms.values()), total, rtol=1e-12)
    E = info["energy/E_int"] / 25.0
    np.testing.assert_allclose(-terms["energy"], E, atol=0.5 * env.batch.dt + 2e-3)


def test_leaving_the_box_costs_and_the_limit_fails():
    env = gym.make("ves/PumaDamp-v0")
    env.reset(seed=0, options={"q": np.deg2rad([45.0, 105.0, 0.0])})  # 45 deg beyond the box
    astray = []
    for _ in range(80):
        _, _, terminated, _, info = env.step([0, 1, 0])
        astray.append(info["reward/astray"])
        if terminated:
            break
    assert terminated and info["reward/failure"] == -2
    expected = -0.2 * 0.0125 * np.deg2rad(45.0)
    assert astray[0] == pytest.approx(expected, rel=0.01)
    assert (np.diff(astray) < 0).all()


# --------------------------------------------------------------------- what it takes


@pytest.mark.parametrize("settings", [THESIS, {**THESIS, **EMULATED, "randomize": {}}])
def test_feedback_damps_better_than_gains(settings):
    """Strain integrals over those of the high gains, 24 starts; docstring: 0.60, 0.99."""
    held = dict(control="pd_gains", **settings)
    high = controlled(get_controller("high"), 24, "damp", **held)[3]
    pped = controlled(get_controller("pped"), 24, "damp", **held)[3]
    _, total, _, best = controlled(Feedback(), 24, "damp", **settings)
    E = [info["energy/E_int"].sum() for info in (best, pped, high)]
    solved = [info["success"].mean() for info in (best, high)]
    print(f"over high gains: feedback {E[0] / E[2]:.3f}, pped {E[1] / E[2]:.3f}", solved)
    assert E[0] < 0.65 * E[2]
    assert 0.9 * E[2] < E[1] < 1.05 * E[2]
    assert solved[0] > solved[1] + 0.2
    assert (total > -1).all()
