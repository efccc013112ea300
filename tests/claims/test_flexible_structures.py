"""Claim: the shipped flexible bases vibrate as structures that other programs compute.

Frequencies below 20 Hz with the default number of modes, against CalculiX 2.20 (pipes of
three-dimensional bricks) and OpenSees 3.7.1 (frames): figures recorded with
`scripts/validate_structures.py`, computed again where the programs are installed.

Tolerances: 1 % is promised. The differences that are left are the truncation to 5 and 8
modes (0.4 %), shear and the bricks' rigid elbow (0.2 %).
"""

import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

from ves_gym._util.optional import installed
from ves_gym.planners.suites import get_suite, part_of
from ves_gym.system.system import System

SCRIPTS = Path(__file__).parents[2] / "scripts"
SCRIPT = runpy.run_path(str(SCRIPTS / "validate_structures.py"))
BEAMS, ours, arm_inertia = (SCRIPT[name] for name in ("BEAMS", "ours", "arm_inertia"))
PROMISED = 1e-2

CALCULIX = {  # beam, kg on the flange -> Hz; `scripts/validate_structures.py calculix`
    ("bent", 0.0): "0.8482 0.9055 2.3475 2.4684 12.0777 12.1355 17.5766 17.7919",
    (
        "straight-vertical",
        0.0,
    ): "0.4486 0.4486 2.8106 2.8106 7.8672 7.8672 15.4098 15.4098",
    ("bent", 60.0): "0.5215 0.5789 1.6685 1.9968 9.5719 10.1545 15.5597 16.1249",
    (
        "straight-vertical",
        60.0,
    ): "0.1686 0.1686 2.0413 2.0413 6.4538 6.4538 13.3719 13.3719",
}
OPENSEES = {  # with the locked arm at q = 0 -> Hz; `scripts/validate_structures.py opensees`
    "bent": "0.4286 0.4790 1.4434 1.8656 8.0934 8.7663 13.6640 15.4138 17.5520",
    "straight-vertical": "0.1300 0.1300 1.7393 1.7542 2.9351 5.0447 5.2885 9.7309 10.1446"
    " 16.7294 17.1006",
    "straight-horizontal": "0.1389 0.1390 1.7348 1.7737 2.1566 4.1991 5.9687 8.4459 11.1585"
    " 15.7163 17.6677",
}


def apart(own, theirs):
    """Largest relative difference of the frequencies below 20 Hz; none may be missing."""
    theirs = np.asarray(theirs)[np.asarray(theirs) < SCRIPT["BAND"]]
    assert np.sum(own < SCRIPT["BAND"]) == len(theirs)
    return float(np.abs(own[: len(theirs)] / theirs - 1).max())


def numbers(text):
    return [float(k) for k in text.split()]


@pytest.mark.parametrize(("name", "load"), CALCULIX)
def test_frequencies_are_those_of_calculix(name, load):
    own = ours(BEAMS[name][1], np.diag([load] * 3 + [0.0] * 3))
    error = apart(own, numbers(CALCULIX[name, load]))
    print(f"{name}, {load:g} kg: {error:.2e}")
    assert error <= PROMISED / 2


@pytest.mark.parametrize("name", OPENSEES)
def test_frequencies_with_the_arm_are_those_of_opensees(name):
    error = apart(ours(BEAMS[name][1], arm_inertia()), numbers(OPENSEES[name]))
    print(f"{name}: {error:.2e}")
    assert error <= PROMISED / 2


def test_the_condensed_beam_is_not_what_they_compute():
    """Both sides: six condensed modes miss frequencies, or are off by more than 10 %."""
    beam = BEAMS["bent"][0]
    mass = beam.consistent_mass() + arm_inertia()
    squares = np.linalg.eigvals(np.linalg.solve(mass, beam.stiffness())).real
    own = np.sqrt(np.sort(squares)) / (2 * np.pi)
    theirs = numbers(OPENSEES["bent"])
    assert len(own) < len(theirs)
    assert np.abs(own[:5] / theirs[:5] - 1).max() > 0.1


def test_masses_stand_for_the_arm():
    """The point masses that OpenSees is given have the arm's spatial inertia."""
    H = arm_inertia()
    total = np.zeros((6, 6))
    for mass, at in SCRIPT["point_masses"](H):
        way = np.hstack([np.eye(3), -SCRIPT["skew"](at)])
        total += mass * way.T @ way
    assert total == pytest.approx(H, abs=1e-9 * np.abs(H).max())


@pytest.mark.parametrize("name", BEAMS)
def test_the_default_number_of_modes_suffices(name):
    """Frequencies below 20 Hz in 60 poses against 40 modes; E_mean against twice as many."""
    needed = runpy.run_path(str(SCRIPTS / "modes_needed.py"))
    beam, base = BEAMS[name]
    few, many = (needed["frequencies"](beam, m) for m in (base.modes, needed["FINE"]))
    assert needed["apart"](few, many, needed["BAND"]) <= PROMISED
    fewer = needed["frequencies"](beam, base.modes - 2)
    assert needed["apart"](fewer, many, needed["BAND"]) > PROMISED

    every = get_suite("reach100", system=System(vehicle=beam), vehicle=name)
    every = part_of(every, first=10)
    queries = [query for _, query in every.queries][5::10]  # one of each duration
    means = [needed["energies"](beam, m, queries) for m in (base.modes, 2 * base.modes)]
    assert means[0] == pytest.approx(means[1], rel=PROMISED)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
@pytest.mark.parametrize(("name", "load"), [("bent", 60.0), ("straight-vertical", 0.0)])
def test_calculix_gives_what_is_recorded(name, load):
    found = SCRIPT["calculix"](BEAMS[name][0], load)
    expected = numbers(CALCULIX[name, load])
    assert found[: len(expected)] == pytest.approx(expected, rel=1e-4)


@pytest.mark.skipif(not installed("openseespy"), reason="package openseespy is not installed")
def test_opensees_gives_what_is_recorded():
    found = SCRIPT["opensees"](BEAMS["bent"][0], SCRIPT["point_masses"](arm_inertia()))
    expected = numbers(OPENSEES["bent"])
    assert found[: len(expected)] == pytest.approx(expected, rel=1e-4)
