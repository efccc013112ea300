"""The page: everything in one file, nothing in it that the data could abuse; it runs."""

import json
import re

import pytest

from tests.report.conftest import Elements
from ves_gym._util.params import ParameterError
from ves_gym.report.benchmark import write_page

HOSTILE = "</script><script>alert(1)</script><!--<img src=x onerror=alert(2)>{{script}}"


@pytest.fixture
def page(tmp_path):
    def write(result):
        path = tmp_path / "report.html"
        write_page(result, path)
        return path.read_text(encoding="utf-8")

    return write


def embedded(text):
    return json.loads(Elements(text).scripts[0])


def test_the_page_holds_the_data_unchanged(page, make_result):
    result = make_result()
    assert embedded(page(result)) == json.loads(json.dumps(result))
    assert None in [row["t_5"] for row in embedded(page(result))["rows"]]


def test_a_result_of_the_laboratory_is_embedded_with_its_stops(page, make_emulated):
    result = make_emulated(queries=2, points=9)
    data = embedded(page(result))
    assert data["machine"] == result["machine"]
    assert [r["E_mean"] for r in data["rows"] if r["stopped"]] == [None] * 8
    assert all("ideal" in s for t in data["traces"] for s in t["series"])


def test_nothing_is_loaded_from_anywhere(page, make_result):
    text = page(make_result())
    assert not re.search(r"https?:|//cdn|@import|url\(", text)
    elements = Elements(text)
    loading = [
        (tag, name)
        for tag, attributes in elements.tags
        for name in attributes
        if name in ("src", "srcset", "data", "action")
        or (name == "href" and not attributes[name].startswith("#"))
    ]
    assert loading == []
    assert "link" not in {tag for tag, _ in elements.tags}
    policy = [a for t, a in elements.tags if a.get("http-equiv") == "Content-Security-Policy"]
    assert "default-src 'none'" in policy[0]["content"]


@pytest.mark.parametrize("place", ["suite", "command", "planner", "query", "description"])
def test_a_hostile_name_stays_data(page, make_result, place):
    result = make_result(queries=1, durations=(2.0,), points=9)
    plain = page(result)
    if place in ("suite", "command"):
        result[place] = HOSTILE
    elif place == "planner":
        result["planners"][1]["name"] = HOSTILE
    elif place == "query":
        result["rows"][0]["query"] = HOSTILE
    else:
        result["systems"]["bent-thesis"]["description"] = HOSTILE
    text = page(result)
    tags = [[tag for tag, _ in Elements(t).tags] for t in (plain, text)]
    assert tags[0] == tags[1]  # not one element more
    assert embedded(text) == json.loads(json.dumps(result))
    assert Elements(text).scripts[1] == Elements(plain).scripts[1]


def test_the_scripts_set_text_not_markup(page, make_result):
    script = Elements(page(make_result(queries=1, points=9))).scripts[1]
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", script
    )


def test_every_element_the_scripts_look_up_exists(page, make_result):
    text = page(make_result(queries=1, points=9))
    elements = Elements(text)
    ids = {a["id"] for _, a in elements.tags if "id" in a} | {"trace-cursor"}
    queried = set(re.findall(r"\$\(\"([\w-]+)\"\)", elements.scripts[1]))
    assert queried and queried <= ids


@pytest.mark.parametrize(
    "change",
    [
        {"maps": []},
        {"traces": []},
        {"scenes": []},
        {"maps": [], "traces": [], "scenes": [], "rows": [], "summary": [], "planners": []},
    ],
)
def test_a_result_with_less_in_it_is_written(page, make_result, change):
    result = {**make_result(planners=1, queries=1, durations=(2.0,)), **change}
    assert embedded(page(result))["rows"] == json.loads(json.dumps(result["rows"]))


def test_another_schema_is_refused(tmp_path, make_result):
    result = {**make_result(queries=1), "schema": "ves-benchmark/2"}
    with pytest.raises(ParameterError, match=r"ves-benchmark/1.*ves-benchmark/2"):
        write_page(result, tmp_path / "report.html")
    assert list(tmp_path.iterdir()) == []


def test_not_a_number_is_refused(tmp_path, make_result):
    result = make_result(queries=1)
    result["rows"][0]["E_mean"] = float("nan")
    with pytest.raises(ParameterError, match="finite"):
        write_page(result, tmp_path / "report.html")


# ------------------------------------------------------------------ in a browser


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
