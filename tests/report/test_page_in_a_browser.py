"""The page of a benchmark runs: every part of it is drawn, and no script stops."""

import pytest

from ves_gym.report.page import write_page


def test_every_part_is_drawn_and_nothing_is_fetched(browser, make_result, tmp_path):
    write_page(make_result(queries=2, points=9), tmp_path / "report.html")
    address = (tmp_path / "report.html").as_uri()
    browser.open(address)
    sizes = browser.do("[...document.querySelectorAll('canvas')].map((c) => c.width)")
    assert browser.errors == []
    assert len(sizes) > 3 and min(sizes) > 100
    assert browser.requests == [address]


@pytest.mark.parametrize("dark", [False, True])
def test_it_has_no_serious_obstacle(browser, make_result, tmp_path, dark):
    write_page(make_result(queries=2, points=9), tmp_path / "report.html")
    browser.screen(1280, 900, dark)
    browser.open((tmp_path / "report.html").as_uri())
    assert browser.obstacles() == []


@pytest.mark.parametrize("width", [360, 768, 1400])
def test_no_column_of_the_summary_is_out_of_sight(browser, make_result, tmp_path, width):
    """A narrow frame has a block per row, each number under its heading."""
    write_page(make_result(queries=2, points=9), tmp_path / "report.html")
    browser.screen(width, 900)
    browser.open((tmp_path / "report.html").as_uri())
    cut = browser.do(
        "[summary, ...summary.querySelectorAll('tbody :is(th, td)')].filter((e) => {"
        " const a = e.getBoundingClientRect();"
        " const b = summary.parentElement.getBoundingClientRect();"
        " return a.left < b.left - 1 || a.right > b.right + 1; }).length"
    )
    assert cut == 0 and browser.errors == []
    stacked = browser.do("summary.classList.contains('stacked')")
    headings = "[...summary.querySelectorAll('td .label')].every((e) => e.offsetHeight > 0)"
    assert stacked == browser.do(headings)
    assert stacked or width > 768
    assert browser.obstacles() == []


def test_an_obstacle_is_seen(browser, tmp_path):
    (tmp_path / "bad.html").write_text(
        '<html lang="en"><title>x</title><img src="data:,"></html>'
    )
    browser.open((tmp_path / "bad.html").as_uri())
    assert browser.obstacles() == ["image-alt: 1 x img"]
