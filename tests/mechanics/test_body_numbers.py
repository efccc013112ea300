"""The ten numbers of a rigid body, and which ten a body can have."""

import numpy as np
import pytest

from tests.effects.values import effect
from ves_gym._util.params import ParameterError
from ves_gym.effects import GravityTool, PayloadBody, PayloadMass
from ves_gym.mechanics.body_numbers import (
    is_body,
    nearest_body,
    numbers_of_moments,
    pseudo_inertia,
)
from ves_gym.mechanics.gravity import minimal_model
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.emulator_settings import EmulatorSettings
from ves_gym.system.system import System

ARM = System().arm
MASSES = np.array([0.5, 1.0, 0.25, 2.0])
PLACES = np.array([[0.1, 0, 0.2], [0, -0.3, 0.1], [0.2, 0.1, 0], [-0.1, 0.1, 0.3]])


def of_points(masses, places):
    """Ten numbers of point masses: sums of m, m r and m (r.r 1 - r r^T)."""
    about = sum(
        m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, places, strict=True)
    )
    six = [about[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    return np.array([masses.sum(), *masses @ places, *six])


def test_second_moments_are_those_of_point_masses():
    numbers = of_points(MASSES, PLACES)
    points = np.column_stack([PLACES, np.ones(4)])
    np.testing.assert_allclose(
        pseudo_inertia(numbers), (points.T * MASSES) @ points, atol=1e-14
    )
    np.testing.assert_allclose(numbers_of_moments(pseudo_inertia(numbers)), numbers, atol=1e-14)
    assert is_body(numbers) and not is_body(numbers - 0.2 * np.eye(10)[4])


def test_what_a_body_can_have_is_left_alone_and_the_rest_put_to_the_most_probable():
    """Reference: no other body of many is nearer by the same measure."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(10, 10))
    precision = root @ root.T + np.eye(10)
    numbers = of_points(MASSES, PLACES)
    np.testing.assert_allclose(nearest_body(numbers, precision, np.eye(10)), numbers, atol=1e-6)
    spoilt = numbers - 0.4 * np.eye(10)[9]
    found = nearest_body(spoilt, precision, np.eye(10))
    assert is_body(found)

    def miss(x):
        return (x - spoilt) @ precision @ (x - spoilt)

    J = pseudo_inertia(found)
    for size in (1e-3, 1e-2, 1e-1):
        for _ in range(30):
            other = J + size * (lambda a: a @ a.T - np.diag(rng.random(4)))(
                rng.normal(size=(4, 4)) / 2
            )
            if np.linalg.eigvalsh(other)[0] > 1e-5:
                assert miss(numbers_of_moments(other)) > miss(found) * (1 - 1e-3)


def test_a_precision_that_rounding_made_indefinite_still_gives_a_body():
    """Ten numbers of which the data tell six: an inverse may have negative parts."""
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((10, 6)) * np.logspace(0, 4, 10)[:, None]
    precision = columns @ columns.T - 1e-9 * np.diag(np.logspace(0, 8, 10))
    assert np.linalg.eigvalsh(precision)[0] < 0
    numbers = of_points(MASSES, PLACES)
    found = nearest_body(numbers, precision, np.eye(10))
    assert is_body(found)
    np.testing.assert_allclose(columns.T @ found, columns.T @ numbers, rtol=1e-3)


def test_a_body_of_one_point_is_a_mass_there():
    mass, place = 2.0, (0.05, 0.0, 0.1)
    ten = of_points(np.array([mass]), np.array([place]))
    body = PayloadBody(mass=mass, moment=tuple(ten[1:4]), inertia=tuple(ten[4:]))
    a, b = (
        e.arm(ARM).links[-1].inertial for e in (body, PayloadMass(mass=mass, position=place))
    )
    assert a.mass == b.mass and a.com == pytest.approx(b.com, abs=1e-15)
    np.testing.assert_allclose(a.inertia, b.inertia, atol=1e-14)


def test_numbers_that_no_body_has_are_refused():
    with pytest.raises(ParameterError, match="rigid body"):
        PayloadBody(mass=1.0, moment=(0.5, 0.0, 0.0))


def test_an_estimate_without_a_tool_is_that_of_the_arm_without_it():
    tool = effect("payload/body")
    emulator = EmulatorSettings()
    p = LoopParameters.nominal(tool.arm(ARM), emulator, 1)
    GravityTool(mass=tool.mass, moment=tool.moment).edit(p)
    assert p.gravity_mass == pytest.approx(ARM.mass)
    np.testing.assert_allclose(p.gravity_P[0], minimal_model(ARM).parameters(), atol=1e-12)
