"""Compiled functions of many configurations."""

import numpy as np
import pytest

from ves_gym.engine.kernel import build, maps
from ves_gym.engine.kernel.maps import coupling_matrices
from ves_gym.mechanics.vehicle import VEHICLES
from ves_gym.planners.coupling import coupling_matrix
from ves_gym.system.system import System


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_coupling_matrices_are_those_of_numpy(vehicle):
    """Reference: `coupling_matrix` on few configurations, which does not compile."""
    system = System(vehicle=VEHICLES[vehicle])
    q = np.random.default_rng(0).uniform(-3, 3, (101, 3))
    expected = coupling_matrix(system, q)
    size = max(np.abs(expected).max(), 1e-300)
    np.testing.assert_allclose(coupling_matrices(system, q), expected, atol=1e-13 * size)


def test_an_emulated_system_couples_as_the_vehicle_it_emulates():
    system, q = System(mode="emulated"), np.random.default_rng(3).uniform(-3, 3, (2000, 3))
    few = coupling_matrix(system, q[:5])
    np.testing.assert_allclose(coupling_matrix(system, q)[:5], few, rtol=1e-9, atol=1e-9)
    assert np.abs(few).max() > 1  # J/rad^2


def test_a_result_does_not_depend_on_its_neighbours():
    system, q = System(), np.random.default_rng(1).uniform(-3, 3, (9001, 3))
    whole = coupling_matrices(system, q)
    for i in (0, 7, 4096, 9000):
        np.testing.assert_array_equal(coupling_matrices(system, q[i : i + 1])[0], whole[i])


def test_many_configurations_are_compiled_in_any_shape():
    system, q = System(), np.random.default_rng(2).uniform(-3, 3, (40, 50, 3))
    found = coupling_matrix(system, q)
    assert found.shape == (40, 50, 3, 3)
    np.testing.assert_allclose(found[3, 4], coupling_matrix(system, q[3, 4]), rtol=1e-12)


def test_without_a_compiler_numpy_answers(monkeypatch, tmp_path):
    def broken(text):
        raise RuntimeError("no LLVM")

    monkeypatch.setenv("VES_GYM_CACHE", str(tmp_path))
    monkeypatch.setattr(build, "compile_text", broken)
    monkeypatch.setattr(maps, "_LIBRARIES", {})
    system, q = System(), np.zeros((2000, 3))
    assert coupling_matrices(system, q) is None
    assert coupling_matrix(system, q).shape == (2000, 3, 3)
