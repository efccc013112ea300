"""The studio on screens of every kind, by keyboard alone, and how fast it is."""

import numpy as np
import pytest

from tests.report.studio_page import open_page, ready
from ves_gym.planners.query import Query
from ves_gym.report.studio import low_energy_waypoints, render_studio, studio_data
from ves_gym.system.system import System

QUERY = Query(
    system=System(),
    start=(0.0, 0.0, 0.0),
    goal=tuple(np.deg2rad([60.0, 40.0, -30.0]).tolist()),
    duration=2.0,
)
REACHED = (
    "0", "1", "2", "3", "map-pair", "map-kind", "duration", "point-add", "joint-2", "save",
    "motion-a", "scene-play", "scene-time", "view", "plotted", "files",
)  # fmt: skip
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data():
    return studio_data(QUERY, low_energy_waypoints(QUERY))


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize(("width", "height"), [(390, 844), (820, 1180), (1280, 900)])
def test_nothing_sticks_out_or_overlaps(browser, data, tmp_path, width, height, dark):
    browser.screen(width, height, dark)
    open_page(browser, data, tmp_path)
    ready(browser)
    browser.picture(tmp_path / f"studio-{width}-{'dark' if dark else 'light'}.png")
    assert browser.obstacles() == []
    assert browser.do("document.documentElement.scrollWidth") <= width
    cut = browser.do(
        "[...document.querySelectorAll('button, select, output, .big, .detail, h2, label')]"
        ".filter((e) => e.offsetParent && e.scrollWidth > e.clientWidth + 1 && e.clientWidth)"
        ".filter((e) => getComputedStyle(e).display !== 'inline').map((e) => e.outerHTML)"
    )
    assert cut == []
    overlapping = browser.do(
        "(() => { const all = [...document.querySelectorAll('#main button, #main select,"
        " #main input, #main figcaption')].filter((e) => e.offsetParent"
        " && !e.classList.contains('handle')).map((e) => [e, e.getBoundingClientRect()]);"
        " return all.flatMap(([a, r], k) => all.slice(k + 1).filter(([b, s]) =>"
        " !a.contains(b) && r.left < s.right - 1 && s.left < r.right - 1"
        " && r.top < s.bottom - 1 && s.top < r.bottom - 1)"
        ".map(([b]) => a.id + ' ' + b.id)); })()"
    )
    assert overlapping == []
    assert browser.errors == []


def test_the_keyboard_does_everything(browser, data, tmp_path):
    browser.screen(1280, 900)
    open_page(browser, data, tmp_path)
    ready(browser)
    order = []
    for _ in range(60):
        browser.press("Tab")
        order.append(
            browser.do(
                "((e) => e.id || e.dataset.point || e.className || e.textContent)"
                "(document.activeElement)"
            )
        )
    for name in REACHED:
        assert name in order, f"{name} is not reached: {order}"
    goal = "vesStudio.path.points.at(-1)[0]"
    before, mean = browser.do(goal), browser.do("vesStudio.path.tracks['straight line'].E_mean")
    browser.do("document.querySelector('[data-point=\"3\"]').focus()")
    browser.press("ArrowRight")
    browser.do("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")
    assert browser.do(goal) - before == pytest.approx(np.deg2rad(1.0))
    assert browser.do("vesStudio.path.tracks['straight line'].E_mean") != mean
    browser.do("document.getElementById('point-add').focus()")
    browser.press("Enter")
    assert browser.do("vesStudio.path.points.length") == 5
    browser.do("document.getElementById('scene-play').focus()")
    browser.press("Enter")
    assert browser.do("vesStudio.film.playing") is True
    assert browser.errors == []


def test_a_finger_drags_a_point(browser, data, tmp_path):
    browser.screen(390, 844)
    open_page(browser, data, tmp_path)
    ready(browser)
    before = browser.do("vesStudio.path.points[1]")
    x, y = browser.do(
        "(() => { const e = document.querySelector('[data-point=\"1\"]');"
        " e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
        " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    touch = "Input.dispatchTouchEvent"
    browser.send(touch, type="touchStart", touchPoints=[{"x": x, "y": y}])
    for k in range(1, 5):
        browser.send(touch, type="touchMove", touchPoints=[{"x": x - 8 * k, "y": y + 6 * k}])
    browser.send(touch, type="touchEnd", touchPoints=[])
    after = browser.do("vesStudio.path.points[1]")
    assert after[0] < before[0] - 0.1 and after[1] < before[1] - 0.1
    assert after[2] == before[2]


def test_whoever_hears_the_page_is_told_what_everything_is(browser, data, tmp_path):
    browser.screen(1280, 900)
    open_page(browser, data, tmp_path)
    ready(browser)
    browser.send("Accessibility.enable")
    nodes = browser.send("Accessibility.getFullAXTree")["nodes"]
    browser.send("Accessibility.disable")
    roles = {"button", "slider", "combobox", "checkbox", "image", "region"}
    seen = [(n["role"]["value"], n["name"]["value"]) for n in nodes if "name" in n]
    nameless = [role for role, name in seen if role in roles and not name.strip()]
    assert nameless == []
    assert len([role for role, _ in seen if role in roles]) > 40


def test_a_page_is_one_small_file(data):
    assert len(render_studio(data).encode()) <= 5e6
