"""`ves-gym policy`."""

import pytest


def test_exports_what_other_engines_run(call, tmp_path):
    pytest.importorskip("onnx")
    status, out, err, result = call("policy", "export", "--onnx", "PumaDamp/ppo")
    assert (status, err) == (0, "") and "within" in out
    (row,) = result["onnx"]
    assert row["difference"] <= 1e-6 and (tmp_path / "out" / "PumaDamp-ppo.onnx").exists()


def test_writes_a_card_from_an_evaluation_of_its_own(call, tmp_path):
    pytest.importorskip("safetensors")
    status, _, err, _ = call("policy", "card", "BeamLQR/ppo", "--episodes", 4)
    assert (status, err) == (0, "")
    text = (tmp_path / "out" / "BeamLQR-ppo.md").read_text()
    assert "4 episodes" in text and "**ppo**" in text


def test_bad_input(refused):
    assert "--onnx" in refused("policy", "export", "PumaDamp/ppo")
    assert "pickles" in refused("policy", "card", "PumaDamp/nothing")
