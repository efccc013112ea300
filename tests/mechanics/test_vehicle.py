"""Vehicles: beams of any shape, satellites, the user's matrices, by name or file."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ves_gym._util.params import ParameterError, write_table
from ves_gym.mechanics.link import diagonal, matrix
from ves_gym.mechanics.modes import modal_damping
from ves_gym.mechanics.vehicle import (
    BENT_THESIS,
    FREE_FLOATING,
    FREE_FLYING,
    STRAIGHT_HORIZONTAL_THESIS,
    STRAIGHT_VERTICAL_THESIS,
    VEHICLES,
    Beam,
    MatrixVehicle,
    get_vehicle,
)

BEAMS = {
    "straight-vertical-thesis": STRAIGHT_VERTICAL_THESIS,
    "straight-horizontal-thesis": STRAIGHT_HORIZONTAL_THESIS,
    "bent-thesis": BENT_THESIS,
    "three segments": Beam(
        segments=((-3.0, 0.0, 0.0), (0.0, 2.0, 1.0), (0.5, -1.0, 4.0)),
        outer_diameter=0.1,
        wall=0.004,
    ),
}
MASS_MODELS = ("thesis", "consistent")


@pytest.fixture(params=BEAMS)
def beam(request):
    return BEAMS[request.param]


# ------------------------------------------------------------------------ by name


def test_vehicles_by_name_and_by_file(tmp_path):
    for name, vehicle in VEHICLES.items():
        assert get_vehicle(name) is vehicle
        for suffix in ("toml", "json"):
            path = tmp_path / f"{name}.{suffix}"
            write_table(path, vehicle)
            assert get_vehicle(path) == get_vehicle(str(path)) == vehicle


def test_an_unknown_vehicle_is_an_error_that_lists_the_known(tmp_path):
    with pytest.raises(ParameterError) as caught:
        get_vehicle("zeppelin")
    for part in ("'zeppelin'", *VEHICLES, ".toml"):
        assert part in str(caught.value)
    with pytest.raises(ParameterError, match="cannot be read"):
        get_vehicle(tmp_path / "absent.toml")
    (tmp_path / "arm.toml").write_text('kind = "arm"')
    with pytest.raises(ParameterError, match=r"arm\.toml\.kind must be one of beam"):
        get_vehicle(tmp_path / "arm.toml")


# ------------------------------------------------------------------------- beams


REFUSED = {
    "at least one vector": {"segments": ()},
    r"segments\[1\] .*zero length": {"segments": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))},
    r"segments\[0\] must have shape \(3,\)": {"segments": ((0.0, 1.0),)},
    "outer_diameter must be > 0 m": {"outer_diameter": 0.0},
    "wall must be < half the outer diameter 0.18 m, got 0.09 m": {"wall": 0.09},
    "damping_ratio must be >= 0": {"damping_ratio": -0.01},
    "mass_model must be one of thesis, consistent, got 'lumped'": {"mass_model": "lumped"},
    "damping_model must be one of modal, elementwise": {"damping_model": "none"},
    "thesis needs a tip apart from the clamp, got": {"segments": ((1, 0, 0), (-1, 0, 1e-3))},
}


@pytest.mark.parametrize("message", REFUSED)
def test_a_beam_that_cannot_be_built_is_refused(message):
    with pytest.raises(ParameterError, match=message):
        dataclasses.replace(BENT_THESIS, **REFUSED[message])


def test_a_beam_cut_into_pieces_is_the_same_beam(beam):
    """Splitting a segment adds a node on it and changes no K and no consistent M."""
    pieces = []
    for segment in beam.segments:
        pieces += [tuple(0.3 * np.array(segment)), tuple(0.7 * np.array(segment))]
    cut = dataclasses.replace(beam, segments=tuple(pieces))
    for name in ("stiffness", "consistent_mass", "thesis_mass"):
        whole, parts = getattr(beam, name)(), getattr(cut, name)()
        np.testing.assert_allclose(parts, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("mass_model", MASS_MODELS)
@pytest.mark.parametrize("damping_model", ["modal", "elementwise"])
def test_matrices_are_exactly_symmetric_and_definite(beam, mass_model, damping_model):
    model = dataclasses.replace(
        beam, mass_model=mass_model, damping_model=damping_model
    ).base_model()
    for values in (model.M, model.D, model.K):
        assert (values == values.T).all()
        assert np.linalg.eigvalsh(values)[0] > 0


def is_apart(shape):
    """Tubes of some length, whose tip is not at the clamp."""
    lengths = np.linalg.norm(shape, axis=1)
    return lengths.min() > 0.1 and np.linalg.norm(np.sum(shape, axis=0)) > 0.011 * lengths.sum()


@settings(max_examples=30, deadline=None)
@given(
    shape=st.lists(st.tuples(*[st.floats(-5, 5)] * 3), min_size=1, max_size=4).filter(is_apart),
    ratio=st.floats(0, 0.9),
    mass_model=st.sampled_from(MASS_MODELS),
)
@example(shape=[(1e-8, 0.0, 1.0)], ratio=0.9, mass_model="thesis")  # m L^2 about z is 1e-16
@example(shape=[(2.0, 0.0, 1.0), (-1.9, 0.0, -1.0)], ratio=0.9, mass_model="thesis")
def test_modal_damping_gives_every_mode_the_ratio(shape, ratio, mass_model):
    """For any polyline. Modes that repeat stay within their own subspace: D is diagonal there.

    Tolerance: rounding times condition numbers of M and K up to 1e7 here.
    """
    beam = Beam(
        segments=tuple(shape),
        outer_diameter=0.1,
        wall=0.01,
        damping_ratio=ratio,
        mass_model=mass_model,
    )
    base = beam.base_model()
    squares, modes = scipy.linalg.eigh(base.K, base.M)
    omega = np.sqrt(squares)
    reduced = modes.T @ base.D @ modes / omega
    np.testing.assert_allclose(np.diag(reduced), 2 * ratio, atol=1e-8)
    scaled = reduced * np.sqrt(omega / omega[:, None])  # symmetric scaling
    assert np.abs(scaled - np.diag(np.diag(scaled))).max() < 1e-8


def test_a_tip_at_the_clamp_has_a_consistent_mass():
    shape = ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    base = Beam(segments=shape, outer_diameter=0.1, wall=0.01, mass_model="consistent")
    assert np.linalg.eigvalsh(base.base_model().M)[0] > 0


def test_free_directions_stay_undamped():
    """A rigid-body mode has omega = 0, so no damping."""
    K = np.diag([0.0, 10, 20, 30, 40, 50])
    D = modal_damping(np.eye(6), K, 0.1)
    np.testing.assert_allclose(D, np.diag(0.2 * np.sqrt(np.diag(K))), atol=1e-12)


# -------------------------------------------------------------- matrices, satellites

EYE = diagonal(1, 1, 1, 1, 1, 1)


@pytest.mark.parametrize("name", ["M", "D", "K"])
def test_user_matrices_are_checked_by_name(name):
    good = {"M": EYE, "D": EYE, "K": EYE}
    crooked = np.eye(6)
    crooked[2, 3] = 0.5
    for bad, what in (
        (matrix(crooked), r"symmetric.*\[3,4\] = 0.5"),
        (diagonal(1, 1, 1, 1, 1, -2), "positive semidefinite.*-2"),
    ):
        with pytest.raises(ParameterError, match=f"MatrixVehicle.{name} must be {what}"):
            MatrixVehicle(**{**good, name: bad})


def test_matrices_are_taken_as_they_are_but_for_rounding():
    """What a file with ten digits holds is made symmetric; zeros are a vehicle."""
    K, zero = BENT_THESIS.stiffness(), matrix(np.zeros((6, 6)))
    K[0, 4] *= 1 + 1e-10
    base = MatrixVehicle(M=EYE, D=zero, K=matrix(K)).base_model()
    assert (base.K == base.K.T).all() and not base.D.any() and base.body is None


@pytest.mark.parametrize("satellite", [FREE_FLOATING, FREE_FLYING], ids=["floating", "flying"])
def test_satellites_float(satellite):
    base = satellite.base_model()
    assert not (base.M.any() or base.D.any() or base.K.any())
    np.testing.assert_array_equal(base.mass_matrix, satellite.body.spatial())
    assert base.mass_matrix[0, 0] == 500.0
    assert satellite.thrusters is (satellite is FREE_FLYING)
