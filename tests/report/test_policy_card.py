"""Model cards: generated, complete, and current."""

from pathlib import Path

import pytest

from ves_gym._util.params import read_table
from ves_gym.baselines.policy import RELEASED
from ves_gym.report.policy_card import policy_card

ROOT = Path(__file__).parents[2]
CARDS, FIGURES = ROOT / "docs" / "policies", ROOT / "docs" / "training"
NAMES = sorted(
    p.relative_to(RELEASED).with_suffix("").as_posix() for p in RELEASED.glob("*/*.json")
)


def test_every_released_policy_has_a_card_and_no_other():
    assert [p.stem for p in sorted(CARDS.glob("*.md"))] == [n.replace("/", "-") for n in NAMES]


@pytest.mark.parametrize("name", NAMES)
def test_the_committed_card_is_current(name):
    """Else: `ves-gym policy card --figures docs/training --out docs/policies`."""
    pytest.importorskip("safetensors")
    file = name.replace("/", "-")
    text = policy_card(name, read_table(FIGURES / f"{file}.json"))
    assert (CARDS / f"{file}.md").read_text("utf-8") == text
    plain = read_table(RELEASED / f"{name}.json")
    for needed in (plain["weights"], plain["about"]["env"], "95 %", "## Limits", "MIT"):
        assert needed in text


def test_a_card_says_what_a_policy_does_not_solve():
    pytest.importorskip("safetensors")
    figures = read_table(FIGURES / "FreeFlyerReach-ppo.json")  # in the laboratory
    assert "does not solve the task (success" in policy_card("FreeFlyerReach/ppo", figures)
    damp = policy_card("PumaDamp/ppo", read_table(FIGURES / "PumaDamp-ppo.json"))
    assert "does not solve" not in damp
