"""Claim: a beam's compliance and consistent mass are those of Euler-Bernoulli theory.

Compared with a multi-element space frame written here: Hermite elements integrated by
Gauss quadrature, assembled, clamped at the root. Its nodal displacements under end loads
are exact, so its compliance must agree to rounding; its mass, condensed on the tip by
the same static shapes (Guyan), is the kinetic energy the `consistent` model states.
The corrected closed forms of thesis A.2 and A.4 (docs/errata.md) and the stiffnesses
recomputed from them are compared too.

Tolerance: 1e-9, entry by entry, relative to the geometric mean of the two diagonal
entries; the frame's condition number of about 1e6 leaves 1e-10. The thesis's misprints
change entries by 10 to 100 %: a test shows that the comparison sees them.
"""

import dataclasses

import numpy as np
import pytest
import scipy.linalg

from ves_gym.mechanics.base_model import elementwise_damping
from ves_gym.mechanics.modes import modal_damping
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    STRAIGHT_HORIZONTAL_THESIS,
    STRAIGHT_VERTICAL_THESIS,
    Beam,
)

CROOKED = Beam(
    segments=((3.0, -1.0, 0.5), (0.0, 2.0, 2.0), (-1.0, 0.3, 4.0)),
    outer_diameter=0.11,
    wall=0.004,
    source="test: no plane of symmetry",
)
BEAMS = {
    "straight-vertical-thesis": STRAIGHT_VERTICAL_THESIS,
    "straight-horizontal-thesis": STRAIGHT_HORIZONTAL_THESIS,
    "bent-thesis": BENT_THESIS,
    "bent-90mm": dataclasses.replace(BENT_THESIS, outer_diameter=0.09),
    "crooked": CROOKED,
}
TOLERANCE = 1e-9


# ---------------------------------------------------------------- an independent frame


