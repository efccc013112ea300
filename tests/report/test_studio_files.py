"""The studio opens files of each kind, by the command and in the page."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.report.studio_page import open_page, ready, until
from ves_gym._util.params import ParameterError
from ves_gym.cli.main import main
from ves_gym.effects import BaseStiffness
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.case import Case, load_case
from ves_gym.planners.query import Query, solve
from ves_gym.planners.shaping import Straight
from ves_gym.report.notebook import Studio
from ves_gym.report.studio import studio_data
from ves_gym.report.studio_files import open_item
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System

SYSTEM = System()
START, GOAL = (0.0, 0.0, 0.0), (0.6, 0.4, -0.3)
QUERY = Query(system=SYSTEM, start=START, goal=GOAL, duration=1.0)


@pytest.fixture(scope="module")
def recording():
    return play_motions(SYSTEM, [QUERY.straight], settle=10.0, record_dt=0.0125)


@pytest.fixture(scope="module")
def files(recording, tmp_path_factory):
    """One file of each kind."""
    folder = tmp_path_factory.mktemp("files")
    recording.log(0).save(folder / "run.csv")
    detour = Motion.through([START, (0.2, 0.4, 0.1), GOAL], 1.0)
    Case(system=SYSTEM, motion=detour).save(folder / "motion.toml")
    solve(Straight(), QUERY).case.save(folder / "plan.toml")
    other = replace(QUERY, system=System(vehicle=get_vehicle("bent-thesis")))
    solve(Straight(), other).case.save(folder / "other.toml")
    softer = SYSTEM.replace(effects=(BaseStiffness(error=-0.2),))
    effect = {
        "kind": "base/stiffness", "slot": "", "name": "base/stiffness",
        "value": {"error": -0.2}, "interval": {"error": [-0.22, -0.18]}, "unit": {"error": "1"},
        "probability": 0.99,
    }  # fmt: skip
    diagnosis = {
        "schema": "ves-diagnose/1", "system": softer.to_dict(), "verdict": "found",
        "sentence": "Missing: base/stiffness (error -0.2).", "effects": [effect],
    }  # fmt: skip
    (folder / "diagnosis.json").write_text(json.dumps(diagnosis))
    return folder


@pytest.fixture(scope="module")
def data():
    return {**studio_data(QUERY, []), "references": []}


def opened(files, *names):
    return [open_item(files / name, SYSTEM) for name in names]


def test_a_log_shows_its_energies_and_modes(files, recording):
    item = open_item(files / "run.csv", SYSTEM)
    track, energies = item["track"], recording.energies()[0]
    assert item["kind"] == "log"
    assert track["E_mean"] == pytest.approx(energies.E_mean, rel=1e-6)
    assert len(track["t"]) == len(track["tau"]) == len(track["ydd"]) <= 600
    assert track["t"][-1] == pytest.approx(5.0, abs=0.03)
    at_rest = np.sum(track["modes"][-1])  # the arm stands at the goal, whose modes these are
    assert at_rest == pytest.approx(track["E"][-1], rel=1e-2)
    assert "machine" not in item


def test_a_diagnosis_brings_its_machine(files):
    item = open_item(files / "diagnosis.json", SYSTEM)
    K = np.array(item["machine"]["base"]["K"])
    np.testing.assert_allclose(K, 0.8 * SYSTEM.base.full()[2], rtol=1e-9)


def test_other_files_are_refused_by_what_they_are(files, tmp_path):
    other = tmp_path / "other.json"
    other.write_text('{"schema": "ves-map/1"}')
    with pytest.raises(ParameterError, match=r"expected a run log.*got 'ves-map/1'"):
        open_item(other, SYSTEM)
    short = Motion.straight([0.0, 0.0], [0.1, 0.1], 1.0)
    with pytest.raises(ParameterError, match="puma560 has 3 joints, got 2"):
        open_item(short, SYSTEM)
    Case().save(tmp_path / "still.toml")
    with pytest.raises(ParameterError, match="the case has no motion"):
        open_item(tmp_path / "still.toml", SYSTEM)
    assert (
        open_item(files / "other.toml", SYSTEM)["machine"]["name"] == "puma560 on bent-thesis"
    )


def test_two_motions_of_files_share_one_cursor(browser, files, data, tmp_path):
    items = opened(files, "run.csv", "motion.toml", "diagnosis.json")
    open_page(browser, {**data, "opened": items}, tmp_path)
    chosen = "['a', 'b'].map((k) => document.getElementById('motion-' + k).value)"
    assert browser.do(chosen) == ["run", "motion"]
    browser.do("document.getElementById('charts').scrollIntoView()")
    browser.do("document.querySelector('.plotted').focus()")
    browser.press("Home")
    browser.press("ArrowRight")
    seen = [e for e in texts(browser) if e]
    assert len(seen) >= 2 and all(text.startswith("0.05 s: E ") for text in seen[:2])
    # the log is that of the straight line: as the page plays it itself
    page = browser.do("vesStudio.path.tracks['straight line'].E_mean")
    assert page == pytest.approx(items[0]["track"]["E_mean"], rel=1e-2)
    browser.do(
        "(() => { const e = document.getElementById('motion-b');"
        " e.value = 'drawn path, diagnosis'; e.dispatchEvent(new Event('change')); })()"
    )
    assert "base/stiffness" in browser.do("document.getElementById('diagnoses').textContent")
    assert browser.errors == []


def texts(browser):
    plots = "[...document.querySelectorAll('.plotted')]"
    return browser.do(f"{plots}.map((e) => e.getAttribute('aria-valuetext'))")


def test_the_page_opens_what_is_json(browser, files, data, tmp_path):
    open_page(browser, data, tmp_path)
    expected = {
        "diagnosis.json": ("Opened: diagnosis.json.", "straight line"),
        "motion.toml": ("Opened: motion.toml.", "motion"),
        "plan.toml": ("Opened: plan.toml.", "plan"),
        "other.toml": ("ves-gym studio --case other.toml", "plan"),
        "run.csv": ("ves-gym studio --open", "plan"),
    }
    for name, (note, chosen) in expected.items():
        browser.page.set_input_files("#files", files / name)
        said = f"document.getElementById('files-note').textContent.includes({json.dumps(name)})"
        until(browser, said)
        assert note in browser.do("document.getElementById('files-note').textContent")
        assert browser.do("document.getElementById('motion-a').value") == chosen
    assert browser.errors == []


@pytest.mark.parametrize(
    "vehicle", ["bent", pytest.param("bent-thesis", marks=pytest.mark.slow)]
)
def test_the_drawn_path_is_played_on_its_machine(browser, tmp_path, capsys, vehicle):
    """What the page saves gives, by the line that it names, the energy that it shows.

    Tolerance: the implicit midpoint rule of the page, 0.7 % at most on the shipped beams; the
    same motion from Python on the same machine agrees to 0.1 %.
    """
    system = System(vehicle=get_vehicle(vehicle))
    query = replace(QUERY, system=system, duration=2.0)
    open_page(browser, {**studio_data(query, []), "references": []}, tmp_path)
    (tmp_path / "case.toml").write_text(browser.do("vesStudio.caseOfDrawn()"))
    shown = browser.do("vesStudio.path.tracks['drawn path'].E_mean")
    case = load_case(tmp_path / "case.toml")
    assert case.system == system
    words = ["simulate", "--case", str(tmp_path / "case.toml"), "--json", "-"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    played = json.loads(capsys.readouterr().out)
    energy = played["energies"]["E_mean"]
    assert energy == pytest.approx(shown, rel=7e-3)
    run = play_motions(system, [case.motion], servo=case.servo, settle=10.0, record_dt=0.0125)
    assert energy == pytest.approx(run.energies()[0].E_mean, rel=1e-3)
    assert browser.errors == []


@pytest.mark.slow
def test_an_episode_is_opened_as_a_log(browser, data, tmp_path):
    keys, log = tmp_path / "keys.txt", tmp_path / "episode.csv"
    keys.write_text("0 q 0.5\n")
    words = ["teleop", "--keys", str(keys), "--log", str(log), "--duration", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    item = open_item(log, SYSTEM)
    open_page(browser, {**data, "opened": [item]}, tmp_path)
    assert browser.do("document.getElementById('motion-a').value") == "episode"
    assert browser.errors == []


@pytest.mark.slow
def test_the_command_writes_a_page_and_json_that_it_opens(browser, files, tmp_path, capsys):
    page, result = tmp_path / "own.html", tmp_path / "result.json"
    words = ["studio", "--vehicle", "bent-thesis", "--out", str(page), "--json", str(result)]
    words += ["--via", "20,30,10", "--open", str(files / "plan.toml")]
    assert main(words) == 0
    assert f"written: {page}" in capsys.readouterr().out
    browser.open(page.as_uri())
    ready(browser)
    assert browser.errors == []
    table = json.loads(result.read_text())
    assert table["schema"] == "ves-studio/1"
    assert table["opened"][0]["machine"]["name"] == "puma560 on bent"
    assert main(["studio", "--vehicle", "servicer-flexible", "--out", str(page)]) == 2
    assert "wheels or appendages" in capsys.readouterr().err


def test_the_studio_runs_inside_a_cell_of_a_notebook(browser, files, recording, tmp_path):
    """What a cell would show: the page in a frame, which asks no one for anything."""
    plan = solve(Straight(), QUERY)
    studio = Studio(
        SYSTEM, goal=GOAL, via=[(0.2, 0.4, 0.1)], duration=1.0, planner=None,
        show=[recording.log(0, "a log"), plan, plan.motion], height=700,
    )  # fmt: skip
    assert repr(studio) == "<Studio: puma560 on bent>"
    cell = tmp_path / "cell.html"
    cell.write_text(f"<!doctype html><body>{studio._repr_html_()}</body>", "utf-8")
    browser.open(cell.as_uri())
    page = "document.querySelector('iframe').contentWindow"
    until(browser, f"{page}.vesStudio && {page}.document.body.dataset.drawn")
    assert browser.do(f"{page}.vesStudio.opened.map((o) => o.name)") == [
        "a log", "straight", "motion",
    ]  # fmt: skip
    drawn = f"{page}.vesStudio.path.tracks['drawn path'].E_mean"
    before = browser.do(drawn)
    browser.do(f"{page}.vesStudio.setPoint(1, [0.9, -0.4, 0.3])")
    until(browser, f"{drawn} !== {before!r}")
    assert browser.errors == []
    assert set(browser.requests) <= {cell.as_uri(), "about:srcdoc"}
    studio.save(tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text("utf-8") == studio.page
    with pytest.raises(ParameterError, match=r"duration must be from 0.5 to 8 s, got 9"):
        Studio(SYSTEM, duration=9.0)
