"""docs/environments is what the code says."""

from pathlib import Path

import pytest

from scripts import generate
from ves_gym.envs.registration import IDS

ROOT = Path(__file__).parents[2]
PLACE = ROOT / "docs" / "environments"


@pytest.fixture(scope="module")
def pages():
    """File name -> text, as the generator writes it."""
    return generate.pages()


def test_there_is_a_page_per_id(pages):
    assert sorted(pages) == sorted(["README.md", *(f"{name}.md" for name in IDS)])
    assert sorted(path.name for path in PLACE.glob("*.md")) == sorted(pages)


@pytest.mark.parametrize("name", ["README", *IDS])
def test_page_is_up_to_date(name, pages):
    """Else: `python scripts/generate.py`."""
    assert (PLACE / f"{name}.md").read_text("utf-8") == pages[f"{name}.md"]
