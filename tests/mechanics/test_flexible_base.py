"""A flexible base: files, what it reduces to, what is refused, and how it bends."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg

from ves_gym._util.params import ParameterError
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.craig_bampton import reduce
from ves_gym.mechanics.finite_elements import Section, Tube
from ves_gym.mechanics.flexible_base import (
    ELEMENTS,
    CornerBody,
    FlexibleBase,
    Polyline,
    Strut,
)
from ves_gym.mechanics.latch import tool_motion
from ves_gym.mechanics.link import Inertial, diagonal, matrix
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.structure import Structure
from ves_gym.mechanics.vehicle import (
    BENT,
    BENT_THESIS,
    STRAIGHT_VERTICAL_THESIS,
    beam_line,
    get_vehicle,
    has,
)
from ves_gym.system.system import System

FLEXIBLE = FlexibleBase.of(BENT_THESIS, 6)
MAST = FlexibleBase(
    structure=Polyline(
        members=(
            Strut(
                vector=(0.0, 0.0, 2.0), section=Tube(outer_diameter=0.3, wall=0.01, shear=True)
            ),
            Strut(
                vector=(1.0, 0.5, 3.0),
                section=Section(
                    area=2e-3, second_y=2e-6, second_z=3e-6, torsion=1e-6, up=(0.0, 1.0, 0.0)
                ),
            ),
        ),
        bodies=(
            CornerBody(
                corner=1,
                inertial=Inertial(
                    mass=20.0, com=(0.1, 0.0, 0.0), inertia=diagonal(1.0, 1.0, 1.0)
                ),
            ),
        ),
    ),
    modes=3,
    damping_ratios=(0.01,) * 6 + (0.02, 0.03, 0.04),
)


def users(damped=True):
    """The bent beam as a user's structure, its nodes numbered from 101."""
    M, K = map(scipy.sparse.csc_array, FLEXIBLE.structure.frame().matrices())
    size = M.shape[0]
    labels = tuple((101 + k // 6, k % 6 + 1) for k in range(size))
    damping = 0.1 * M + 1e-3 * K if damped else None
    tip = tuple(range(size - 6, size))
    return Structure(M, K, damping, tip, tuple(range(6)), labels=labels)


def drawn(axes=None):
    """The same with a line through all its nodes."""
    line = FLEXIBLE.structure.frame().nodes
    at = line if axes is None else line @ axes
    nodes = tuple(range(101, 101 + len(line)))
    return users().reduced(6, axes=axes, centreline=at, nodes=nodes, diameter=0.18)


@pytest.mark.parametrize(
    "base",
    [FLEXIBLE, MAST, FlexibleBase(structure=drawn(), modes=4)],
    ids=["beam", "mast", "user's"],
)
@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_a_file_gives_it_back(base, suffix, tmp_path):
    path = tmp_path / f"base.{suffix}"
    base.save(path)
    again = get_vehicle(path)
    assert again == base
    assert hash(again) == hash(base)
    system = System(vehicle=again)
    assert System.from_dict(system.to_dict()).hash == system.hash


@pytest.mark.parametrize("base", [FLEXIBLE, MAST])
def test_the_model_is_the_reduction_in_absolute_coordinates(base):
    """Same frequencies over (Y, u); every mode of the whole has its damping ratio."""
    model = base.base_model()
    M, D, K = model.full()
    expected = natural_modes(*base.reduction().matrices()[::-1])
    found = natural_modes(K, M)
    assert found.omega == pytest.approx(expected.omega, rel=1e-9)
    lost = np.diag(found.shapes.T @ D @ found.shapes) / (2 * found.omega)
    ratios = base.damping_ratios or (base.damping_ratio,) * len(lost)
    assert lost == pytest.approx(ratios, rel=1e-6)
    assert not model.D.any()
    assert np.linalg.eigvalsh(model.M)[0] > 0
    assert not model.K.flags.writeable
    assert has(base, "D") and has(base, "K")


def test_what_a_vehicle_has_counts_its_modes():
    """Stiffness of a free structure is that of its modes; without damping there is none."""
    M, K = map(scipy.sparse.csc_array, FLEXIBLE.structure.frame(4).matrices())
    free = Structure(M, K, None, tuple(range(48, 54)), rigid_modes=6)
    floating = FlexibleBase(structure=free.reduced(3), modes=3, damping_ratio=0.01)
    assert not floating.base_model().K.any()
    assert has(floating, "K") and has(floating, "D")
    assert not has(dataclasses.replace(floating, damping_ratio=0.0), "D")
    assert not has(dataclasses.replace(floating, modes=0), "K")


def test_modes_beyond_reach_are_condensed():
    """omega dt > 1 at 1.25 ms: 13 of the bent beam's modes are slower than that."""
    assert FlexibleBase.of(BENT_THESIS, 30).base_model().m == 13
    everything = dataclasses.replace(FlexibleBase.of(BENT_THESIS, 30), fastest=1e6)
    assert everything.base_model().m == 30
    assert everything.base_model().internal.omega[12] < 800 < everything.reduction().omega[13]


def test_elements_suffice():
    """Eight modes to 1e-5 with the mesh that is used."""
    from ves_gym.mechanics.craig_bampton import reduce

    omega = []
    for elements in (ELEMENTS, 3 * ELEMENTS):
        M, K = FLEXIBLE.structure.frame(elements).matrices()
        omega.append(reduce(M, K, np.arange(-6, 0) + len(M), 8, held=range(6)).omega)
    assert omega[0] == pytest.approx(omega[1], rel=1.1e-5)


def test_a_users_structure_is_the_same_base():
    """From reduced matrices with their own damping, in axes turned by 90 degrees."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    straight = FlexibleBase(structure=drawn(), modes=6).base_model()
    expected = FLEXIBLE.base_model()
    assert np.abs(straight.K - expected.K).max() < 1e-6 * expected.K.max()
    assert straight.internal.omega == pytest.approx(expected.internal.omega)
    both = scipy.linalg.block_diag(turn, turn, np.eye(6))
    turned = FlexibleBase(structure=drawn(turn), modes=6).base_model()
    for a, b in zip(turned.full(), straight.full(), strict=True):
        assert a == pytest.approx(both.T @ b @ both, abs=1e-8 * np.abs(b).max())
    y, u = np.array([[0.1, -0.2, 0.05, 0.02, 0.01, -0.03]]), np.arange(6.0)[None] / 10
    lines = [
        beam_line(FlexibleBase(structure=drawn(k), modes=6), y @ np.kron(np.eye(2), r), u)
        for k, r in ((None, np.eye(3)), (turn, turn))
    ]
    assert lines[1] == pytest.approx(lines[0] @ turn, abs=1e-9)
    ratio = FlexibleBase(structure=drawn(), modes=6, damping_ratio=0.01).base_model()
    assert ratio.internal.damping != pytest.approx(straight.internal.damping)


def test_a_pushed_cantilever_bends_as_in_the_books():
    """Way of a point at x under a force F at the tip: F x^2 (3 L - x) / 6 E I."""
    beam = STRAIGHT_VERTICAL_THESIS
    y = np.linalg.solve(beam.stiffness(), np.eye(6)[0])[None]
    for vehicle in (beam, FlexibleBase.of(beam, 4)):
        still, bent = (beam_line(vehicle, k * y)[0] for k in (0, 1))
        x = still[:, 2] + 12.0
        expected = x**2 * (36.0 - x) / (6 * 72e9 * beam.section.second_y)
        assert (bent - still)[:, 0] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_a_mode_bends_it_between_its_ends():
    """eta_1 = 1 with the flange at rest: the shape of the first mode, both ends still."""
    u = np.zeros((1, 6))
    u[0, 0] = 1.0
    bent = (
        beam_line(FLEXIBLE, np.zeros((1, 6)), u, points=13) - FLEXIBLE.centreline().at_rest[::2]
    )[0]
    assert bent[[0, -1]] == pytest.approx(np.zeros((2, 3)), abs=1e-12)
    # 170 kg in a mode of unit mass: about 1 / sqrt(half of it) where it moves most
    assert 0.05 < np.abs(bent).max() < 0.3
    # the elbow of a clamped bent beam moves out of its plane first
    assert np.abs(bent[:, 1]).max() == pytest.approx(np.abs(bent).max())


REDUCED = users(damped=False).reduced(2)


STRAY = CornerBody(corner=0, inertial=MAST.structure.bodies[0].inertial)
change = dataclasses.replace
REFUSED = {
    "modes must be 0 to 120, got -1": lambda: change(FLEXIBLE, modes=-1),
    "needs damping_ratio or damping_r": lambda: change(FLEXIBLE, damping_ratio=None),
    "got 0.1 and": lambda: change(MAST, damping_ratio=0.1),
    r"must have shape \(9,\)": lambda: change(MAST, damping_ratios=(0.1,)),
    "or a structure with its own": lambda: FlexibleBase(structure=REDUCED, modes=2),
    "modes must be 0 to 2, got 3": lambda: FlexibleBase(
        structure=REDUCED, modes=3, damping_ratio=0.1
    ),
    "at least one, got none": lambda: Polyline(members=()),
    "corner must be 1 to 2, got 0": lambda: change(MAST.structure, bodies=(STRAY,)),
    "> 0 rad/s and ascend": lambda: change(REDUCED, omega=(3.0, 1.0)),
    "must be positive definite, got an eigenvalue -": lambda: change(
        REDUCED, coupling=matrix(50 * np.ones((6, 2)))
    ),
    "axes must be a rotation": lambda: users().reduced(2, axes=2 * np.eye(3)),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_is_refused(message):
    with pytest.raises(ParameterError, match=message):
        REFUSED[message]()


# ------------------------------------------------------------------- residual modes


def test_residual_modes_stand_for_all_that_are_left_out():
    """Mass of slow motions, their next order and the flange's own mass, against all modes."""
    base = change(MAST, damping_ratios=None, damping_ratio=0.0, modes=4, residual=True)
    M, K = base.structure.frame().matrices()
    size = len(M)
    every = reduce(M, K, np.arange(size - 6, size), size - 12, held=range(6))
    found = base.reduction()
    assert found.m == 10
    np.testing.assert_allclose(found.M, every.M, atol=1e-9 * np.abs(every.M).max())
    for power in (0, 2):
        mine, all_of_them = (
            (k.coupling / k.omega**power) @ k.coupling.T for k in (found, every)
        )
        size = np.sqrt(np.outer(np.diag(all_of_them), np.diag(all_of_them)))
        assert np.abs((mine - all_of_them) / size).max() <= 1e-7
    np.testing.assert_allclose(found.omega[:4], every.omega[:4], rtol=1e-9)
    assert (np.diff(found.omega) >= 0).all()


def test_an_impulse_finds_the_flange_as_with_all_modes():
    """The flange's impulsive compliance with the PUMA on `bent`, against 120 modes: 7 %; what
    is left of the truncation, as 1/modes; without residual modes it is off by 60 %."""
    q = np.array([[0.3, -0.5, 0.7]])

    def compliance(base):
        at = tool_motion(PUMA_560, base.base_model(), np.zeros((1, 6)), q, np.zeros((1, 0)))
        return np.diag(np.linalg.inv(at.mass[0])[:6, :6])

    many = change(BENT, modes=120, fastest=1e9)
    exact = compliance(change(BENT, residual=True))
    np.testing.assert_allclose(compliance(many), exact, rtol=0.07)
    np.testing.assert_allclose(compliance(change(many, residual=True)), exact, rtol=1e-6)
    assert (compliance(BENT) < 0.65 * exact).sum() >= 3


def test_residual_modes_need_a_polyline():
    with pytest.raises(ParameterError, match="residual needs a polyline"):
        FlexibleBase(structure=REDUCED, modes=2, residual=True, damping_ratio=0.0)
    with pytest.raises(ParameterError, match="residual needs a polyline"):
        change(FLEXIBLE, residual=True, damping_ratio=None, damping_ratios=(0.01,) * 9)
