"""`ves-gym pped`: what it prints, writes, draws and refuses."""

import numpy as np
import pytest

from tests.arms import six_joint_arm
from ves_gym.damping.analysis import analyse
from ves_gym.damping.plant import GainMatrices, plant_at
from ves_gym.mechanics.vehicle import BENT_THESIS, DECOUPLED
from ves_gym.system.system import System

QUICK = ("pped", "--objective", "strain", "--no-figures")
THESIS = ("--vehicle", "bent-thesis")


def test_gains_beside_the_thesis(call):
    system = System(vehicle=BENT_THESIS)
    status, out, err, result = call(*QUICK, *THESIS)
    assert status == 0 and not err
    assert result["schema"] == "ves-pped/1" and result["system"] == system.hash
    assert result["objective"] == "strain" and not result["full"] and result["files"] == []
    assert result["q"] == pytest.approx(np.deg2rad([45, 0, 0]))
    names = [g["name"] for g in result["gains"]]
    assert names == ["thesis high (4.6)", "thesis PPED (4.5)", "by strain", "virtual arm (4.1)"]
    for name in (*names, "poles", "E_int", "N m/rad", "82.29 J"):
        assert name in out
    gains = GainMatrices(np.array(result["K"]), np.array(result["B"]))
    judged = analyse(plant_at(system, result["q"]), gains)
    assert judged.E_int == pytest.approx(result["E_int"])
    assert np.allclose(np.array(result["poles"]) @ [1, 1j], judged.poles)
    for row in result["gains"]:
        assert row["simulated"]["E_int"] == pytest.approx(row["E_int"], rel=0.01)
        assert row["E_int"] >= result["E_int"] and row["t_5"] > 0 and len(row["poles"]) == 18
    assert result["gains"][2]["seconds"] > 0


def test_both_objectives_are_the_default(call):
    status, _, _, result = call("pped", "--no-figures", "--vehicle", "decoupled")
    assert status == 0 and result["objective"] == "strain"
    found = [g["objective"] for g in result["gains"]]
    assert found == [None, None, "estimator", "strain", None]


def test_other_places_displacements_bounds_and_objectives(call):
    status, _, _, result = call(
        "pped", "--q", "-30,20,-40", "--objective", "worst", "--full", "--vehicle", "decoupled",
        "--disturb", "0,0.05,0,0,0,2", "--bounds", "5,500,1,100", "--no-figures", "--seed", "3",
    )  # fmt: skip
    assert status == 0
    assert result["y"] == pytest.approx([0, 0.05, 0, 0, 0, np.deg2rad(2)])
    assert result["bounds"] == {"K": [5, 500], "B": [1, 100]} and result["seed"] == 3
    found = {g["name"]: g for g in result["gains"]}
    assert found["by worst, full"]["worst"] <= found["by worst"]["worst"] * (1 + 1e-3)
    for low, high, key in ((5, 500, "K"), (1, 100, "B")):
        values = np.linalg.eigvalsh(found["by worst, full"][key])
        assert low * (1 - 1e-6) <= values[0] and values[-1] <= high * (1 + 1e-6)


def test_pictures_and_map(call, tmp_path):
    pytest.importorskip("matplotlib")
    words = ("--objective", "strain", "--map", "--points", "2", "--format", "svg", *THESIS)
    status, out, _, result = call("pped", *words)
    assert status == 0 and "configurations that damp best" in out
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {f"pped_{k}.svg" for k in ("poles", "responses", "configurations")}
    assert len(result["files"]) == 3
    left = [c["E_int"] for c in result["configurations"]]
    assert left == sorted(left) and left[0] < result["E_int"]
    assert [m["joints"] for m in result["map"]] == [[1, 2], [1, 3], [2, 3]]
    for section in result["map"]:
        assert np.shape(section["E_int"]) == np.shape(section["promised"]) == (2, 2)
        assert section["fixed"] == result["configurations"][0]["q"]


def test_an_arm_of_six_joints(call, tmp_path):
    system = System(arm=six_joint_arm(), vehicle=DECOUPLED)
    system.save(tmp_path / "six.toml")
    status, out, _, result = call(*QUICK, "--system", tmp_path / "six.toml")
    assert status == 0
    assert "thesis high" not in out and "thesis PPED" not in out  # gains for three joints
    assert np.shape(result["K"]) == (6, 6)


def test_a_displacement_out_of_all_proportion_is_not_simulated(call):
    status, out, _, result = call(*QUICK, "--disturb", "1000,0,0,0,0,0")
    assert status == 0 and "not simulated: simulation" in out
    assert all(g["simulated"] is None for g in result["gains"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--vehicle", "free-floating"), "stiffness in all six directions"),
        (("--mode", "emulated"), "needs mode ideal"),
        (("--drive", "prescribed"), "needs drive motor"),
        (("--q", "45,0"), "--q must be 3 angles"),
        (("--q", "200,0,0"), "joint 1 must be within"),
        (
            ("--objective", "speed"),
            "objective must be one of strain, worst, estimator, both, got 'speed'",
        ),
        (("--bounds", "1,2,3"), "--bounds must be four numbers"),
        (("--bounds", "10,1,0.1,1"), "Bounds.K must be 0 < least < largest, got 10 and 1"),
        (("--disturb", "0,0,0,0,0,0"), "a displacement other than zero"),
        (("--disturb", "0.1"), "--disturb must be six numbers"),
        (("--map", "--points", "1"), "--points must be from 2 to 101, got 1"),
    ],
)
def test_bad_input_is_one_line(refused, words, message):
    assert message in refused("pped", *words)
