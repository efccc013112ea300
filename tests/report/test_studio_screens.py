"""The studio on screens of every kind, by keyboard alone, and how fast it is."""

import os

import numpy as np
import pytest

from tests.report.studio_page import open_page, ready
from ves_gym.planners.query import Query
from ves_gym.report.studio import quiet_via, render_studio, studio_data
from ves_gym.system.system import System

QUERY = Query(
    system=System(),
    start=(0.0, 0.0, 0.0),
    goal=tuple(np.deg2rad([60.0, 40.0, -30.0]).tolist()),
    duration=2.0,
)
REACHED = (
    "0", "1", "2", "map-pair", "map-kind", "duration", "point-add", "joint-2", "save",
    "motion-a", "scene-play", "scene-time", "view", "plotted", "files",
)  # fmt: skip
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def data():
    return studio_data(QUERY, quiet_via(QUERY))


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
    browser.do("document.querySelector('[data-point=\"2\"]').focus()")
    browser.press("ArrowRight")
    browser.do("new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))")
    assert browser.do(goal) - before == pytest.approx(np.deg2rad(1.0))
    assert browser.do("vesStudio.path.tracks['straight line'].E_mean") != mean
    browser.do("document.getElementById('point-add').focus()")
    browser.press("Enter")
    assert browser.do("vesStudio.path.points.length") == 4
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


def test_size_first_picture_and_frames(browser, data, tmp_path):
    size = len(render_studio(data).encode())
    open_page(browser, data, tmp_path)
    first = float(browser.do("document.body.dataset.drawn")) / 1000
    ready(browser)
    via = "vesStudio.setPoint(1, [0.6 + 0.3 * Math.sin(n / 20), 0.3 * Math.cos(n / 20), 0.1])"
    off_the_map = "vesStudio.setPoint(1, [0.6, 0.3, 0.1 + 0.3 * Math.sin(n / 20)])"
    cost = {}
    for name, act in (
        ("playing", "vesStudio.seek((0.016 * n) % 6)"),
        ("dragging", via),
        ("a joint off the map", off_the_map),
    ):
        before = processor_time(browser)
        browser.do(
            f"(async () => {{ for (let n = 0; n < 90; n++) {{ {act};"
            " await new Promise((go) => requestAnimationFrame(go)); } })()"
        )
        used = [v - before.get(k, 0.0) for k, v in processor_time(browser).items()]
        cost[name] = max(max(used), sum(used) / 2) / 90  # s per frame, of two cores
    print(f"page {size / 1e6:.2f} MB, first picture after {first:.2f} s, frames/s on two free")
    print("cores: " + ", ".join(f"{name} {1 / s:.0f}" for name, s in cost.items()))
    assert size <= 5e6
    assert first <= 2.0
    assert all(1 / s >= 30 for s in cost.values())


def processor_time(browser):
    """Seconds of processor time that each thread of the browser used."""
    group, out = os.getpgid(browser._process.pid), {}
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            if os.getpgid(int(pid)) != group:
                continue
            for thread in os.listdir(f"/proc/{pid}/task"):
                with open(f"/proc/{pid}/task/{thread}/schedstat") as file:
                    out[thread] = int(file.read().split()[0]) / 1e9
        except (FileNotFoundError, ProcessLookupError):
            continue
    return out
