"""`ves-gym structure`: from a model's matrices to a vehicle that other commands take."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.finite_elements import polyline
from ves_gym.mechanics.modes_needed import frequencies, modes_needed
from ves_gym.mechanics.puma import PUMA_560
from ves_gym.mechanics.section import ALUMINIUM, Tube
from ves_gym.mechanics.structure import read_structure
from ves_gym.mechanics.vehicle import get_vehicle

ROOT = Path(__file__).parents[2]
MAST = ROOT / "examples" / "mast.pch"
ARGUMENTS = ("--interface", "4", "--units", "m-kg-s")
ARM: Arm = PUMA_560


def test_the_commands_of_the_page_run_one_after_another(call, tmp_path, monkeypatch):
    text = (ROOT / "docs" / "structures.md").read_text("utf-8").replace("\\\n", " ")
    commands = re.findall(r"^    ves-gym (.*)$", text, re.MULTILINE)
    assert [c.split()[0] for c in commands] == ["structure", "simulate"]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    status, out, _, result = call(*shlex.split(commands[0]))
    assert status == 0 and "natural frequencies [Hz]" in out
    assert result["files"] == ["mast.toml", str(tmp_path / "out" / "modes.png")]
    assert Path(result["files"][1]).stat().st_size > 10_000
    assert result["mass"] == pytest.approx(22.91, abs=0.01)
    status, *_ = call(*shlex.split(commands[1]))
    assert status == 0


def test_auto_keeps_the_fewest_modes_with_which_frequencies_are_right(call, tmp_path):
    """Reference: all modes of the model, no reduction but that of the interface."""
    tube = Tube(outer_diameter=0.18, wall=0.007)
    line = np.array([[0.0, 0, 0], [0, 0, 8.0], [8.0, 0, 8.0]])
    frame = polyline(np.diff(line, axis=0), [tube] * 2, ALUMINIUM).divided(4)
    for name, matrix in zip(("mass", "stiff"), frame.matrices(), strict=True):
        scipy.io.mmwrite(tmp_path / f"{name}.mtx", scipy.sparse.coo_array(matrix))
    files = (f"M={tmp_path / 'mass.mtx'}", f"K={tmp_path / 'stiff.mtx'}")
    tip = ",".join(str(k) for k in range(12, 18))
    options = ("--interface", tip, "--units", "m-kg-s", "--held", "0,1,2,3,4,5")
    save = tmp_path / "bent.toml"
    status, _, _, result = call(
        "structure", *files, *options, "--damping", "0.05", "--save", str(save)
    )
    assert status == 0
    structure = read_structure(
        {"M": tmp_path / "mass.mtx", "K": tmp_path / "stiff.mtx"},
        interface=range(12, 18),
        units="m-kg-s",
        held=range(6),
    )
    poses = np.random.default_rng(0).uniform(ARM.column("q_min"), ARM.column("q_max"), (5, 3))
    H = inertia(ARM, poses)[:, :6, :6]
    fine = structure.reduce(40)
    kept = result["modes"]
    assert kept == len(get_vehicle(str(save)).structure.omega)
    for some, right in ((kept, True), (kept - 2, False)):
        worst = 0.0
        for one in H:
            whole = frequencies(fine, one)
            inside = whole[whole < 20.0]
            coarse = frequencies(fine.truncated(some), one)[: len(inside)]
            short = len(coarse) < len(inside)
            worst = max(worst, np.inf if short else np.abs(coarse / inside - 1).max())
        assert (worst < 0.012) == right
    assert modes_needed(fine, H) <= kept + 1


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ((), "the files hold no damping: --damping must give a ratio"),
        (("--damping", "0.01", "--interface", "9"), "node 9 must have the components"),
        (("--damping", "0.01", "--interface", "4,5"), "a node or six freedoms, got '4,5'"),
        (("--damping", "0.01", "--interface", "four"), "whole numbers like 4,5,6, got 'four'"),
        (("--damping", "0.01", "--units", "si"), "units must be one of m-kg-s"),
        (("--damping", "0.01", "--modes", "-1"), "--modes must be a whole number >= 0 or auto"),
        (("--damping", "0.01", "--modes", "99"), "modes must be 0 to 12, got 99"),
        (("--damping", "0.01", "--line", "2:0,0"), "--line must be like 2:0,0,-4"),
        (("--damping", "0.01", "--names", "M=MXX"), "no matrix 'MXX'; known: "),
        (("--damping", "0.01", "--rigid-modes", "6"), "6 rigid motions"),
    ],
)
def test_bad_input_is_named_and_nothing_is_written(call, tmp_path, words, sentence):
    save = tmp_path / "vehicle.toml"
    status, _, error, _ = call("structure", MAST, *ARGUMENTS, *words, "--save", save)
    assert status == 2 and sentence in error
    assert not save.exists()


def test_files_are_one_or_named(call, tmp_path):
    status, _, error, _ = call("structure", MAST, "K=other.npy", *ARGUMENTS)
    assert status == 2 and "M=FILE K=FILE and perhaps D=FILE" in error
