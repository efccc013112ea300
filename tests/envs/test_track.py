"""The task track: a path in space, on a base that flexes."""

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.runs import EMULATED, Blind, controlled, unscaled
from ves_gym.baselines.registry import get_controller
from ves_gym.baselines.resolved import Resolved
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.tool_pose import joints_for

# ----------------------------------------------------------------------------- paths


def test_paths_are_closed_smooth_and_within_reach():
    """40 paths: every point reached within the joint limits, at rest at both ends."""
    env = VesVectorEnv(40, "track")
    env.reset(seed=0)
    task, scene = env.task, env.batch.scene
    arm, dt = task.system.arm, task.system.control_dt
    path = task.path(scene)
    np.testing.assert_allclose(path[:, 0], scene.tool, atol=1e-12)
    np.testing.assert_allclose(path[:, -1], path[:, 0], atol=1e-9)
    speed = np.linalg.norm(np.diff(path, axis=1), axis=2) / dt
    assert speed[:, [0, -1]].max() < 1e-3
    assert np.abs(np.diff(speed, axis=1)).max() / dt < 10.0  # m/s^2
    size = np.ptp(path, axis=1).max(axis=1)
    print(f"size {size.min():.2f} to {size.max():.2f} m, at most {speed.max():.2f} m/s")
    assert size.min() > 0.05 and size.max() < 1.0
    q = scene.q
    for step in range(0, task.steps + 1, 24):  # joint angles from point to point
        before, (q, miss) = q, joints_for(arm, path[:, step], q)
        assert miss.max() < 1e-6
        rate = np.abs(q - before) / (24 * dt)
        assert (rate <= 1.01 * task.pace * arm.column("v_max")).all()


def test_the_energy_scale_is_that_of_the_motion():
    """`motion_energy` within a factor of 2.5 of what tracking the path leaves (E_mean)."""
    env, *_, info = controlled(Blind(), 100, "track")
    ratio = info["energy/E_mean"] / env.batch.scene.goal[:, 0]
    print(f"median {np.median(ratio):.2f}, {ratio.min():.2f} to {ratio.max():.2f}")
    assert (np.abs(np.log(ratio)) < np.log(2.5)).mean() >= 0.95


# ----------------------------------------------------------------------- observation


@pytest.mark.parametrize("settings", [{}, EMULATED])
def test_observation_previews_the_path(settings):
    env = VesVectorEnv(4, "track", **settings)
    env.reset(seed=0)
    for _ in range(30):
        observation = env.step(np.full((4, 3), 0.1))[0]
    task, scene = env.task, env.batch.scene
    seen = unscaled(task, observation)
    ahead = task.path(scene)[:, [30, 38, 46, 62]] - scene.tool_seen[:, None]
    np.testing.assert_allclose(seen["path"].reshape(4, 4, 3), ahead, atol=1e-6)
    np.testing.assert_allclose(seen["time_left"][:, 0], 6.0 - scene.time, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(seen["phase"], axis=1), 1, rtol=1e-6)


# ---------------------------------------------------------------------------- reward


def test_the_error_is_the_logarithm_of_the_distance():
    """At rest at the start: the path's distance from its first point."""
    env, _, costs, info = controlled(get_controller("zero"), 4, "track")
    task, path = env.task, env.task.path(env.batch.scene).copy()
    away = np.linalg.norm(path[:, 1:] - path[:, :1], axis=2)
    near = task.tolerance
    expected = (np.log1p(away / near) / np.log1p(task.far / near)).mean(axis=1)
    np.testing.assert_allclose(costs["error"], expected, rtol=1e-9)
    np.testing.assert_allclose(
        env.batch.scene.memory[:, 1], (away**2).mean(axis=1) * task.duration, rtol=1e-9
    )
    assert not info["success"].any()  # closed: the tool is at the path's end


# -------------------------------------------------------------------------- what is solved


def test_resolved_motion_solves_it():
    """50 episodes: at least 95 %, the error below a quarter of that of the blind plan."""
    errors = []
    for controller in (Resolved(), Blind()):
        env, *_, info = controlled(controller, 50, "track")
        errors.append(np.sqrt(env.batch.scene.memory[:, 1] / env.task.duration))
        if controller.name == "resolved":
            assert info["success"].mean() >= 0.95
            np.testing.assert_array_equal(info["success"], errors[0] <= env.task.tolerance)
            np.testing.assert_array_equal(info["success_once"], info["success"])
    ours, blind = (1e3 * np.median(e) for e in errors)
    print(f"median rms {ours:.2f} mm, blind {blind:.2f} mm")
    assert ours < 0.25 * blind


# ------------------------------------------------------------------------------ options


def test_start_can_be_chosen_even_at_a_limit():
    """Paths keep five degrees from the limits, or stay where they are."""
    env = gym.make("ves/PumaTrack-v0").unwrapped
    arm = env.task.system.arm
    for q in ([0.1, 0.2, -0.9], arm.column("q_max") - [0.1, 0.2, 0.05]):
        env.reset(seed=0, options={"q": q})
        scene = env.batch.scene
        np.testing.assert_array_equal(scene.q[0], q)
        path = env.task.path(scene)[0]
        np.testing.assert_allclose(path[0], scene.tool[0], atol=1e-12)
        found, miss = joints_for(arm, path[::20], np.tile(q, (len(path[::20]), 1)))
        assert miss.max() < 1e-6
        assert (found <= np.maximum(arm.column("q_max") - np.deg2rad(5), q) + 1e-6).all()
