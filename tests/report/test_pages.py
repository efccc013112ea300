"""The pages: everything in one file, nothing in it that the data could abuse; they run."""

import json
import re

import pytest

from tests.report.conftest import Elements
from ves_gym._util.params import ParameterError
from ves_gym.report import benchmark
from ves_gym.report import diagnosis as report
from ves_gym.report.diagnosis import render_page

pytest.importorskip("matplotlib")
HOSTILE = "</script><script>alert(1)</script><!--<img src=x onerror=alert(2)>{{script}}"
NAMES = ("joint/coulomb at joint 2", "joint/stribeck at joint 2")
WRITTEN: dict[str, str] = {}  # pages, each written once


def separation(where, likeness, sigma):
    return {"where": where, "likeness": likeness, "sigma": sigma}


@pytest.fixture
def diagnosis():
    """Friction of the second joint, one of two laws; made up, no simulation behind it."""
    channels = [("joint", "tau_1"), ("joint", "tau_2"), ("platform", "phi_x")]
    series = {"t": [0.0, 0.5, 1.0], "f": [0.0, 1.0, 2.0]}
    return {
        "schema": "ves-diagnose/1",
        "verdict": "one of",
        "sentence": f"Missing: one of {{{', '.join(NAMES)}}}.",
        "effects": [
            {"name": NAMES[0], "value": {"torque": 3.0}, "std": {"torque": 0.1},
             "interval": {"torque": (2.8355, 3.1645)}, "unit": {"torque": "N m"},
             "probability": 0.625, "class": list(NAMES)}
        ],
        "null": {"sentence": "The chance of that is 0.3."},
        "hypotheses": {"nothing": 0.25, "joint/coulomb at joint 1": 0.5, "none of these": 0.25},
        "ranking": [
            {"name": name, "value": {"torque": 3.0}, "unit": {"torque": "N m"},
             "screen": gain + 10, "gain": gain, "gain_error": error, "p": 1e-9,
             "probability": p, "chosen": p is not None}
            for name, gain, error, p in (
                (NAMES[0], 812.4, 31.0, 0.625), (NAMES[1], 44.0, None, None)
            )
        ],
        "likeness": {"names": list(NAMES), "matrix": [[1.0, 0.99], [0.97, 1.0]],
                     "classes": [list(NAMES)]},
        "experiments": [
            {"between": list(NAMES), "sentence": "run-2 tells them apart best.",
             "runs": [separation("run-1", 0.99, 0.4), separation("run-2", 0.9, 2.5)],
             "ports": [separation("joint", 0.9, 2.5), separation("platform", 0.0, 0.0)],
             "untested": []}
        ],
        "where": [
            {"port": p, "channel": c, "low": a, "high": b, "before": 30.0, "after": 1.1}
            for p, c in channels
            for a, b in ((0.0, 1.2), (1.2, 12.0))
        ],
        "closest": [],
        "when": [
            {"port": p, "channel": c, "run": r, "step": 1.0,
             "before": [9.0, 30.0], "after": [1.0, 1.2]}
            for p, c in channels for r in ("run-1", "run-3")
        ],
        "remaining": 12.0,
        "remaining_allowed": 1000.0,
        "gap_before": {f"{p}/{c}": 5.0 for p, c in channels},
        "gap_after": {f"{p}/{c}": 1.0 for p, c in channels},
        "final_before": {"joint/tau_2": 7.0, "joint/tau_1": 1.05},
        "final_after": {"joint/tau_2": 1.0, "joint/tau_1": 1.04},
        "gap_intervals": {},
        "final_intervals": {
            f"joint/tau_{k}": {"before": (6.5, 7.5), "after": (0.9, 1.1), "ratio": (0.1, 0.2)}
            for k in (1, 2)
        },
        "worse": [],
        "free": {
            "runs": ["run-2"], "why_not": "", "difference": 1e-14,
            "gaps": [{"signal": "tau", "channel": "tau_2", "unit": "N m", "before": 3.1,
                      "after": 0.25, "noise": 0.24}],
        },
        "replay_difference": 0.0,
        "untestable": {"wrench": ["w"]},
        "weak": ["joint/viscous at joint 3"],
        "steps": ["joint/coulomb at joint 2: gain 812.4 of 17.0 needed"],
        "seconds": {"locate": 1.0, "screen": 2.5},
        "logs": {"run-1": "aa11", "run-2": "bb22"}, "held_back": ["run-2"],
        "machine": "puma560 on beam, emulated", "described": "cc33", "better": "dd44",
        "seed": 7, "version": "0.1.0", "command": "ves-gym diagnose run-1 run-2",
        "diff": "--- described\n+++ system.toml\n+[[effects]]",
        "overlays": [
            {"port": "joint", "channel": "tau_2", "unit": "N m", "run": "run-1", "top": 3.6,
             **series, **{k: [1.0, -1.0, 2.0] for k in ("before", "after")},
             **{k: [30.0, 2.0, 1.0] for k in ("noise_before", "noise_after")}}
        ],
    }  # fmt: skip


