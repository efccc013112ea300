"""The compiled metrics are the coupling matrices, and lengths are their integrals."""

import dataclasses

import numpy as np
import pytest

from tests.arms import six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    STRAIGHT_VERTICAL_THESIS,
)
from ves_gym.planners.coupling import blocks, metric
from ves_gym.planners.metric import LEAST, Metric
from ves_gym.system.system import System

CONSISTENT = dataclasses.replace(BENT_THESIS, mass_model="consistent")  # modes to 14 Hz


def configurations(system, count=40):
    rng = np.random.default_rng(0)
    arm = system.arm
    q = rng.uniform(arm.column("q_min"), arm.column("q_max"), (count, arm.n))
    return q, rng.normal(size=(count, arm.n))


def least(m):
    """The share added to every direction, from a form without it."""
    return m._p[-1]


@pytest.mark.parametrize("arm", [None, six_joint_arm()], ids=["three joints", "six"])
@pytest.mark.parametrize(
    "vehicle", [BENT_THESIS, CONSISTENT, STRAIGHT_VERTICAL_THESIS, DECOUPLED]
)
@pytest.mark.parametrize("duration", [None, 0.5, 2.0, 4.0])
def test_compiled_forms_are_those_of_the_matrices(vehicle, duration, arm):
    """Another eigenvalue method (Jacobi against LAPACK): 1e-9 relative.

    The straight beam's modes spread over four decades of frequency squared.
    """
    system = System(vehicle=vehicle) if arm is None else System(vehicle=vehicle, arm=arm)
    q, dq = configurations(system)
    m = Metric(system, "q" if duration is None else "qt", duration)
    expected = np.einsum("ki,kij,kj->k", dq, metric(system, q, duration), dq)
    expected += least(m) * np.sum(dq**2, axis=1)
    np.testing.assert_allclose(m.squares(q, dq), expected, rtol=1e-9)


def test_disturbance_is_the_rotation_of_a_free_base():
    system = System(vehicle=FREE_FLOATING)
    q, dq = configurations(system)
    b = blocks(system, q)
    turn = np.einsum("kij,kj->ki", np.linalg.solve(b.Mt, b.Hbm), dq)[:, 3:]
    m = Metric(system, "disturbance")
    expected = np.sum(turn**2, axis=1) + least(m) * np.sum(dq**2, axis=1)
    np.testing.assert_allclose(m.squares(q, dq), expected, rtol=1e-12)


@pytest.mark.parametrize(("kind", "duration"), [("q", None), ("qt", 2.0)])
def test_a_base_without_stiffness_is_measured_by_its_kinetic_energy(kind, duration):
    system = System(vehicle=FREE_FLOATING)
    q, dq = configurations(system)
    b = blocks(system, q)
    u = np.einsum("kij,kj->ki", b.Hbm, dq)
    expected = np.einsum("ki,ki->k", u, np.linalg.solve(b.Mt, u[..., None])[..., 0])
    m = Metric(system, kind, duration)
    expected += least(m) * np.sum(dq**2, axis=1)
    np.testing.assert_allclose(m.squares(q, dq), expected, rtol=1e-12)


def test_least_is_a_share_of_the_mean_coupling():
    system = System(vehicle=BENT_THESIS)
    q = configurations(system, 4000)[0]
    mean = np.trace(metric(system, q, 2.0), axis1=-2, axis2=-1).mean() / 3
    assert least(Metric(system, "qt", 2.0)) == pytest.approx(LEAST * mean, rel=0.1)


def test_lengths_are_integrals():
    """Against 4000 midpoints; eight Gauss nodes on 0.5 rad are good to 1e-6."""
    system = System(vehicle=BENT_THESIS)
    a, d = configurations(system, 5)
    b = a + 0.5 * d / np.linalg.norm(d, axis=1)[:, None]
    m = Metric(system, "qt", 2.0)
    u = (np.arange(4000) + 0.5)[:, None, None] / 4000
    fine = np.sqrt(m.squares(a + u * (b - a), np.broadcast_to(b - a, (4000, 5, 3)))).mean(
        axis=0
    )
    np.testing.assert_allclose(m.lengths(a, b), fine, rtol=1e-6)
    assert [m.edge(*ends) for ends in zip(a, b, strict=True)] == pytest.approx(m.lengths(a, b))
    assert m.length([a[0], (a[0] + b[0]) / 2, b[0]]) == pytest.approx(
        m.lengths(a, b)[0], rel=1e-6
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("Q",), "metric must be one of q, qt, disturbance, got 'Q'"),
        (("qt",), "metric qt needs a duration > 0 s, got None"),
        (("qt", 0.0), "metric qt needs a duration > 0 s, got 0.0"),
        (("qt", np.nan), "metric qt needs a duration > 0 s, got nan"),
    ],
)
def test_a_metric_that_is_none(arguments, message):
    with pytest.raises(ParameterError, match=message):
        Metric(System(vehicle=BENT_THESIS), *arguments)
