"""Every picture of the documentation has its command, and the notebooks run."""

import json
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

from scripts import figures, notebook_pages
from ves_gym.report.notebook import progress_bar

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_every_picture_has_its_command():
    assert sorted(figures.FIGURES) == sorted(p.name for p in figures.PICTURES.iterdir())


def test_the_table_is_up_to_date():
    """Else: `python scripts/figures.py wiring.svg`."""
    assert figures.PAGE.read_text("utf-8") == figures.page()


def test_other_names_are_refused(capsys):
    assert figures.main(["wiring.png"]) == 2
    assert "wiring.svg" in capsys.readouterr().err


def test_the_schematic_is_made(tmp_path):
    figures.FIGURES["wiring.svg"].make(tmp_path / "wiring.svg")
    stored = figures.PICTURES / "wiring.svg"
    assert (tmp_path / "wiring.svg").read_bytes() == stored.read_bytes()


def test_there_is_a_notebook_per_reader():
    hours = sorted((ROOT / "docs" / "site" / "first-hour").glob("*.md"))
    assert [p.stem for p in NOTEBOOKS] == [p.stem for p in hours]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_run_and_of_the_package_alone(path):
    text = path.read_text("utf-8")
    notebook = json.loads(text)
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len(text.encode()) < 300_000
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert not [o for c in code for o in c["outputs"] if o["output_type"] == "error"]
    pictures = [o for c in code for o in c["outputs"] if "image/" in json.dumps(o)]
    assert pictures
    for cell in code:  # nothing of a clone is read, nothing of this machine is stored
        assert not re.search(r"docs/|examples/|scripts|tests|/home|/root|/tmp", _text(cell))


def _text(cell):
    said = [o.get("text", "") for o in cell["outputs"]]
    return "".join(cell["source"]) + "".join("".join(part) for part in said)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    words = [sys.executable, "-m", "scripts.notebooks", "--check", path.stem]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_its_page_on_the_site_shows_code_and_pictures(path):
    page = notebook_pages.page(path)
    assert page.startswith("# You ") and "data:image/" in page
    for cell in json.loads(path.read_text("utf-8"))["cells"]:
        assert "".join(cell["source"]).split("\n", 2)[-1] in page


@pytest.mark.parametrize(
    ("said", "shown"),
    [((0.25, "signatures"), "25 % signatures"), ((0, 0.5, "a & b"), "50 % a &amp; b"),
     (("lqr", 1.0), "100 % lqr"), ((0.333,), "33 % ")],
)  # fmt: skip
def test_a_bar_takes_what_any_verb_says(said, shown, monkeypatch):
    class Shown(list):
        update = list.append

    cells = Shown()
    fake = types.SimpleNamespace(HTML=str, display=lambda html, display_id: cells)
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(display=fake))
    monkeypatch.setitem(sys.modules, "IPython.display", fake)
    progress_bar()(*said)
    assert cells[-1].endswith(f"</progress> {shown}")


def test_without_ipython_there_is_no_bar(monkeypatch):
    monkeypatch.setitem(sys.modules, "IPython.display", None)
    progress_bar()(0.5, "unseen")
