"""Finite elements against closed forms and published frequencies.

Closed forms: Blevins, Formulas for Natural Frequency and Mode Shape (1979), tables 8-1, 8-8
and 8-19. Timoshenko: Lee and Schultz, J. Sound Vib. 269 (2004), tables 1 and 2 (nu = 0.3,
kappa = 5/6, sqrt(omega L^2 sqrt(rho A / E I)) as printed).
"""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.finite_elements import (
    ALUMINIUM,
    Material,
    Section,
    Tube,
    cowper,
)
from ves_gym.mechanics.flexible_base import CornerBody, Polyline, Strut
from ves_gym.mechanics.link import Inertial, diagonal

# so slender that rotary inertia and shear change nothing in six digits
HAIR = Tube(outer_diameter=4e-3, wall=5e-4)
LENGTH = 10.0
ALONG = np.array([2.0, -1.0, 2.0]) / 3  # oblique, so that axes are seen to be turned


def line(section, pieces=32, length=LENGTH, along=ALONG, **options):
    """A straight frame."""
    return polyline([length * along], section, **options).frame(pieces)


def polyline(vectors, section, material=ALUMINIUM, body=None):
    """Members one after the other, perhaps a body at the end of the first."""
    struts = (Strut(vector=tuple(k), section=section, material=material) for k in vectors)
    bodies = () if body is None else (CornerBody(corner=1, inertial=body),)
    return Polyline(members=tuple(struts), bodies=bodies)


def frequencies(frame, held=(), count=8):
    """(count,) omega [rad/s], slowest first; rigid motions come as zeros."""
    M, K = frame.matrices()
    free = np.setdiff1d(np.arange(len(K)), held)
    M, K = M[np.ix_(free, free)], K[np.ix_(free, free)]
    if len(held):  # the slow ones of a slender beam come out better as the largest 1/omega^2
        return scipy.linalg.eigh(M, K, eigvals_only=True)[::-1][:count] ** -0.5
    return np.sqrt(np.maximum(scipy.linalg.eigh(K, M, eigvals_only=True)[:count], 0))


def bending(section, material=ALUMINIUM, length=LENGTH):
    """omega of the unit of Blevins's omega L^2 sqrt(rho A / E I)."""
    s = section.of(material)
    return (
        np.sqrt(material.youngs_modulus * s.second_z / (material.density * s.area)) / length**2
    )


def test_cantilever():
    """Both planes: 3.5160, 22.034, 61.697, 120.90."""
    found = frequencies(line(HAIR), held=range(6)) / bending(HAIR)
    assert found == pytest.approx(np.repeat([3.51602, 22.0345, 61.6972, 120.902], 2), rel=2e-5)


@pytest.mark.parametrize("share", [0.1, 10.0])
def test_tip_mass(share):
    """1 + cos b cosh b + mu b (cos b sinh b - sin b cosh b) = 0, mu of the beam's mass."""
    s = HAIR.of(ALUMINIUM)
    mass = share * s.area * LENGTH * ALUMINIUM.density
    tip = Inertial(mass=mass, com=(0.0, 0.0, 0.0), inertia=diagonal(0.0, 0.0, 0.0))

    def equation(b):
        c, ch, s_, sh = np.cos(b), np.cosh(b), np.sin(b), np.sinh(b)
        return 1 + c * ch + share * b * (c * sh - s_ * ch)

    roots = [scipy.optimize.brentq(equation, *span) for span in ((0.3, 2.5), (3.9, 4.9))]
    found = frequencies(line(HAIR, body=tip), held=range(6), count=4) / bending(HAIR)
    assert found == pytest.approx(np.repeat(np.square(roots), 2), rel=2e-5)


PUBLISHED = {  # thickness over length -> square roots of the frequency, first five
    ("pinned", 0.2): [3.04533, 5.67155, 7.83952, 9.65709, 11.2220],
    ("clamped", 0.1): [4.57955, 7.33122, 9.85611, 12.1454, 14.2324],
}
STOCKY = Material(youngs_modulus=1e9, shear_modulus=1e9 / 2.6, density=1e3, source="nu = 0.3")


