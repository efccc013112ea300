"""The reduction to an interface and modes against the structure that it is made of."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse

from ves_gym._util.params import ParameterError
from ves_gym.mechanics import craig_bampton
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.craig_bampton import reduce
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexible_base import Polyline
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.vehicle import BENT_THESIS, STRAIGHT_VERTICAL_THESIS

BEAMS = {
    "bent-thesis": BENT_THESIS,
    "straight-vertical-thesis": STRAIGHT_VERTICAL_THESIS,
}
ARM = inertia(PUMA_560, np.zeros(3))[:6, :6]
# of BASES.md and of the independent frame of tests/claims/test_beams.py [Hz]
FINE = {
    "bent-thesis": [0.43, 0.48, 1.44, 1.87, 8.09, 8.76, 13.66],
    "straight-vertical-thesis": [0.13, 0.13, 1.74, 1.75, 2.94, 5.04, 5.29, 9.73],
}


def structure(beam, pieces=8):
    """M, K of a beam's frame, its interface and its clamp."""
    M, K = Polyline.of(beam).frame(pieces).matrices()
    return M, K, np.arange(len(K) - 6, len(K)), np.arange(6)


def frequencies(M, K):
    """Hz, slowest first."""
    return natural_modes(np.asarray(K), np.asarray(M)).omega / (2 * np.pi)


@pytest.mark.parametrize("name", BEAMS)
def test_all_modes_are_no_reduction(name):
    """Every mode kept: the frequencies of the whole, the arm standing on it, to 1e-8."""
    M, K, tip, clamp = structure(BEAMS[name], 4)
    free = np.setdiff1d(np.arange(K.shape[0]), clamp)
    reduced = reduce(M, K, tip, len(free) - 6, held=clamp)
    M_z, K_z = reduced.matrices()
    M_z[:6, :6] += ARM
    full, stiff = M.copy(), K
    full[np.ix_(tip, tip)] += ARM
    grid = np.ix_(free, free)
    expected = scipy.linalg.eigh(full[grid], stiff[grid], eigvals_only=True)[::-1] ** -0.5
    found = scipy.linalg.eigh(M_z, K_z, eigvals_only=True)[::-1] ** -0.5
    assert found == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("name", BEAMS)
def test_frequencies_with_the_arm_are_those_of_a_fine_model(name):
    """Below 20 Hz within 1 % with eight modes; the condensed model misses some altogether."""
    beam = BEAMS[name]
    M, K, tip, clamp = structure(beam, 20)
    M_z, K_z = reduce(M, K, tip, 8, held=clamp).matrices()
    M_z[:6, :6] += ARM
    found = frequencies(M_z, K_z)
    assert found[: len(FINE[name])] == pytest.approx(FINE[name], abs=6e-3)
    fine, stiff = M.copy(), K
    fine[np.ix_(tip, tip)] += ARM
    grid = np.ix_(np.arange(6, len(fine)), np.arange(6, len(fine)))
    true = scipy.linalg.eigh(fine[grid], stiff[grid], eigvals_only=True)[::-1]
    true = true**-0.5 / (2 * np.pi)
    true = true[true < 20]
    assert found[: len(true)] == pytest.approx(true, rel=1e-2)
    condensed = frequencies(beam.consistent_mass() + ARM, beam.stiffness())
    assert np.abs(condensed[3:5] / true[3:5] - 1).max() > 0.1


def test_modes_left_out_follow_in_statics():
    """Truncation is the reduction with fewer modes, and the mass beside them grows."""
    M, K, tip, clamp = structure(BENT_THESIS)
    many, few = (reduce(M, K, tip, m, held=clamp) for m in (12, 5))
    cut = many.truncated(5)
    for name in ("K", "M", "coupling", "omega", "static", "shapes"):
        a, b = getattr(cut, name), getattr(few, name)
        assert np.abs(a - b).max() < 1e-8 * np.abs(b).max(), name
    assert many.within(2 * np.pi * 17.5).m == 4
    zero = np.zeros((18, 18))
    rest = [r.absolute(zero[: 6 + r.m, : 6 + r.m])[0] for r in (many, few)]
    assert np.linalg.eigvalsh(rest[0])[0] > 0
    assert np.linalg.eigvalsh(rest[1] - rest[0])[0] > -1e-9


