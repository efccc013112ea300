"""The finite-element base against closed forms and against its own description."""

import numpy as np
import pytest
import scipy

from ves_gym.diagnosis.benchmark.blind.beam import (
    FRAME_SHARE,
    assembled,
    base_of,
    reduced,
    section,
)

ROOT = 1.8751040687119611  # of cos x cosh x = -1: first bending mode of a cantilever


@pytest.fixture
def straight(description):
    return {**description["vehicle"], "segments": [[0.0, 0.0, 5.0]]}


def test_tip_compliance_of_a_cantilever(straight):
    K, _ = reduced(*assembled(straight), 0)
    C = np.linalg.inv(K)
    area, second = section(straight)
    E, G = (straight["material"][k] for k in ("youngs_modulus", "shear_modulus"))
    L = 5.0
    assert C[0, 0] == pytest.approx(L**3 / (3 * E * second), rel=1e-9)
    assert C[0, 4] == pytest.approx(L**2 / (2 * E * second), rel=1e-9)
    assert C[4, 4] == pytest.approx(L / (E * second), rel=1e-9)
    assert C[2, 2] == pytest.approx(L / (E * area), rel=1e-9)
    assert C[5, 5] == pytest.approx(L / (G * 2 * second), rel=1e-9)


def test_first_frequency_of_a_cantilever(straight):
    """Six elements: 1e-5 of the closed form, from above."""
    K, M = assembled(straight)
    area, second = section(straight)
    material = straight["material"]
    EI, line = material["youngs_modulus"] * second, material["density"] * area
    lowest = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[0])
    exact = ROOT**2 * np.sqrt(EI / (line * 5.0**4))
    assert 0 <= lowest / exact - 1 < 1e-5


def test_base_is_what_the_description_says(description):
    """Tip block of M, D, K against the library's own beam; inner modes lie above them."""
    from ves_gym.system.system import System

    base, said = base_of(description["vehicle"]), System.from_dict(description).base
    for ours, theirs in zip(base, (said.M, said.D, said.K), strict=True):
        assert np.abs(ours[:6, :6] - theirs).max() <= 1e-9 * np.abs(theirs).max()
    tip = np.sqrt(scipy.linalg.eigh(said.K, said.M, eigvals_only=True))
    whole = np.sqrt(scipy.linalg.eigh(base.K, base.M, eigvals_only=True))
    assert whole[:6] == pytest.approx(tip, rel=2e-3)
    assert whole[6] > 2.5 * tip[-1]


def test_light_frame_and_body_add_up_to_a_mass(description):
    vehicle = description["vehicle"]
    _, frame = reduced(*assembled(vehicle), 0)
    body = base_of(vehicle).M[:6, :6] - FRAME_SHARE * frame
    assert np.linalg.eigvalsh(body)[0] > 0
