"""The documentation site: a page for every public name; it builds without a warning."""

import re
import tomllib
from pathlib import Path

import pytest

from scripts import api_pages, site

ROOT = Path(__file__).parents[1]


def test_every_public_name_has_a_page():
    pages = api_pages.pages()
    listed = [name for names in api_pages.sections().values() for name in names]
    assert len(listed) == len(set(listed))
    assert set(listed) == api_pages.public_names()
    assert len(pages) == 1 + len(api_pages.sections()) + len(listed)  # none takes another's
    for name in listed:
        page = pages[f"{name}.md"]
        assert page.startswith(f"# {name}\n")
        assert ".. auto" in page or re.search(r"The same as \[[\w.]+\]\(([\w.]+\.md)\)", page)
    linked = set(re.findall(r"\(([\w.]+\.md)\)", "".join(pages.values())))
    assert linked <= set(pages)


def test_every_page_of_the_documentation_is_in_the_contents():
    contents = (ROOT / "docs" / "site" / "index.md").read_text("utf-8")
    entries = set(re.findall(r"^([\w./-]+)$", contents, re.MULTILINE))
    for path in (ROOT / "docs").glob("*.md"):
        assert f"../{path.stem}" in entries, path.name


def test_pages_of_names_that_are_gone_are_removed(tmp_path):
    (tmp_path / "ves_gym.gone.md").write_text("# ves_gym.gone\n")
    count = api_pages.write(tmp_path)
    assert len(list(tmp_path.glob("*.md"))) == count
    assert not (tmp_path / "ves_gym.gone.md").exists()


def test_a_dead_link_and_a_dead_anchor_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html#there">1</a><a href="#here">2</a><a href="c.html">3</a>'
        '<a href="b.html#gone">4</a><a href="https://example.org/x">5</a>'
    )
    (tmp_path / "b.html").write_text('<h1 id="there">b</h1><img src="no.png">')
    assert sorted(site.dead_links(tmp_path)) == [
        "a.html: b.html#gone",
        "a.html: c.html",
        "b.html: no.png",
    ]


def test_a_folder_with_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "thesis.txt").write_text("mine")
    assert site.build(tmp_path) == 2
    assert "something else" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_the_citation_has_the_version_of_the_package():
    with open(ROOT / "pyproject.toml", "rb") as file:
        project = tomllib.load(file)["project"]
    text = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\nversion: {project['version']}\n" in text
    assert f"\nlicense: {project['license']}\n" in text


@pytest.mark.slow
def test_the_site_builds_without_a_warning_or_a_dead_link(browser, tmp_path):
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason=f"{package} is not installed: make site")
    assert site.build(tmp_path / "site") == 0
    for name in api_pages.public_names():
        assert (tmp_path / "site" / "site" / "api" / f"{name}.html").is_file()
    text = "".join(p.read_text("utf-8") for p in (tmp_path / "site").rglob("*.html"))
    fetched = re.findall(
        r'<(?:script|img|link|iframe)\b[^>]*(?:src|href)="(https?:[^"]+)', text
    )
    assert not fetched
    # every page of docs/, and of the generated ones a few: they have one template
    top = tmp_path / "site"
    pages = [page for page in top.glob("*.html") if page.name != "index.html"]  # leads on
    pages += (top / "site").glob("*.html")
    pages += sorted((tmp_path / "site" / "site" / "api").glob("*.html"))[:3]
    obstacles = {}
    for page in pages:
        browser.open(page.as_uri())
        obstacles[page.name] = browser.obstacles()
    assert {name: found for name, found in obstacles.items() if found} == {}
    browser.screen(390, 844)  # on a phone a drawer comes in while the keyboard is in it
    browser.open((tmp_path / "site" / "install.html").as_uri())
    for _ in range(6):
        browser.press("Tab")
    browser.page.wait_for_timeout(500)
    assert "internal" in browser.do("document.activeElement.className")
    assert browser.do("document.activeElement.getBoundingClientRect().x") >= 0
