"""Write docs/claims.md from the tests: what is claimed, what judges it, what was missed.

    python scripts/claims.py

A claim is a file of tests/claims. The first paragraph of its docstring says it, the second
says what it is compared with and how closely; a paragraph that begins with "Missed:" says what
was promised and not reached.
"""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "claims.md"
HEAD = """\
# Claims

Each is a file of `tests/claims/`: its tests fail if the claim is false. Run one with
`make test-all ARGS="tests/claims/FILE -rP"`, which prints what it measures. `make test-all`
also runs the *slow* tests; every CI run has three minutes of them. `python scripts/claims.py`
writes this page from those files: claim, what judges it, file, tests.

"""
MISSED = """
## Missed

What was promised, and what came out instead.

"""


def paragraphs(path: Path) -> list[str]:
    """Paragraphs of a file's docstring, each on one line."""
    text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return [" ".join(k.split()) for k in text.split("\n\n")]


def tests(path: Path) -> tuple[int, int]:
    """Test functions of a file: all, and those that are slow."""
    functions = [
        node
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    slow = [f for f in functions if any("slow" in ast.unparse(d) for d in f.decorator_list)]
    return len(functions), len(slow)


def page() -> str:
    """The text of docs/claims.md."""
    rows, missed = [], []
    for path in sorted((ROOT / "tests" / "claims").glob("test_*.py")):
        claim, *rest = paragraphs(path)
        found = [k.removeprefix("Missed:").strip() for k in rest if k.startswith("Missed:")]
        judged = next((k for k in rest if not k.startswith("Missed:")), "")
        count, slow = tests(path)
        claim = re.sub(r"^Claims?( of|:| on)? ?", "", claim)
        claim = claim[:1].upper() + claim[1:].rstrip(".")
        of = f"{count}, {slow} slow" if slow else f"{count}"
        rows.append(f"- **{claim}.** {judged} `{path.name}` {of}")
        missed += [f"- {text} (`{path.name}`)" for text in found]
    return HEAD + "\n".join(rows) + "\n" + MISSED + "\n".join(missed) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
