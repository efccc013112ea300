"""Peers that learn: they train by themselves, and enter as any policy does."""

import pytest

from scripts.leaderboard import LEARNED, PEER_FILES, Wanted, answer
from ves_gym._util.own import import_own


@pytest.mark.parametrize("name", LEARNED)
def test_stable_baselines3_enters_with_its_own_settings(name, monkeypatch):
    pytest.importorskip("stable_baselines3")
    trainer = import_own(str(PEER_FILES / "sb3.py"))
    algorithm, _ = trainer.ALGORITHMS[name]
    monkeypatch.setitem(trainer.ALGORITHMS, name, (algorithm, 128))
    entry = answer(Wanted("damping", "ves/PumaDamp-v0-quick", name), None)
    assert (entry.author, entry.name, entry.method.kind) == ("peer", name, "policy")
    assert entry.about["training"]["algorithm"] == f"Stable-Baselines3 {algorithm}"
    assert entry.results["score"].shape == (1, 10)
