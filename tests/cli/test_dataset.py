"""`ves-gym dataset`."""

import pytest

RECIPE = """
env = "ves/BeamLQR-v1"
seed = 5
episodes = 2

[[set]]
name = "mixed"
behaviours = ["random", "lqr"]
"""


def test_lists_the_recipes(call):
    status, out, err, result = call("dataset", "list")
    assert (status, err) == (0, "") and "ves/PumaReach-v1/mixed-v0" in out
    assert {"random-v0", "reference-v0", "mixed-v0"} <= {
        s["id"].rpartition("/")[2] for s in result["sets"]
    }


def test_makes_and_checks(call, tmp_path):
    pytest.importorskip("minari")
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "mine.toml"
    file.write_text(RECIPE)
    status, out, err, result = call("dataset", "make", file)
    assert (status, err) == (0, "") and "replayed bit for bit" in out
    (made,) = result["sets"]
    assert made["episodes"] == 2 and made["exact"] and not made["recorded"]

    status, out, _, _ = call("dataset", "check", made["folder"])
    assert status == 0 and "replayed bit for bit" in out
    with h5py.File(tmp_path / "out/ves/BeamLQR-v1/mixed-v0/data/main_data.hdf5", "a") as data:
        data["episode_1"]["rewards"][0] += 0.5
    status, out, err, _ = call("dataset", "check", made["folder"])
    assert status == 1 and "WRONG" in out and "rewards differ by up to 0.5" in err


def test_needs_names_or_all(refused, tmp_path):
    assert "--all" in refused("dataset", "make")
    assert "did you mean" in refused("dataset", "make", "PumaReach-v1/mixd-v0")
    (tmp_path / "mine.toml").write_text(RECIPE)
    assert "--record" in refused("dataset", "make", tmp_path / "mine.toml", "--record")