def element(length: float, beam: Beam, points: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """(12, 12) stiffness and mass of a tube along its local x, by quadrature.

    Node freedoms (u, v, w, theta_x, theta_y, theta_z). Energy densities
    EA u'^2 + EI (v''^2 + w''^2) + GJ theta_x'^2 and rho A |u|^2 + rho J theta_x'^2.
    """
    outer, inner = beam.outer_diameter / 2, beam.outer_diameter / 2 - beam.wall
    area, second = np.pi * (outer**2 - inner**2), np.pi / 4 * (outer**4 - inner**4)
    polar = 2 * second
    m = beam.material
    E, G, rho = m.youngs_modulus, m.shear_modulus, m.density
    stiffness, mass = np.zeros((12, 12)), np.zeros((12, 12))
    for node, weight in zip(*np.polynomial.legendre.leggauss(points), strict=True):
        s = (1 + node) / 2
        dx = weight * length / 2
        linear = np.array([1 - s, s])
        slope = np.array([-1.0, 1.0]) / length
        # cubic Hermite: value at 0, slope at 0, value at 1, slope at 1
        scale = np.array([1.0, length, 1.0, length])
        cubic = scale * [
            1 - 3 * s**2 + 2 * s**3,
            s - 2 * s**2 + s**3,
            3 * s**2 - 2 * s**3,
            s**3 - s**2,
        ]
        curvature = scale * [-6 + 12 * s, 6 * s - 4, 6 - 12 * s, 6 * s - 2] / length**2
        rows = np.zeros((8, 12))  # u, v, w, theta_x, u', v'', w'', theta_x'
        rows[0, [0, 6]], rows[4, [0, 6]] = linear, slope
        rows[3, [3, 9]], rows[7, [3, 9]] = linear, slope
        rows[1, [1, 5, 7, 11]], rows[5, [1, 5, 7, 11]] = cubic, curvature
        signs = np.array([1, -1, 1, -1])  # w' = -theta_y
        rows[2, [2, 4, 8, 10]], rows[6, [2, 4, 8, 10]] = cubic * signs, curvature * signs
        inertias = np.array([rho * area] * 3 + [rho * polar])
        moduli = np.array([E * area, E * second, E * second, G * polar])
        mass += dx * rows[:4].T @ (inertias[:, None] * rows[:4])
        stiffness += dx * rows[4:].T @ (moduli[:, None] * rows[4:])
    return stiffness, mass


def frame(beam: Beam, per_segment: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and mass of the clamped frame; the tip is the last six freedoms."""
    count = per_segment * len(beam.segments)
    K, M = np.zeros((2, 6 * (count + 1), 6 * (count + 1)))
    first = 0
    for segment in beam.segments:
        length = float(np.linalg.norm(segment))
        x = np.array(segment) / length
        basis = scipy.linalg.qr(np.column_stack([x, np.eye(3)]))[0]  # first column +-x
        basis[:, 0] = x
        basis[:, 2] = np.cross(x, basis[:, 1])
        local = np.kron(np.eye(4), basis)  # local freedoms -> platform axes
        k, m = element(length / per_segment, beam)
        for _ in range(per_segment):
            part = slice(first, first + 12)
            K[part, part] += local @ k @ local.T
            M[part, part] += local @ m @ local.T
            first += 6
    return K[6:, 6:], M[6:, 6:]


def at_tip(beam: Beam, per_segment: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Compliance (6, 6) and condensed mass (6, 6) at the tip of the frame."""
    K, M = frame(beam, per_segment)
    loads = np.zeros((len(K), 6))
    loads[-6:] = np.eye(6)
    moved = scipy.linalg.solve(K, loads, assume_a="pos")
    compliance = moved[-6:]
    shapes = np.linalg.solve(compliance.T, moved.T).T  # per unit tip displacement
    return compliance, shapes.T @ M @ shapes


def largest_error(found: np.ndarray, true: np.ndarray) -> float:
    """Largest entry of the difference, relative to the two diagonal entries."""
    size = np.sqrt(np.diag(true))
    return float((np.abs(found - true) / np.outer(size, size)).max())


@pytest.mark.parametrize("name", BEAMS)
def test_compliance_and_consistent_mass_are_those_of_the_frame(name):
    beam = BEAMS[name]
    compliance, mass = at_tip(beam)
    assert largest_error(np.linalg.inv(beam.stiffness()), compliance) <= TOLERANCE
    assert largest_error(beam.consistent_mass(), mass) <= TOLERANCE


def test_a_thinner_wall_is_seen():
    """The comparison fails on a wall thinner by 1e-6."""
    beam = BEAMS["bent-thesis"]
    thinner = dataclasses.replace(beam, wall=beam.wall * (1 - 1e-6))
    compliance, mass = at_tip(beam)
    assert largest_error(np.linalg.inv(thinner.stiffness()), compliance) > 10 * TOLERANCE
    assert largest_error(thinner.consistent_mass(), mass) > 10 * TOLERANCE


# ------------------------------------------------------------ thesis A.2, A.4 corrected


def properties(beam: Beam) -> tuple[float, float, float]:
    """EI, GJ [N m^2] and EA [N] with the thesis's section formulas (A.3)."""
    outer, inner = beam.outer_diameter, beam.outer_diameter - 2 * beam.wall
    second = np.pi / 64 * (outer**4 - inner**4)
    area = np.pi / 4 * (outer**2 - inner**2)
    return 72e9 * second, 27e9 * 2 * second, 72e9 * area


def symmetric(entries: dict[tuple[int, int], float]) -> np.ndarray:
    out = np.zeros((6, 6))
    for (i, j), value in entries.items():
        out[i - 1, j - 1] = out[j - 1, i - 1] = value
    return out


def table_a2(beam: Beam) -> np.ndarray:
    """Compliance of the straight beam along z, Q15 = L^2/2EI (printed L/EI)."""
    EI, GJ, EA = properties(beam)
    L = 12.0
    return symmetric(
        {
            (1, 1): L**3 / (3 * EI),
            (2, 2): L**3 / (3 * EI),
            (3, 3): L / EA,
            (4, 4): L / EI,
            (5, 5): L / EI,
            (6, 6): L / GJ,
            (1, 5): L**2 / (2 * EI),
            (2, 4): -(L**2) / (2 * EI),
        }
    )


def table_a4(beam: Beam) -> np.ndarray:
    """Compliance of the bent beam, root to elbow along -x, elbow to tip along +z."""
    EI, GJ, EA = properties(beam)
    A = B = 8.0  # L1, L2
    return symmetric(
        {
            (1, 1): B**3 / (3 * EI) + A / EA + B**2 * A / EI,
            (1, 3): B * A**2 / (2 * EI),
            (1, 5): B**2 / (2 * EI) + A * B / EI,
            (2, 2): B**3 / (3 * EI) + A**3 / (3 * EI) + B**2 * A / GJ,
            (2, 4): -(B**2) / (2 * EI) - A * B / GJ,
            (2, 6): -(A**2) / (2 * EI),  # Q62: missing in the print
            (3, 3): B / EA + A**3 / (3 * EI),
            (3, 5): A**2 / (2 * EI),  # Q35: missing in the print
            (4, 4): B / EI + A / GJ,
            (5, 5): B / EI + A / EI,  # printed B^2/2EI + A/GJ
            (6, 6): B / GJ + A / EI,
        }
    )


@pytest.mark.parametrize(
    ("beam", "table"),
    [(STRAIGHT_VERTICAL_THESIS, table_a2), (BENT_THESIS, table_a4)],
    ids=["A.2", "A.4"],
)
def test_compliance_is_the_corrected_thesis_table(beam, table):
    assert largest_error(np.linalg.inv(beam.stiffness()), table(beam)) <= TOLERANCE


def test_the_printed_tables_are_not_followed():
    """Q15 = L/EI (A.2) and Q55 = L2^2/2EI + L1/GJ (A.4) as printed are far off."""
    straight = table_a2(STRAIGHT_VERTICAL_THESIS)
    straight[0, 4] = 12.0 / properties(STRAIGHT_VERTICAL_THESIS)[0]
    assert largest_error(straight, at_tip(STRAIGHT_VERTICAL_THESIS)[0]) > 0.1
    assert np.linalg.inv(straight)[0, 4] == pytest.approx(-89.0, abs=0.05)  # K15, N

    EI, GJ, _ = properties(BENT_THESIS)
    bent = table_a4(BENT_THESIS)
    bent[4, 4] = 8.0**2 / (2 * EI) + 8.0 / GJ
    assert largest_error(bent, at_tip(BENT_THESIS)[0]) > 0.1


# ---------------------------------------------------- THEORY section 2, printed precision


NUMBERS = {  # mass [kg], K11, K22, ... K66
    "straight-vertical-thesis": (40.5, 311.5, 311.5, 7_238_229.5, 14954.2, 14954.2, 2803.9),
    "bent-thesis": (170.4, 15027.0, 4431.6, 15027.0, 230083.7, 448904.4, 68012.2),
    "bent-90mm": (81.8, 1669.3, 492.1, 1669.3, 25547.6, 49858.9, 7551.8),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_mass_and_stiffness(name):
    """Of the 12 m and the 8 + 8 m tube, 180 mm ('radius of 9 centimeters') and 90 mm."""
    found = [BEAMS[name].mass, *np.diag(BEAMS[name].stiffness())]
    assert found == pytest.approx(NUMBERS[name], abs=0.05)


def test_straight_beam_numbers():
    """EI, GJ, mass, K15 of the 12 m tube: half a unit of the last digit given there."""
    EI, GJ, _ = properties(STRAIGHT_VERTICAL_THESIS)
    assert pytest.approx([44863, 33647], abs=0.5) == [EI, GJ]
    assert STRAIGHT_VERTICAL_THESIS.mass == pytest.approx(40.53, abs=0.005)
    assert STRAIGHT_VERTICAL_THESIS.stiffness()[0, 4] == pytest.approx(-1869.3, abs=0.05)


@pytest.mark.parametrize(
    ("beam", "ratios"),
    [(STRAIGHT_VERTICAL_THESIS, [52.5, 52.5, 1.0]), (BENT_THESIS, [7.9, 139.8, 209.9])],
    ids=["straight", "bent-thesis"],
)
def test_thesis_rotational_mass_over_consistent(beam, ratios):
    """m_eq L^2 is 8 to 210 times the rotational mass of the beam's own motion."""
    found = np.diag(beam.thesis_mass())[3:] / np.diag(beam.consistent_mass())[3:]
    assert found == pytest.approx(ratios, abs=0.05)


def test_thesis_mass_is_appendix_a():
    """Half the mass at the tip, m_eq L^2 about each axis; M66 = rho J L / 3, printed 0."""
    half = STRAIGHT_VERTICAL_THESIS.mass / 2
    polar = STRAIGHT_VERTICAL_THESIS.section.torsion
    expected = [half, half, half, half * 144, half * 144, 2.8e3 * polar * 12 / 3]
    assert np.diag(STRAIGHT_VERTICAL_THESIS.thesis_mass()) == pytest.approx(expected, rel=1e-12)
    assert expected[5] == pytest.approx(0.014, abs=5e-4)
    half = BENT_THESIS.mass / 2
    expected = [half, half, half, half * 64, half * 128, half * 64]
    assert np.diag(BENT_THESIS.thesis_mass()) == pytest.approx(expected, rel=1e-12)


def damping_ratios(M: np.ndarray, D: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Damping ratio of each pole pair, slowest first."""
    inverse = np.linalg.inv(M)
    poles = np.linalg.eigvals(
        np.block([[np.zeros((6, 6)), np.eye(6)], [-inverse @ K, -inverse @ D]])
    )
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    return -poles.real / np.abs(poles)


def test_five_percent_damping_is_modal():
    """Modal damping gives 5 % in every mode; the print read element by element does not.

    Bare straight beam, element-wise: 13.1 % in the slowest mode, 4.0 % in the next.
    """
    M, K = STRAIGHT_VERTICAL_THESIS.thesis_mass(), STRAIGHT_VERTICAL_THESIS.stiffness()
    assert damping_ratios(M, modal_damping(M, K, 0.05), K) == pytest.approx(
        [0.05] * 6, rel=1e-6
    )
    printed = damping_ratios(M, elementwise_damping(M, K, 0.05), K)
    assert printed[[0, 2]] == pytest.approx([0.131, 0.040], abs=5e-4)
