"""Figures on the README and the pages of results come from stored files, tests and scripts."""

import pytest

from scripts.results import PAGES, ROOT, page, strays

NAMES = [path.relative_to(ROOT).as_posix() for path in PAGES]


@pytest.mark.parametrize("name", NAMES)
def test_blocks_say_what_the_stored_files_say(name):
    """Else: `python scripts/results.py`."""
    assert (ROOT / name).read_text("utf-8") == page(ROOT / name)


@pytest.mark.parametrize("name", NAMES)
def test_no_figure_is_typed_that_nothing_produces(name):
    assert strays((ROOT / name).read_text("utf-8")) == []


BLOCK = "<!-- docs/results/planners.json -->\n| a | 0.4217 |\n<!-- end -->"
TYPED = {
    "a number": "It leaves 0.4217 of the energy.",
    "a share": "It solves 4217 % more.",
    "a power of ten": "They agree to 4.217e-9.",
    "a count": "It solves 4217 of 4218 queries.",
    "a cell": "| planner | solved |\n|---|---|\n| `calm` | 4217 |",
    "a cell of two": "| planner | solved |\n|---|---|\n| `calm` | 42, 4217 |",
    "in another section": f"{BLOCK}\n\n## Next\n\nIt leaves 0.4217.",
    "beside a file without it": "`tests/test_figures.py`: it leaves 0.0042 of the energy.",
    "beside a file that is not there": "`tests/nowhere.py`: it leaves 0.4217.",
}


@pytest.mark.parametrize("text", TYPED.values(), ids=TYPED)
def test_a_planted_figure_is_found(text):
    assert len(strays(f"# Results\n\n{text}\n")) == 1


@pytest.mark.parametrize(
    "text",
    [
        f"{BLOCK}\n\nIt leaves 0.4217 of the energy.",
        "`ves_gym/planners/bounds.py`: at most 1.01 times.",
        "`ves_gym/planners/case.py`: within 5 mm, 0.005 rad.",
        "```pycon\n>>> 0.4217\n0.4217\n```\n\nIt leaves 0.4217.",
        "    python -m benchmarks.transfer --x 0.4217\n\n`x=0.4217`, 20 queries in 2 s, §4.2.",
        "Exudyn 1.13.6 and 100 queries of `reach100`.",
    ],
)
def test_what_is_produced_or_no_figure_is_left_alone(text):
    assert strays(f"# Results\n\n{text}\n") == []
