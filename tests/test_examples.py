"""Every example runs as it stands, and so does every snippet of the README and the docs."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
DOCS = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / "docs").rglob("*.md")  # but what `make site` writes there
    if not {"api", "notebooks"} & set(path.parts)
)
PAGES = ["README.md", *DOCS]
SLOW = "docs/extending.md"  # arms and effects that nobody has compiled yet
SNIPPETS: dict[str, dict[str, str]] = {}  # folder of pages, or page -> name -> code
for page in PAGES:
    code = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.DOTALL)
    group = "docs/environments" if page.startswith("docs/environments/") else page
    for i, text in enumerate(code):
        if page == "README.md" and "vg.diagnose(" in text:
            continue  # tests/test_api.py runs it, and looks at what it finds
        SNIPPETS.setdefault(group, {})[f"{page}-{i}"] = text
# each in an empty folder with names of its own; the others go on where one fails
RUNNER = """
import json, os, sys, traceback
with open(sys.argv[1], encoding="utf-8") as file:
    snippets = json.load(file)
failed = 0
for k, (name, code) in enumerate(snippets.items()):
    os.makedirs(f"snippet-{k}")
    os.chdir(f"snippet-{k}")
    try:
        exec(compile(code, name, "exec"), {"__name__": "__main__"})
    except BaseException:
        failed = 1
        print(name, traceback.format_exc(), sep="\\n", file=sys.stderr)
    os.chdir("..")
sys.exit(failed)
"""


def run(arguments, folder):
    """Run Python in an empty folder, as a user would beside an installed package."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(example, tmp_path):
    done = run([str(example)], tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert not done.stderr


@pytest.mark.parametrize(
    "group", [pytest.param(k, marks=[pytest.mark.slow] if k == SLOW else []) for k in SNIPPETS]
)
def test_snippets_run(group, tmp_path):
    """One process for the snippets of a page, so that the package is imported once for them."""
    (tmp_path / "snippets.json").write_text(json.dumps(SNIPPETS[group]), "utf-8")
    done = run(["-c", RUNNER, "snippets.json"], tmp_path)
    assert done.returncode == 0, done.stderr


def test_there_are_snippets():
    assert sum(map(len, SNIPPETS.values())) >= 40
