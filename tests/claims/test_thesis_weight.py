"""Claim: from the thesis's own weighing (C.3) the workflow concludes that what is missing is
not in its library, and with the arm's mass parameters in the library names those.

References: the numbers printed in C.3; and, without the workflow, what every cause could
explain at best (`by_hand.py`: formulas of C.2 and least squares).
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from examples.thesis_weight import by_hand
from examples.thesis_weight.diagnose import (
    IDENTIFIED,
    MEASURED,
    stretched,
    verdict,
    write_logs,
)
from ves_gym.diagnosis.constants import EXCESS
from ves_gym.diagnosis.diagnose import MORE, UNKNOWN
from ves_gym.mechanics.arm_library import PUMA_560
from ves_gym.mechanics.gravity import GravityModel, minimal_model
from ves_gym.simulation.gravity_calibration import calibration_poses

FOLDER = Path(by_hand.__file__).parent


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return write_logs(tmp_path_factory.mktemp("logs"), IDENTIFIED)


# ------------------------------------------------------------------------------ by hand


def test_the_formulas_are_those_of_the_package():
    q, y = calibration_poses(PUMA_560, 20)
    model = minimal_model(PUMA_560)
    assert np.allclose(by_hand.directions(q), model.regressor(q), atol=1e-12)
    for x, known in ((by_hand.IDENTIFIED, IDENTIFIED), (by_hand.MEASURED, MEASURED)):
        assert (x == [known.mass, *known.P]).all()
        assert np.allclose(by_hand.weight(x, q, y), known.wrench(PUMA_560, q, y), atol=1e-9)


def test_what_could_have_made_the_difference():
    left = {name: row[2:] for name, row in by_hand.explained().items()}
    for name, (force, moment) in left.items():
        print(f"{name:40s} {force:6.2f} N {moment:6.2f} N m")
    assert left["nothing"] == pytest.approx((7.86, 7.36), abs=5e-3)
    # the forces are one number: 1.5 % of gain, or 1.387 kg
    assert left["one gain for forces, one for moments"][0] < 1e-3
    # no sensor, however it distorts, turns one column of C.3 into the other
    assert left["any matrix and zero of the sensor"][1] > 2.5
    for name in ("turn of the sensor", "error of the platform's tilt", "zeros of the joints"):
        assert left[name][0] > 7.8 and left[name][1] > 6.5
    assert left["payload anywhere on the last link"][1] > 6.5
    assert left["the same, tool's centre of mass"][1] < 1.1  # the foot's beside
    assert max(left["all mass parameters"]) < 1e-9


def test_no_body_of_1_4_kg_and_no_tilt_makes_the_lateral_moment():
    more = by_hand.IDENTIFIED - by_hand.MEASURED
    assert more[2] / more[0] == pytest.approx(0.60, abs=5e-3)  # m beside the axis
    assert more[3] / more[0] == pytest.approx(-6.4, abs=0.05)  # m below the platform
    assert more[2] / by_hand.MEASURED[0] == pytest.approx(0.0089, abs=5e-5)  # m, all of it
    tilt = more[2] / by_hand.MEASURED[3]
    assert np.rad2deg(tilt) == pytest.approx(0.88, abs=5e-3)
    assert 9.81 * by_hand.MEASURED[0] * tilt == pytest.approx(14.1, abs=0.05)  # N sideways


# ------------------------------------------------------------------------- the workflow


@pytest.mark.slow
def test_what_is_missing_is_not_in_the_library(files):
    found = verdict(MEASURED, files)
    print(found.sentence, [f.candidate.name for f in found.explanations], stretched(found))
    assert found.verdict == UNKNOWN
    assert found.effects == ()
    # where it went beside: into tolerances of the arm, far beyond what those allow
    name, size = stretched(found)[0]
    assert name.startswith("centre of mass") and size >= 4.6


@pytest.mark.slow
def test_the_arm_that_made_the_logs_is_left_alone(files):
    found = verdict(IDENTIFIED, files)
    assert not found.explanations and found.remaining == 0


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True,
    reason="missed: tolerances of three times their size leave 981 and 884 of 2,160",
)
@pytest.mark.parametrize("band", [0.1, 0.5])
def test_other_bands_leave_much_without_a_name(files, band):
    """The library imitates about half of it: which side of half depends on the band."""
    found = verdict(MEASURED, files, band=band)
    print(found.verdict, [f.candidate.name for f in found.explanations], stretched(found))
    assert found.verdict in (UNKNOWN, MORE)
    assert found.remaining > 2 * EXCESS


@pytest.mark.slow
def test_this_package_s_arm_lacks_it_too(files):
    """B.2's masses, with the foot and r1z that C.3's second column does not have."""
    assert verdict(GravityModel.of(PUMA_560), files).verdict == UNKNOWN


@pytest.mark.slow
def test_an_effect_of_one_s_own_is_named():
    done = subprocess.run(  # it registers an effect: in a process of its own
        [sys.executable, str(FOLDER / "own_effect.py")],
        env={**os.environ, "PYTHONPATH": str(FOLDER.parents[1])},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Missing: arm/weight (") and "one of" not in lines[0]
    numbers = next(k for k in lines if k.startswith("  arm/weight: mass"))
    found = np.array([float(k.split()[1]) for k in numbers.split(": ")[1].split(", ")])
    more = by_hand.IDENTIFIED - by_hand.MEASURED
    print("off by", (found - more).round(4))
    assert np.abs(found - more).max() < 0.02  # kg, kg m
    assert "tolerances stretched: none" in lines
