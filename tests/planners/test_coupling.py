"""The coupling matrix, its spectral form, maps of them, and their compiled forms."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

from tests.arms import seven_joint_arm, six_joint_arm
from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    DECOUPLED,
    FREE_FLOATING,
    STRAIGHT_VERTICAL_THESIS,
)
from ves_gym.planners.coupling import (
    blocks,
    coupling_length,
    coupling_matrix,
    metric,
    modes,
)
from ves_gym.planners.coupling_map import coupling_map
from ves_gym.planners.metric import Metric
from ves_gym.system.system import System

SYSTEM = System(vehicle=BENT_THESIS)
CONFIGURATIONS = np.random.default_rng(2).uniform(-1.5, 1.5, (7, 3))

# -------------------------------------------------------------------------- matrices


@pytest.mark.parametrize("duration", [None, 2.0])
def test_q_is_symmetric_semidefinite_and_works_on_stacks(duration):
    Q = metric(SYSTEM, CONFIGURATIONS, duration)
    assert Q.shape == (7, 3, 3)
    size = np.abs(Q).max()
    np.testing.assert_allclose(Q, np.swapaxes(Q, -1, -2), atol=1e-12 * size)
    assert np.linalg.eigvalsh(Q).min() > -1e-12 * size
    for q, matrix in zip(CONFIGURATIONS, Q, strict=True):
        np.testing.assert_allclose(metric(SYSTEM, q, duration), matrix, atol=1e-12 * size)


def test_q_is_the_strain_energy_of_a_joint_step():
    """A step dq at locked-in momentum moves the base by -M_t^-1 H_bm dq."""
    base = SYSTEM.base
    for q in CONFIGURATIONS:
        H = inertia(SYSTEM.arm, q)
        for dq in np.eye(3):
            step = -np.linalg.solve(base.M + H[:6, :6], H[:6, 6:] @ dq)
            strain = step @ base.K @ step
            assert dq @ coupling_matrix(SYSTEM, q) @ dq == pytest.approx(strain, rel=1e-9)


def test_modes_solve_the_eigenproblem():
    base = SYSTEM.base
    solution = modes(SYSTEM, CONFIGURATIONS)
    for k, q in enumerate(CONFIGURATIONS):
        Mt = blocks(SYSTEM, q).Mt
        squares = scipy.linalg.eigh(base.K, Mt, eigvals_only=True)
        np.testing.assert_allclose(solution.omega[k] ** 2, squares, rtol=1e-8)
        shapes = solution.shapes[k]
        np.testing.assert_allclose(shapes.T @ Mt @ shapes, np.eye(6), atol=1e-9)
        assert (np.diff(solution.omega[k]) >= 0).all()


def test_the_length_of_a_path():
    path = CONFIGURATIONS[:3]
    fine = np.vstack([np.linspace(a, b, 201)[:-1] for a, b in pairwise(path)])
    fine = np.vstack([fine, path[-1]])
    length = coupling_length(SYSTEM, fine)
    assert coupling_length(SYSTEM, fine[::-1]) == pytest.approx(length, rel=1e-12)
    assert coupling_length(SYSTEM, fine[::2]) == pytest.approx(length, rel=1e-3)
    assert coupling_length(SYSTEM, [path[0], path[0]]) == 0.0
    dq = 1e-3 * np.array([1.0, -2.0, 0.5])
    Q = coupling_matrix(SYSTEM, path[0] + dq / 2)
    assert coupling_length(SYSTEM, [path[0], path[0] + dq]) == pytest.approx(
        np.sqrt(dq @ Q @ dq)
    )


# ------------------------------------------------------------------------------ maps


@pytest.fixture(scope="module")
def section():
    return coupling_map(SYSTEM, (0, 2), [0.1, 0.4, 0.0], duration=2.0, points=41)


def block(section, angles):
    """The 2x2 block at one point of the map, computed on its own."""
    q = section.fixed.copy()
    q[list(section.joints)] = angles
    Q = metric(SYSTEM, q, section.duration)
    return Q[np.ix_(section.joints, section.joints)]


def test_a_map_holds_the_eigenvalues_of_the_block(section):
    assert section.least.shape == section.most.shape == (41, 41)
    assert (section.least <= section.most).all()
    arm = SYSTEM.arm
    for k, joint in enumerate(section.joints):
        ends = arm.links[joint].q_min, arm.links[joint].q_max
        np.testing.assert_allclose(section.axes[k][[0, -1]], ends)
    for i, j in ((0, 0), (3, 17), (40, 22)):
        B = block(section, (section.axes[0][i], section.axes[1][j]))
        np.testing.assert_allclose(
            [section.least[i, j], section.most[i, j]],
            np.linalg.eigvalsh(B),
            atol=1e-9 * section.most.max(),
        )
        d = section.direction[i, j]
        assert d @ d == pytest.approx(1.0)
        assert d @ B @ d == pytest.approx(section.least[i, j], abs=1e-9 * section.most.max())


def test_lines_stay_on_the_map_and_follow_least_coupling(section):
    """Angle to the eigenvector computed at each segment; the field is interpolated.

    Tolerance: 2 degrees in the middle of the distribution, 10 for 95 %; lines end where
    the two eigenvalues meet and no direction is the least.
    """
    lines = section.lines()
    assert len(lines) > 10
    x, y = section.axes
    angles = []
    for curve in lines:
        assert curve.ndim == 2
        assert curve.shape[1] == 2
        assert (curve >= [x[0] - 1e-12, y[0] - 1e-12]).all()
        assert (curve <= [x[-1] + 1e-12, y[-1] + 1e-12]).all()
        steps = np.diff(curve, axis=0)
        for k in range(0, len(steps), 5):
            _, vectors = np.linalg.eigh(block(section, curve[k] + steps[k] / 2))
            along = steps[k] / np.linalg.norm(steps[k])
            angles.append(np.rad2deg(np.arccos(min(1.0, abs(along @ vectors[:, 0])))))
    assert np.median(angles) < 2
    assert np.percentile(angles, 95) < 10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"points": 3}, "points must be >= 4, got 3"),
        ({"duration": 0.0}, "duration must be > 0 s"),
        ({"fixed": [0.0, 0.0]}, r"fixed must have shape \(3,\)"),
        ({"fixed": [0.0, 0.0, 3.0]}, "fixed: joint 3 must be within"),
        ({"fixed": [0.0, np.nan, 0.0]}, "fixed must be finite"),
    ],
)
def test_what_is_no_map_is_refused(arguments, message):
    good = {"joints": (0, 1), "fixed": [0.0, 0.0, 0.0], "points": 5}
    with pytest.raises(ParameterError, match=message):
        coupling_map(SYSTEM, **{**good, **arguments})


# ------------------------------------------------------------------- the other joints


@pytest.mark.parametrize(
    ("others", "duration"), [("most", 2.0), pytest.param("least", None, marks=pytest.mark.slow)]
)
def test_the_other_joints_may_be_chosen_at_every_point(others, duration):
    """Against L-BFGS-B from the point found and from four more: within 2 %."""
    system = System(vehicle=BENT_THESIS, arm=seven_joint_arm(), drive="prescribed")
    low, high = (system.arm.column(k) for k in ("q_min", "q_max"))
    done = []
    section = coupling_map(
        system,
        (0, 2),
        np.zeros(7),
        duration=duration,
        points=7,
        others=others,
        progress=done.append,
    )
    assert done[-1] == pytest.approx(1.0)
    assert section.others == others
    free, sign = [1, 3, 4, 5, 6], 1.0 if others == "least" else -1.0
    assert (section.angles >= low).all() and (section.angles <= high).all()
    given = coupling_map(system, (0, 2), np.zeros(7), duration=duration, points=7)
    assert (sign * (section.most - given.most) <= 1e-12).all()
    rng = np.random.default_rng(3)
    for i, j in ((0, 6), (3, 2)):
        at = section.angles[i, j]
        assert at[0] == section.axes[0][i] and at[2] == section.axes[1][j]

        def strength(x, at=at):
            q = at.copy()
            q[free] = x
            block = metric(system, q, duration)[np.ix_((0, 2), (0, 2))]
            return sign * float(np.linalg.eigvalsh(block)[1])

        assert strength(at[free]) == pytest.approx(sign * section.most[i, j], rel=1e-9)
        bounds = scipy.optimize.Bounds(low[free], high[free])
        starts = [at[free], *rng.uniform(low[free], high[free], (4, 5))]
        runs = (scipy.optimize.minimize(strength, x, bounds=bounds) for x in starts)
        best = min(run.fun for run in runs)
        assert strength(at[free]) <= best + 0.02 * abs(best)


def test_a_file_of_a_map_has_its_arrays(tmp_path):
    section = coupling_map(SYSTEM, (0, 1), (0.0, 0.0, 0.3), points=5, others="most")
    section.save(tmp_path / "map.npz")
    again = np.load(tmp_path / "map.npz")
    assert again["joints"].tolist() == [0, 1] and again["others"].item() == "most"
    np.testing.assert_array_equal(again["most"], section.most)
    np.testing.assert_array_equal(again["angles"], section.angles)
    with pytest.raises(ParameterError, match="others must be one of given, least, most"):
        coupling_map(SYSTEM, (0, 1), (0.0, 0.0, 0.3), points=5, others="best")


# ----------------------------------------------------------------------------- compiled metrics

CONSISTENT = dataclasses.replace(BENT_THESIS, mass_model="consistent")  # modes to 14 Hz


def configurations(system, count=40):
    rng = np.random.default_rng(0)
    arm = system.arm
    q = rng.uniform(arm.column("q_min"), arm.column("q_max"), (count, arm.n))
    return q, rng.normal(size=(count, arm.n))


@pytest.mark.parametrize(
    ("vehicle", "duration", "arm"),
    [
        (BENT_THESIS, 0.5, PUMA_560),
        (CONSISTENT, 2.0, PUMA_560),
        (STRAIGHT_VERTICAL_THESIS, 4.0, six_joint_arm()),
        (DECOUPLED, None, PUMA_560),
    ],
)
def test_compiled_forms_are_those_of_the_matrices(vehicle, duration, arm):
    """Another eigenvalue method (Jacobi against LAPACK): 1e-9 relative.

    The straight beam's modes spread over four decades of frequency squared.
    """
    system = System(vehicle=vehicle, arm=arm)
    q, dq = configurations(system)
    m = Metric(system, duration)
    expected = np.einsum("ki,kij,kj->k", dq, metric(system, q, duration), dq)
    expected += m.least * np.sum(dq**2, axis=1)
    np.testing.assert_allclose(m.squares(q, dq), expected, rtol=1e-9)


@pytest.mark.parametrize("duration", [None, 2.0])
def test_a_base_without_stiffness_is_measured_by_its_kinetic_energy(duration):
    system = System(vehicle=FREE_FLOATING)
    q, dq = configurations(system)
    b = blocks(system, q)
    u = np.einsum("kij,kj->ki", b.Hbm, dq)
    expected = np.einsum("ki,ki->k", u, np.linalg.solve(b.Mt, u[..., None])[..., 0])
    m = Metric(system, duration)
    expected += m.least * np.sum(dq**2, axis=1)
    np.testing.assert_allclose(m.squares(q, dq), expected, rtol=1e-12)


def test_lengths_are_integrals():
    """Against 4000 midpoints; eight Gauss nodes on 0.5 rad are good to 1e-6."""
    system = System(vehicle=BENT_THESIS)
    a, d = configurations(system, 5)
    b = a + 0.5 * d / np.linalg.norm(d, axis=1)[:, None]
    m = Metric(system, 2.0)
    u = (np.arange(4000) + 0.5)[:, None, None] / 4000
    fine = np.sqrt(m.squares(a + u * (b - a), np.broadcast_to(b - a, (4000, 5, 3)))).mean(
        axis=0
    )
    np.testing.assert_allclose(m.lengths(a, b), fine, rtol=1e-6)
    assert [m.edge(*ends) for ends in zip(a, b, strict=True)] == pytest.approx(m.lengths(a, b))
    halfway = (a[0] + b[0]) / 2
    halves = m.lengths([a[0], halfway], [halfway, b[0]])
    assert halves.sum() == pytest.approx(m.lengths(a, b)[0], rel=1e-6)
