"""The laboratory's platform in the pages: its legs, their limits, and how true they are."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.report.studio_page import open_page, ready
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.query import Query
from ves_gym.planners.scenes import platform_data
from ves_gym.report.benchmark import write_page
from ves_gym.report.studio import machine_data, references, studio_data
from ves_gym.report.studio_files import open_item
from ves_gym.simulation.playback import play_motions
from ves_gym.system.disturbance import tool_error
from ves_gym.system.system import System

LAB = System(mode="emulated")
QUERY = Query(system=LAB, start=(0.0, 0.0, 0.0), goal=(0.6, 0.4, -0.3), duration=1.5)


@pytest.fixture(scope="module")
def recording():
    return play_motions(LAB, [QUERY.straight], settle=4.0)


@pytest.fixture(scope="module")
def data():
    space = replace(QUERY, system=LAB.ideal())
    plain = {**studio_data(space, []), "machine": machine_data(LAB)}
    return {**plain, "references": references(LAB, [("straight", QUERY.straight)])}


def test_legs_of_the_page_are_the_platform_s(browser, data, tmp_path):
    """Speeds are also the lengths' own difference in time."""
    open_page(browser, data, tmp_path)
    stewart, rng = LAB.emulator_settings.stewart, np.random.default_rng(0)
    for y, yd in rng.uniform(-0.2, 0.2, (4, 2, 6)):
        lengths, speeds = browser.do(
            f"((p, y, yd) => [vesStudio.legLengths(p, y), vesStudio.legSpeeds(p, y, yd)])("
            f"vesStudio.data.machine.platform, {json.dumps(y.tolist())},"
            f" {json.dumps(yd.tolist())})"
        )
        np.testing.assert_allclose(lengths, stewart.leg_lengths(y), rtol=0, atol=1e-6)
        step = stewart.leg_lengths(y + 1e-4 * yd) - stewart.leg_lengths(y - 1e-4 * yd)
        np.testing.assert_allclose(speeds, step / 2e-4, rtol=0, atol=1e-6)


def test_legs_of_the_page_do_what_those_of_the_laboratory_do(browser, data, tmp_path):
    browser.screen(1280, 900)
    open_page(browser, data, tmp_path)
    ready(browser)
    cells = browser.do(
        "[...document.querySelectorAll('#legs-compared td')].map((e) => e.textContent)"
    )
    errors = [abs(float(cells[k].rstrip(" %").replace("−", "-"))) for k in (3, 6)]
    print(f"legs: largest way {errors[0]} %, speed {errors[1]} % from mode emulated")
    assert max(errors) <= 1.0
    assert float(browser.do("document.getElementById('truth').textContent")[:-2]) < 1.0
    assert browser.do("document.getElementById('legs-true').hidden") is False
    browser.do("document.querySelector('#chart-limits').scrollIntoView()")
    browser.click("#chart-limits")
    shown = browser.do(
        "[...document.querySelectorAll('.chart')].filter((e) => e.offsetParent)"
        ".map((e) => e.textContent).filter((t) => /^(Leg|Tool)/.test(t))"
    )
    assert len(shown) == 6 and sum("% of its limit" in text for text in shown) == 4
    assert browser.errors == []


def test_a_log_of_the_laboratory_moves_the_platform(browser, data, recording, tmp_path):
    recording.log(0).save(tmp_path / "run.csv")
    item = open_item(tmp_path / "run.csv", LAB.ideal())
    track, run = item["track"], recording
    error = np.linalg.norm(tool_error(LAB.arm, run.q[0], run.q_cmd[0], run.y[0]), axis=-1)
    assert max(track["tool"]) == pytest.approx(error.max(), rel=1e-3)
    assert item["machine"]["platform"] == platform_data(LAB)
    assert "machine" not in open_item(tmp_path / "run.csv", LAB)
    in_space = {**data, "machine": machine_data(LAB.ideal()), "references": []}
    open_page(browser, {**in_space, "opened": [item]}, tmp_path)
    assert browser.do("vesStudio.film.views.map((v) => v.run.platform !== null)") == [
        True, False,
    ]  # fmt: skip
    assert browser.errors == []


def test_a_platform_that_stopped_says_so(browser, data, tmp_path):
    far = Motion.straight(QUERY.start, (2.0, 0.9, -1.0), 0.8)
    stiff = replace(LAB.emulator_settings, moment_max=60.0)
    run = play_motions(LAB.replace(emulator=stiff), [far], settle=1.0)
    assert run.events
    run.log(0).save(tmp_path / "stopped.csv")
    item = open_item(tmp_path / "stopped.csv", LAB)
    open_page(browser, {**data, "references": [], "opened": [item]}, tmp_path)
    assert "the platform stopped at" in browser.do(
        "document.getElementById('stops').textContent"
    )


def test_the_player_of_a_benchmark_draws_the_platform(browser, result, tmp_path):
    pictures = []
    for platform in (None, platform_data(LAB)):
        for run in result["scenes"][0]["runs"]:
            run["platform"] = platform
        write_page(result, tmp_path / "report.html")
        browser.open((tmp_path / "report.html").as_uri())
        pictures.append(browser.do("document.querySelector('canvas.view').toDataURL()"))
        assert browser.errors == []
    assert pictures[0] != pictures[1]