@pytest.mark.parametrize(("ends", "ratio"), PUBLISHED)
def test_timoshenko_beam_against_published_frequencies(ends, ratio):
    area, second = ratio, ratio**3 / 12  # width and length 1 m
    section = Section(
        area=area,
        second_y=second,
        second_z=second,
        torsion=second,
        shear_y=5 / 6,
        shear_z=5 / 6,
    )
    frame = line(section, 160, 1.0, np.array([1.0, 0, 0]), material=STOCKY)
    M, K = frame.matrices()
    plane = np.setdiff1d(np.r_[1 : len(K) : 6, 5 : len(K) : 6], [1, len(K) - 5])
    if ends == "clamped":
        plane = np.setdiff1d(plane, [5, len(K) - 1])
    grid = np.ix_(plane, plane)
    squares = scipy.linalg.eigh(K[grid], M[grid], eigvals_only=True)[:5]
    found = np.sqrt(np.sqrt(squares) / bending(section, STOCKY, 1.0))
    assert found == pytest.approx(PUBLISHED[ends, ratio], rel=2e-4)


def test_shear_is_left_out_where_it_is_not_asked_for():
    """A sheared cantilever gives by F L / (kappa G A) more; Cowper's 0.53 of a thin tube."""
    tip = []
    for shear in (False, True):
        tube = Tube(outer_diameter=0.18, wall=0.007, shear=shear)
        _, K = line(tube, 1, 2.0, np.array([1.0, 0, 0])).matrices()
        tip.append(np.linalg.inv(K[6:, 6:])[1, 1])
    s = tube.of(ALUMINIUM)
    assert s.shear_y == pytest.approx(0.5347, abs=1e-4)
    expected = 2.0 / (s.shear_y * ALUMINIUM.shear_modulus * s.area)
    assert tip[1] - tip[0] == pytest.approx(expected, rel=1e-9)
    assert cowper(0.0, 0.3) == pytest.approx(6 * 1.3 / (7 + 6 * 0.3))  # solid round bar


def test_mass_and_rigid_motion():
    """A rigid motion strains nothing, and its kinetic energy is that of the whole body."""
    tube = Tube(outer_diameter=0.1, wall=0.01)
    body = Inertial(mass=3.0, com=(0.1, 0.0, 0.2), inertia=diagonal(0.1, 0.2, 0.25))
    frame = polyline([(1.0, 2.0, 0.5), (0.0, -1.0, 2.0)], tube, body=body).frame(3)
    M, K = frame.matrices()
    rigid = np.zeros((6 * len(frame.nodes), 6))
    for node, (x, y, z) in enumerate(frame.nodes):
        rigid[6 * node : 6 * node + 6] = np.eye(6)
        rigid[6 * node : 6 * node + 3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    assert np.abs(K @ rigid).max() < 1e-9 * abs(K).max()
    total = rigid.T @ M @ rigid
    s = tube.of(ALUMINIUM)
    lengths = np.linalg.norm([(1.0, 2.0, 0.5), (0.0, -1.0, 2.0)], axis=1)
    mass = 2.8e3 * s.area * lengths.sum() + 3.0
    assert total[:3, :3] == pytest.approx(mass * np.eye(3), abs=1e-9)
    centres = np.array([[-0.5, 0.0, -2.25], [0.0, 0.5, -1.0]])
    moment = 2.8e3 * s.area * lengths @ centres + 3.0 * (frame.nodes[3] + [0.1, 0.0, 0.2])
    assert total[3:, 0] == pytest.approx(np.cross(moment, [1.0, 0, 0]), abs=1e-9)


def test_an_unsymmetrical_section_bends_about_its_own_axes():
    flat = Section(area=0.01, second_y=1e-6, second_z=4e-6, torsion=1e-6, up=(0.0, 1.0, 0.0))
    _, K = line(flat, 1, 1.0, np.array([1.0, 0, 0])).matrices()
    tip = np.linalg.inv(K[6:, 6:])
    # local z lies along y: the force along y meets second_y
    assert tip[1, 1] == pytest.approx(1 / (3 * 72e9 * 1e-6))
    assert tip[2, 2] == pytest.approx(1 / (3 * 72e9 * 4e-6))


REFUSED = {
    "half the outer diameter 0.1 m, got 0.05": lambda: Tube(outer_diameter=0.1, wall=0.05),
    "both shear_y and shear_z or neither": lambda: Section(
        area=1.0, second_y=1.0, second_z=1.0, torsion=1.0, shear_y=0.5
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_is_refused(message):
    with pytest.raises(ParameterError, match=message):
        REFUSED[message]()
