"""The studio's link, undo and pictures."""

import json
from urllib.parse import quote
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.report.studio_page import open_page, ready, until
from ves_gym.planners.query import Query
from ves_gym.report.studio import studio_data
from ves_gym.system.system import System

SVG = "{http://www.w3.org/2000/svg}"
STATE = "JSON.stringify(vesStudio.stateOfPage())"


@pytest.fixture(scope="module")
def data():
    goal = tuple(np.deg2rad([60.0, 40.0, -30.0]).tolist())
    query = Query(system=System(), start=(0.0, 0.0, 0.0), goal=goal, duration=2.0)
    return {**studio_data(query, [np.array([0.4, 0.5, -1.0])]), "references": []}


def change_all(browser):
    """Another path, duration, map, pair of motions and view than the page opens with."""
    browser.click("#point-add")
    browser.do("vesStudio.setPoint(1, [0.123456789, 0.2, -0.3])")
    browser.page.locator("#duration").fill("3.7")
    browser.page.locator("#map-pair").select_option(index=2)
    browser.page.locator("#map-kind").select_option("raw")
    browser.page.locator("#motion-a").select_option("drawn path")
    browser.page.locator("#scene-magnify").fill("3")
    browser.click("#scene-swap")
    browser.do("document.querySelector('canvas.view').focus()")
    browser.press("ArrowLeft")
    browser.do("vesStudio.seek(1.2345)")


def test_a_link_restores_the_page_exactly(browser, data, tmp_path):
    address = open_page(browser, data, tmp_path)
    before = json.loads(browser.do(STATE))
    change_all(browser)
    browser.click("#share")
    until(browser, "document.getElementById('link-note').textContent !== ''")
    state, link = json.loads(browser.do(STATE)), browser.do("location.href")
    assert {k for k in state if state[k] == before[k]} == {"machine"}
    assert link.startswith(f"{address}#studio=")
    mean = browser.do("vesStudio.path.tracks['drawn path'].E_mean")
    browser.open(link)
    assert json.loads(browser.do(STATE)) == state
    ready(browser)
    assert browser.do("vesStudio.path.tracks['drawn path'].E_mean") == mean
    assert browser.do("document.getElementById('duration-out').textContent") == "3.7 s"
    assert browser.errors == []


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"machine": "0"}, "another arm or base"),
        ({"points": [[0, 0, 0], [9, 0, 0]]}, "not one of this arm"),
        ({"points": [[0, 0, 0], [0, 0]]}, "not one of this arm"),
        ({"duration": 99}, "not one of this arm"),
        ({"selected": 7}, "not one of this arm"),
        ({"t": None}, "incomplete"),
        ({"points": 3}, "not one of this arm"),
        ({"points": [None, None]}, "cut off or changed"),
        ("%7Bcut", "cut off or changed"),
        ("%", "cut off or changed"),
    ],
)
def test_a_bad_link_is_a_sentence_on_a_whole_page(browser, data, tmp_path, change, why):
    address = open_page(browser, data, tmp_path)
    state = browser.do(STATE)
    if isinstance(change, dict):
        change = quote(json.dumps({**json.loads(state), **change}))
    browser.open(f"{address}#studio={change}")
    note = browser.do("document.getElementById('link-note').textContent")
    assert note.startswith("The link was not opened: ") and why in note
    assert browser.do(STATE) == state
    assert browser.errors == []


def test_what_a_link_shows_and_the_page_lacks_is_named(browser, data, tmp_path):
    address = open_page(browser, data, tmp_path)
    state = json.loads(browser.do(STATE))
    state["controls"]["motion-b"] = "my log"
    state["points"][0][0] = 0.5
    browser.do(f"location.hash = '#studio={quote(json.dumps(state))}'; 0")
    until(browser, "vesStudio.path.points[0][0] === 0.5")
    note = browser.do("document.getElementById('link-note').textContent")
    assert note == "Not on this page: my log."
    assert browser.errors == [] and browser.requests[0] == address


def test_changes_are_undone_and_done_again(browser, data, tmp_path):
    open_page(browser, data, tmp_path)
    drawn = "JSON.stringify([vesStudio.path.points, vesStudio.path.duration])"
    seen = [browser.do(drawn)]
    for change in (
        lambda: browser.click("#point-add"),
        lambda: browser.page.locator("#duration").fill("4"),
        lambda: browser.do("vesStudio.setPoint(0, [0.1, 0.2, 0.3])"),
    ):
        change()
        browser.page.wait_for_timeout(700)  # a step ends where nothing changes
        seen.append(browser.do(drawn))
    for k in (2, 1, 0, 0):
        browser.press("Control+z")
        assert browser.do(drawn) == seen[k]
    assert browser.do("document.getElementById('undo').ariaDisabled") == "true"
    for k in (1, 2):
        browser.press("Control+Shift+Z")
        assert browser.do(drawn) == seen[k]
    browser.click("#redo")
    assert browser.do(drawn) == seen[3]
    browser.click("#undo")
    assert browser.do(drawn) == seen[2]
    assert browser.do("document.getElementById('duration-out').textContent") == "4.0 s"
    assert browser.errors == []


def test_map_and_charts_are_saved_as_svg(browser, data, tmp_path):
    open_page(browser, data, tmp_path)
    until(browser, "vesStudio.chart.image !== null")
    for name, least in (("map", 3), ("charts", 20)):
        with browser.page.expect_download() as saved:
            browser.click(f"#{name}-picture")
        file = tmp_path / f"{name}.svg"
        saved.value.save_as(file)
        root = ElementTree.parse(file).getroot()
        assert root.tag == f"{SVG}svg" and len(list(root.iter(f"{SVG}path"))) >= least
        texts = {text.text for text in root.iter(f"{SVG}text")}
        assert "joint 1 [deg]" in texts if name == "map" else "joint 1" in texts
        assert "NaN" not in file.read_text() and "undefined" not in file.read_text()
        assert len(list(root.iter(f"{SVG}image"))) == (name == "map")
        assert file.stat().st_size < 1e6
    assert browser.errors == []
