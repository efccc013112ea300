"""Tests of other packages: what they need is read, what they gave is on the page."""

import pytest

from scripts import ecosystem

TESTS = ecosystem.every_test()


def test_every_test_says_what_it_needs_and_is_on_the_page():
    rows = ecosystem.read(ecosystem.PAGE)
    assert len(TESTS) >= 10
    assert set(rows) == set(TESTS)
    for name, test in TESTS.items():
        package, version, ran, result, day = rows[name]
        assert ecosystem.requirements(test)[0].split("[")[0] == package, name
        assert result == "passes" or result.startswith(("fails: ", "not installed: ")), name
        assert bool(ran and version) == (result == "passes") and day.count("-") == 2, name


def test_the_list_is_written_between_its_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("head\n<!-- table -->\nold\n<!-- end -->\ntail\n")
    rows = {
        "b": ("p", "1", "a: b", "passes", "2026-01-01"),
        "a": ("q", "", "", "fails: x", "d"),
    }
    ecosystem.write(page, rows)
    text = page.read_text()
    assert text.startswith("head\n<!-- table -->\n- `a`: q ") and text.endswith(
        "<!-- end -->\ntail\n"
    )
    assert ecosystem.read(page) == rows


def test_a_test_without_its_needs_is_refused(tmp_path):
    test = tmp_path / "smoke_x.py"
    test.write_text("print()\n")
    with pytest.raises(SystemExit, match="no PEP 723 block"):
        ecosystem.requirements(test)
