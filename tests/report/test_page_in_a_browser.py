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


def test_an_obstacle_is_seen(browser, tmp_path):
    (tmp_path / "bad.html").write_text(
        '<html lang="en"><title>x</title><img src="data:,"></html>'
    )
    browser.open((tmp_path / "bad.html").as_uri())
    assert browser.obstacles() == ["image-alt: 1 x img"]
