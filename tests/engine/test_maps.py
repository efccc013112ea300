"""Compiled functions of many configurations."""

from dataclasses import replace

import numpy as np
import pytest

from tests.arms import six_joint_arm
from ves_gym.engine.kernel.maps import (
    coupling_matrices,
    motion_loads,
    pushed_modes,
    scene_function,
    weight_function,
)
from ves_gym.engine.kernel.numbers import parameters
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import newton_euler
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench, minimal_model
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.spatial import matvec, rotation
from ves_gym.mechanics.vehicle import BENT_THESIS, VEHICLES
from ves_gym.planners.coupling import coupling_matrix
from ves_gym.system.energy import base_energy
from ves_gym.system.system import System
from ves_gym.system.system_library import get_system


@pytest.mark.parametrize("vehicle", [k for k in VEHICLES if k != "servicer-flexible"])
def test_coupling_matrices_are_those_of_numpy(vehicle):
    """Reference: `coupling_matrix` on few configurations, which does not compile; of bases that
    carry bodies it never does."""
    system = System(vehicle=VEHICLES[vehicle])
    q = np.random.default_rng(0).uniform(-3, 3, (101, 3))
    expected = coupling_matrix(system, q)
    size = max(np.abs(expected).max(), 1e-300)
    np.testing.assert_allclose(coupling_matrices(system, q), expected, atol=1e-13 * size)


def test_a_result_does_not_depend_on_its_neighbours():
    system, q = System(vehicle=BENT_THESIS), np.random.default_rng(1).uniform(-3, 3, (9001, 3))
    whole = coupling_matrices(system, q)
    for i in (0, 7, 4096, 9000):
        np.testing.assert_array_equal(coupling_matrices(system, q[i : i + 1])[0], whole[i])


@pytest.mark.usefixtures("no_compiler")
def test_without_a_compiler_the_graph_is_interpreted():
    system, q = System(vehicle=BENT_THESIS), np.random.default_rng(4).uniform(-3, 3, (11, 3))
    expected = coupling_matrix(system, q)  # few, in NumPy
    np.testing.assert_allclose(coupling_matrices(system, q), expected, rtol=1e-12, atol=1e-12)


# ----------------------------------------------------------------------------- weight


@pytest.mark.parametrize("arm", [PUMA_560, six_joint_arm()], ids=["three", "six"])
def test_a_weight_is_that_of_numpy(arm):
    """Reference: `gravity_wrench`; whatever the number of questions and their neighbours."""
    rng, size = np.random.default_rng(5), minimal_model(arm).size
    weight = weight_function(arm)
    for count in (3, 40, 11):
        q, y = rng.uniform(-2, 2, (count, arm.n)), rng.uniform(-0.3, 0.3, (count, 6))
        mass, P = rng.uniform(50, 90, count), rng.normal(0, 5, (count, size))
        found = weight(q, y, mass[:, None], P)
        expected = gravity_wrench(arm, q, gravity_vector(y), mass, P)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        alone = weight(q[2:3], y[2:3], mass[2:3, None], P[2:3])
        np.testing.assert_array_equal(alone[0], found[2])


# ------------------------------------------------------------------------------ modes

N = 4001


def matrices(kind):
    """Stiffness (k, k), masses (N, k, k) and vectors (N, k, 3) of a kind."""
    rng, k = np.random.default_rng(4), {"twelve": 12, "more": 13}.get(kind, 6)
    root, roots = rng.normal(size=(k, k)), rng.normal(size=(N, k, k))
    K, M = root @ root.T, 0.1 * roots @ np.swapaxes(roots, -1, -2) + np.eye(k)
    if kind == "graded":  # frequencies a factor of 100 apart
        size = 10.0 ** np.linspace(-1, 1, 6)
        K = K * size * size[:, None]
    elif kind == "alike":  # two pairs of equal frequencies
        turn, _ = np.linalg.qr(root)
        K = turn @ np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 5.0]) @ turn.T
        K, M = (K + K.T) / 2, np.broadcast_to(np.eye(6), M.shape)
    elif kind == "free":
        K = np.zeros((6, 6))
    return K, M, rng.normal(size=(N, k, 3))


@pytest.mark.parametrize("kind", ["plain", "graded", "alike", "free", "twelve", "more"])
def test_modes_are_those_of_lapack(kind):
    """Frequencies, and b^T f(modes) b for a smooth f, which no order or sign changes.

    Tolerance: rounding times the ratio of the largest to the smallest omega^2 that counts.
    """
    K, M, b = matrices(kind)
    omega, pushed = pushed_modes(K, M, b)
    wanted, shapes = natural_modes(K, M)
    size = wanted.max() or 1.0
    np.testing.assert_allclose(np.sort(omega, axis=1) ** 2, wanted**2, atol=1e-13 * size**2)

    def energy(omega, g):
        return np.einsum("nkc,nk,nkd->ncd", g, 1 / (size**2 + omega**2), g)

    expected = energy(wanted, np.swapaxes(shapes, -1, -2) @ b)
    np.testing.assert_allclose(
        energy(omega, pushed), expected, atol=1e-12 * np.abs(expected).max()
    )


@pytest.mark.parametrize("arm", [PUMA_560, six_joint_arm()], ids=["three", "six"])
def test_loads_of_a_motion_are_those_of_newton_and_euler(arm):
    """Arms that differ in masses share the code; leading axes are kept."""
    rng, n = np.random.default_rng(6), arm.n
    motion = [rng.normal(size=(2, 9, k)) for k in (n, n, n, 3, 3, 3)]
    q, v, a, spin, turn, accel = motion
    heavy = replace(arm.links[-1], inertial=arm.links[0].inertial, rotor_inertia=2.0)
    for each in (arm, replace(arm, links=(*arm.links[:-1], heavy))):
        expected = newton_euler(each, q, v, a, spin=spin, turn=turn, accel=accel)
        for ours, wanted in zip(motion_loads(each, *motion), expected, strict=True):
            np.testing.assert_allclose(ours, wanted, rtol=1e-12, atol=1e-10)


# ------------------------------------------------------------------------------ scenes


def test_a_scene_of_an_arm_that_bends_takes_its_flexures():
    """Reference: `base_energy` and the tool of the chain with a joint for each flexure."""
    system = get_system("macro-micro-braked").ideal()
    rng, n, p = np.random.default_rng(7), system.arm.n, system.arm.bends
    q, v = rng.normal(size=(2, 5, n))
    y, yd, measured = 0.1 * rng.normal(size=(3, 5, 6))
    u, ud = 1e-3 * rng.normal(size=(2, 5, p))
    z, zd = np.hstack([y, q]), np.hstack([yd, v])
    out = scene_function(system)(z, zd, measured, u, ud, parameters(system)[1])
    energies, tool, tool_measured = np.split(out, [2, 5], axis=1)
    expected = base_energy(system, q, y, yd, (u, ud))
    np.testing.assert_allclose(energies[:, 0], expected.total, rtol=1e-10)
    np.testing.assert_allclose(energies[:, 1], expected.strain, rtol=1e-10)
    chain = expand(system.arm)
    joints = np.zeros((5, n + p))
    joints[:, chain.driven], joints[:, chain.passive] = q, u
    reach = joint_positions(chain.arm, joints)[:, -1]
    for place, pose in ((tool, y), (tool_measured, measured)):
        np.testing.assert_allclose(
            place, pose[:, :3] + matvec(rotation(pose), reach), atol=1e-12
        )