def test_absolute_coordinates_are_the_same_structure():
    """Over (Y, u): mass without coupling, strain by u - P^T Y, damping ratios as asked for."""
    M, K, tip, clamp = structure(BENT_THESIS)
    found = reduce(M, K, tip, 6, held=clamp)
    D = found.modal_damping(0.03)
    rest, loss = found.absolute(D)
    mass = scipy.linalg.block_diag(rest, np.eye(6))
    way = np.vstack([-found.coupling, np.eye(6)])
    stiffness = scipy.linalg.block_diag(found.K, np.zeros((6, 6)))
    stiffness = stiffness + (way * found.omega**2) @ way.T
    expected = natural_modes(*found.matrices()[::-1]).omega
    assert natural_modes(stiffness, mass).omega == pytest.approx(expected, rel=1e-9)
    inverse = np.linalg.inv(mass)
    states = np.block(
        [[np.zeros((12, 12)), np.eye(12)], [-inverse @ stiffness, -inverse @ loss]]
    )
    poles = np.linalg.eigvals(states)
    assert -poles.real / np.abs(poles) == pytest.approx(np.full(24, 0.03), rel=1e-6)


def test_a_structures_own_damping_is_carried_along():
    """Rayleigh damping a M + b K stays a M_z + b K_z."""
    M, K, tip, clamp = structure(BENT_THESIS)
    found = reduce(M, K, tip, 5, damping=0.2 * M + 1e-3 * K, held=clamp)
    M_z, K_z = found.matrices()
    expected = 0.2 * M_z + 1e-3 * K_z
    assert np.abs(found.damping - expected).max() < 1e-9 * np.abs(expected).max()


def test_sparse_solver_gives_the_same(monkeypatch):
    M, K, tip, clamp = structure(BENT_THESIS)
    dense = reduce(M, K, tip, 6, held=clamp)
    monkeypatch.setattr(craig_bampton, "_DENSE", 0)
    sparse = reduce(M, K, tip, 6, held=clamp)
    assert sparse.omega == pytest.approx(dense.omega, rel=1e-8)
    assert sparse.coupling == pytest.approx(dense.coupling, abs=1e-5)


def test_modes_of_equal_frequency_have_axes_that_no_solver_chose():
    """A straight tube lying oblique: the same P whatever basis the planes were solved in."""
    M, K, tip, clamp = structure(STRAIGHT_VERTICAL_THESIS)
    found = reduce(M, K, tip, 4, held=clamp)
    assert found.omega[0] == pytest.approx(found.omega[1], rel=1e-9)
    # of the first pair one does not move along the first axis: x leads in one mode alone
    assert np.abs(found.coupling[:, :2]).min(axis=1)[:2] == pytest.approx([0, 0], abs=1e-6)
    assert (found.coupling[np.abs(found.coupling).argmax(axis=0), range(4)] > 0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"interface": [0, 1, 2]}, "interface must be 6 freedoms"),
        ({"interface": [12, 13, 14, 15, 16, 999]}, "freedoms 0 to 101, got 999"),
        ({"interface": [0, 1, 2, 3, 4, 5]}, "must differ, got 0 twice"),
        ({"modes": 500}, "modes must be 0 to 90, got 500"),
    ],
)
def test_what_does_not_fit_is_refused(change, message):
    M, K, tip, clamp = structure(BENT_THESIS)
    options = {"interface": tip, "modes": 4, "held": clamp, **change}
    with pytest.raises(ParameterError, match=message):
        reduce(M, K, **options)


def test_a_part_that_hangs_on_nothing_is_refused():
    M, K, tip, clamp = structure(BENT_THESIS)
    loose = scipy.sparse.block_diag([K, np.zeros((1, 1))])
    heavy = scipy.sparse.block_diag([M, np.ones((1, 1))])
    with pytest.raises(ParameterError, match="must not move freely"):
        reduce(heavy, loose, tip, 4, held=clamp)
    massless = scipy.sparse.block_diag([M, np.zeros((1, 1))])
    held = scipy.sparse.block_diag([K, np.ones((1, 1))])
    with pytest.raises(ParameterError, match="90 modes of its own, got modes 91"):
        reduce(massless, held, tip, 91, held=clamp)
