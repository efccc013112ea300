"""The page of a benchmark runs: every part of it is drawn, and no script stops."""

from ves_gym.report.page import write_page


def test_every_part_is_drawn_and_nothing_is_fetched(browser, make_result, tmp_path):
    write_page(make_result(queries=2, points=9), tmp_path / "report.html")
    address = (tmp_path / "report.html").as_uri()
    browser.open(address)
    sizes = browser.do("[...document.querySelectorAll('canvas')].map((c) => c.width)")
    assert browser.errors == []
    assert len(sizes) > 3 and min(sizes) > 100
    assert browser.requests == [address]
