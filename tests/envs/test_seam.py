"""The task seam: a line or an arc in space, on a boom that sways."""

import numpy as np
import pinocchio as pin
import pytest

from tests.envs.runs import Blind, controlled
from ves_gym.baselines.resolved import Resolved, base_torque
from ves_gym.engine.mjcf import TO_Y
from ves_gym.envs.build import build_task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.mechanics.arm_files import pinocchio_model
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.spatial import quadratic
from ves_gym.mechanics.tool_pose import joints_for
from ves_gym.mechanics.vehicle import VEHICLES


@pytest.fixture(scope="module")
def forty():
    env = VesVectorEnv(40, "seam")
    env.reset(seed=0)
    return env


def test_seams_are_lines_and_arcs_within_reach(forty):
    """40 seams, at rest at both ends; every point reached with the boom at rest."""
    task, scene = forty.task, forty.batch.scene
    path, dt = task.path(scene), task.system.control_dt
    np.testing.assert_allclose(path[:, 0], scene.tool, atol=1e-12)
    steps = np.linalg.norm(np.diff(path, axis=1), axis=2)
    assert steps[:, [0, -1]].max() / dt < 1e-3
    middle, chord = path[:, task.steps // 2], path[:, -1] - path[:, 0]
    length, straight = steps.sum(axis=1), np.linalg.norm(chord, axis=1)
    lines = straight > (1 - 1e-9) * length
    assert 0.25 < lines.mean() < 0.75
    aside = np.linalg.norm(np.cross(middle - path[:, 0], chord), axis=1) / straight
    assert aside[lines].max() < 1e-9 < aside[~lines].min()
    print(f"length {length.min():.2f} to {length.max():.2f} m")
    assert length.max() < 0.6
    rest = path - scene.y[:, None, :3]  # about where the boom comes to
    q = scene.q
    for step in range(0, task.steps + 1, 96):
        q, miss = joints_for(task.system.arm, rest[:, step], q)
        assert miss.max() < 2e-3


def test_the_boom_is_released_with_the_stated_energy(forty):
    task, scene = forty.task, forty.batch.scene
    held = quadratic(task.system.base.K, scene.y)
    np.testing.assert_allclose(held, task.energy, rtol=1e-9)
    np.testing.assert_allclose(scene.strain, task.energy, rtol=1e-9)
    assert np.ptp(scene.y[:, :3], axis=0).min() > 5e-3


def test_the_plan_without_the_boom_is_not_enough():
    """The same controller blind to the boom's motion: most seams are missed."""

    assert controlled(Blind(), 40, "seam")[3]["success"].mean() < 0.2


def test_it_takes_any_base_that_holds():
    task = build_task("seam", vehicle="bent")
    assert task.system.vehicle == VEHICLES["bent"]


@pytest.mark.slow
def test_soft_servos_are_braced():
    """The UR5e on its 2 Hz servos: resolved motion alone is pushed aside by the boom."""
    braced, bare = (
        controlled(controller, 20, "seam", arm="ur5e")[3]["success"].mean()
        for controller in (Resolved("braced", braced=True), Resolved())
    )
    assert braced >= 0.95 > 0.6 > bare


def test_the_torque_of_a_moving_base_is_pinocchios():
    arm = get_arm("iiwa14")
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-1, 1, (2, arm.n))
    y, yd, ydd = rng.uniform(-0.5, 0.5, (3, 6))
    zero = np.zeros((6, 6))
    model = pinocchio_model(arm, BaseModel(zero, zero, zero))
    data = model.createData()
    at = [np.r_[part[TO_Y], own] for part, own in ((y, q), (yd, v), (ydd, 0 * v))]
    still = [np.r_[0 * part[TO_Y], own] for part, own in ((y, q), (yd, v), (ydd, 0 * v))]
    expected = pin.rnea(model, data, *at)[6:] - pin.rnea(model, data, *still)[6:]
    found = base_torque(arm, q[None], v[None], y[None], yd[None], ydd[None])[0]
    assert found == pytest.approx(expected, abs=1e-10)
