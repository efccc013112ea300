"""Every example runs as it stands, and so does every snippet of the README and the docs."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    *(
        path
        for path in sorted((ROOT / "docs").rglob("*.md"))  # but what `make site` writes there
        if not {"api", "notebooks"} & set(path.parts)
    ),
]
SLOW = "docs/extending.md"  # arms and effects that nobody has compiled yet
LONG = ("vg.diagnose(", "vg.train(")
EXAMPLES = [*(ROOT / "examples").glob("*.py"), *(ROOT / "examples" / "entry").glob("*.py")]
CODE = {str(k): k.read_text("utf-8") for k in sorted(EXAMPLES)}
for page in PAGES:
    snippets = re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    for i, text in enumerate(snippets):
        if page.name != "logs.md" or "vg.diagnose(" not in text:  # tests/test_api.py runs it
            CODE[f"{page.relative_to(ROOT).as_posix()}-{i}"] = text
# each in an empty folder with names of its own; the others go on where one fails
RUNNER = """
import contextlib, io, json, os, sys, traceback
failed = 0
for k, (name, code) in enumerate(json.load(sys.stdin).items()):
    os.makedirs(f"snippet-{k}")
    os.chdir(f"snippet-{k}")
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            exec(compile(code, name, "exec"), {"__name__": "__main__", "__file__": name})
        assert said.getvalue().strip() or not name.endswith(".py"), "an example says something"
        assert "Warning" not in said.getvalue()
    except BaseException:
        failed = 1
        print(name, traceback.format_exc(), said.getvalue(), sep="\\n", file=sys.stderr)
    os.chdir("..")
sys.exit(failed)
"""


def test_no_snippet_is_overlooked():
    """As many are run as fences open; tests/test_api.py runs one."""
    fences = sum(page.read_text("utf-8").count("```python") for page in PAGES)
    assert len(CODE) == len(EXAMPLES) + fences - 1


@pytest.mark.parametrize("slow", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_examples_and_snippets_run(slow, tmp_path):
    """In one process, as a user would beside an installed package."""
    long = {k for k, code in CODE.items() if k.startswith(SLOW) or any(w in code for w in LONG)}
    chosen = {name: code for name, code in CODE.items() if (name in long) == slow}
    assert chosen
    done = subprocess.run(
        [sys.executable, "-c", RUNNER],
        input=json.dumps(chosen),
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