@pytest.fixture(params=["benchmark", "diagnosis"])
def page(request, tmp_path):
    """Write the page of a result, and return its file and the result."""
    result = request.getfixturevalue({"benchmark": "result"}.get(request.param, "diagnosis"))
    write = {"benchmark": benchmark, "diagnosis": report}[request.param].write_page
    file = tmp_path / "page.html"
    if request.param not in WRITTEN:
        write(result, file)
        WRITTEN[request.param] = file.read_text("utf-8")
    file.write_text(WRITTEN[request.param], "utf-8")
    return file, result, write


@pytest.fixture
def text_of(tmp_path):
    def write(result):
        benchmark.write_page(result, tmp_path / "report.html")
        return (tmp_path / "report.html").read_text("utf-8")

    return write


def embedded(text):
    return json.loads(Elements(text).scripts[0])


def test_nothing_is_loaded_from_anywhere(page):
    text = page[0].read_text("utf-8")
    assert not re.search(r"https?:|//cdn|@import|url\(", re.sub(r"base64,[\w+/=]+", "", text))
    tags = Elements(text).tags
    loading = [
        (tag, name, value)
        for tag, attributes in tags
        for name, value in attributes.items()
        if name in ("src", "srcset", "data", "action") or (name == "href" and value[0] != "#")
    ]
    assert all(value.startswith("data:image/png;base64,iVBOR") for *_, value in loading)
    assert all(attributes["alt"] for tag, attributes in tags if tag == "img")
    assert not {tag for tag, _ in tags} & {"link", "iframe", "object"}
    (policy,) = [a for _, a in tags if a.get("http-equiv") == "Content-Security-Policy"]
    assert "default-src 'none'" in policy["content"]


def test_another_schema_or_a_number_that_is_none_is_refused(page):
    file, result, write = page
    file.unlink()
    with pytest.raises(ParameterError, match=r"must be '.*', got 'ves-other/1'"):
        write({**result, "schema": "ves-other/1"}, file)
    if write is benchmark.write_page:
        result["rows"][0]["E_mean"] = float("nan")
        with pytest.raises(ParameterError, match="finite"):
            write(result, file)
    assert not file.exists()


@pytest.mark.parametrize("dark", [False, True])
def test_it_is_drawn_and_has_no_serious_obstacle(browser, page, dark):
    browser.screen(1280, 900, dark)
    browser.open(page[0].as_uri())
    sizes = browser.do("[...document.querySelectorAll('canvas, img')].map((c) => c.width)")
    assert len(sizes) > 3 and min(sizes) > 100
    assert browser.requests[0] == page[0].as_uri() and browser.errors == []
    assert all(address.startswith("data:") for address in browser.requests[1:])
    assert browser.obstacles() == []


# ----------------------------------------------------------------------------- benchmark


def test_the_page_holds_the_data_unchanged(text_of, result, emulated):
    for data in (result, emulated):
        assert embedded(text_of(data)) == json.loads(json.dumps(data))


@pytest.mark.parametrize("place", ["suite", "planner", "query", "description"])
def test_a_hostile_name_stays_data(text_of, result, place):
    plain = text_of(result)
    if place == "suite":
        result["suite"] = result["command"] = HOSTILE
    elif place == "planner":
        result["planners"][1]["name"] = HOSTILE
    elif place == "query":
        result["rows"][0]["query"] = HOSTILE
    else:
        result["systems"]["bent"]["description"] = HOSTILE
    text = text_of(result)
    tags = [[tag for tag, _ in Elements(t).tags] for t in (plain, text)]
    assert tags[0] == tags[1]  # not one element more
    assert embedded(text) == json.loads(json.dumps(result))
    assert Elements(text).scripts[1] == Elements(plain).scripts[1]


def test_the_scripts_set_text_not_markup_of_elements_that_are_there(text_of, result):
    elements = Elements(text_of(result))
    script = elements.scripts[1]
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", script
    )
    ids = {a["id"] for _, a in elements.tags if "id" in a} | {"trace-cursor"}
    queried = set(re.findall(r"\$\(\"([\w-]+)\"\)", script))
    assert queried and queried <= ids


def test_a_result_with_less_in_it_is_drawn(browser, result, tmp_path):
    for key in ("maps", "traces", "scenes", "rows", "summary", "planners"):
        result[key] = []  # one after the other
        benchmark.write_page(result, tmp_path / "report.html")
        browser.open((tmp_path / "report.html").as_uri())
        assert browser.errors == [], key


@pytest.mark.parametrize("width", [360, 768, 1400])
def test_no_column_of_the_summary_is_out_of_sight(browser, result, tmp_path, width):
    """A narrow frame has a block per row, each number under its heading."""
    benchmark.write_page(result, tmp_path / "report.html")
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


# ----------------------------------------------------------------------------- diagnosis


def test_the_verdict_is_on_top_and_what_it_rests_on_below(diagnosis):
    text = Elements(render_page(diagnosis)).text
    sentences = [
        diagnosis["sentence"],
        "2.8355 to 3.1645",
        "822",
        "812 ± 31",
        "44.0",
        "< 0.0001",
        "0.625",
        "run-2 tells them apart best.",
        "the runs held back (run-2)",
        "No channel is worse by more than 2 %",
        "7.00 (6.50 to 7.50)",
        "100.0%",  # of tau_2's gap above noise
        "0.25",  # N m, in free run
        "within 1e-14",
        "port wrench: the logs lack w",
        "joint/viscous at joint 3: the runs move too little",
        "+[[effects]]",
        "cc33",
        "3.5",  # seconds in all
    ]
    at = [text.find(words) for words in sentences]
    assert -1 not in at, sentences[at.index(-1)]
    assert at[0] == min(at)


def test_a_gap_without_a_name_is_not_given_one(diagnosis):
    diagnosis |= {"verdict": "not in the library", "sentence": "Something is missing."}
    diagnosis |= {"effects": [], "closest": diagnosis["effects"]}
    text = Elements(render_page(diagnosis)).text
    assert "No name is given." in text and "one of 2" not in text
    missing = text.split("What is missing")[1].split("Where")[0]
    assert "3.1645" in missing and "0.625" not in missing


def test_a_description_that_is_right_has_a_page_too(diagnosis):
    nothing = {"effects": [], "ranking": [], "experiments": [], "steps": [], "diff": ""}
    likeness = {"names": [], "matrix": [], "classes": []}
    diagnosis |= {**nothing, "likeness": likeness, "verdict": "nothing missing"}
    text = Elements(render_page(diagnosis)).text
    assert "Nothing of the library is needed" in text
    assert "the description stays as it is" in text


def test_names_cannot_become_markup(diagnosis):
    plain = json.loads(json.dumps(diagnosis).replace("run-1", "RUN"))
    hostile = json.loads(json.dumps(diagnosis).replace("run-1", HOSTILE))
    del plain["overlays"], hostile["overlays"]
    expected, other = (Elements(render_page(r)).tags for r in (plain, hostile))
    assert [tag for tag, _ in expected] == [tag for tag, _ in other]
