"""Try other packages on the environments: `python scripts/ecosystem.py [NAME ...]`.

Every tests/ecosystem/smoke_NAME.py, and every examples/training/NAME_ppo.py, which must solve
its task, says in its head (PEP 723) what it needs. That, and this project, are installed into
an environment of its own, .venv-ecosystem/NAME, which stays for the next time. Then it runs,
and its line goes into the list of docs/ecosystem.md.
"""

from __future__ import annotations

import argparse
import datetime
import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from scripts.marks import filled  # noqa: E402 - run as a file, the root is not on the path

SMOKE = ROOT / "tests" / "ecosystem"
EXAMPLES = ROOT / "examples" / "training"
PLACE = ROOT / ".venv-ecosystem"
PAGE = ROOT / "docs" / "ecosystem.md"
SECONDS = 900  # for one test

_HEAD = re.compile(r"^# /// script\n((?:#.*\n)+?)# ///$", re.MULTILINE)
_PRINT_VERSION = (
    "import importlib.metadata, sys; print(importlib.metadata.version(sys.argv[1]))"
)


def every_test() -> dict[str, Path]:
    """Return the files that can be run, by name."""
    smoke = {k.stem.removeprefix("smoke_"): k for k in sorted(SMOKE.glob("smoke_*.py"))}
    return smoke | {k.stem: k for k in sorted(EXAMPLES.glob("*_ppo.py"))}


def requirements(test: Path) -> list[str]:
    """Return the dependencies in the head of a test; the first is what it is about."""
    block = _HEAD.search(test.read_text("utf-8"))
    if block is None:
        raise SystemExit(f"{test}: no PEP 723 block that names its dependencies")
    text = "\n".join(line.removeprefix("#").strip() for line in block[1].splitlines())
    names: list[str] = tomllib.loads(text)["dependencies"]
    return names


def install(name: str, needs: list[str], share: Path | None) -> tuple[Path, str]:
    """Return an environment's interpreter, and why it is not ready or "".

    Args:
        name: of the environment in `PLACE`.
        needs: requirements besides this project.
        share: environment whose packages are seen as well, to save room; None: none.
    """
    place = PLACE / name
    python = place / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp = place / ".installed"
    wanted = "\n".join([*needs, str(share or "")])
    if stamp.exists() and stamp.read_text("utf-8") == wanted:
        return python, ""
    shutil.rmtree(place, ignore_errors=True)
    venv.create(place, with_pip=True)
    if share is not None:
        packages = next(share.glob("lib/python*/site-packages"), None)
        if packages is None:
            raise SystemExit(f"--share: {share} is no virtual environment")
        link = next(place.glob("lib/python*/site-packages")) / "00_shared.pth"
        link.write_text(f"{packages}\n", encoding="utf-8")
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    done = subprocess.run(
        [*pip, "--prefer-binary", "-e", str(ROOT), *needs], capture_output=True, text=True
    )
    if done.returncode:
        return python, last_line(done.stderr)
    stamp.write_text(wanted, encoding="utf-8")
    return python, ""


def last_line(text: str) -> str:
    """Return the last line that is not empty."""
    return next((k.strip() for k in reversed(text.splitlines()) if k.strip()), "no output")


def run(test: Path, python: Path) -> tuple[str, str]:
    """Return what a test says it has run, and "passes" or why it does not.

    Args:
        test: file.
        python: interpreter of its environment.
    """
    command = [str(python), str(test)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=SECONDS, cwd=PLACE
        )
    except subprocess.TimeoutExpired:
        return "", f"fails: no end within {SECONDS} s"
    (PLACE / f"{test.stem}.log").write_text(done.stdout + done.stderr, encoding="utf-8")
    if done.returncode:
        return "", f"fails: {last_line(done.stderr)}"
    said = [k.removeprefix("ran: ") for k in done.stdout.splitlines() if k.startswith("ran: ")]
    return (said[-1], "passes") if said else ("", "fails: it says nothing of what it ran")


def row(name: str, test: Path, share: Path | None) -> tuple[str, ...]:
    """Return package, version, what was run, and result of a test."""
    needs = requirements(test)
    package = re.split(r"[\[<>=!~; ]", needs[0])[0]
    python, problem = install(name, needs, share)
    if problem:
        return package, "", "", f"not installed: {problem}"
    version = subprocess.run(
        [str(python), "-c", _PRINT_VERSION, package], capture_output=True, text=True
    ).stdout.strip()
    return package, version, *run(test, python)


def read(page: Path) -> dict[str, tuple[str, ...]]:
    """Return package, version, what was run, result and day by the name of a page's test."""
    found = re.findall(
        r"^- `(\w+)`: (\S+) (\S+), ([\w-]+): (.*)$", page.read_text("utf-8"), re.MULTILINE
    )
    rows = {}
    for name, package, version, day, said in found:
        failed = said.startswith(("fails: ", "not installed: "))
        ran, result = ("", said) if failed else (said, "passes")
        rows[name] = (package, version.strip("-"), ran, result, day)
    return rows


def write(page: Path, rows: dict[str, tuple[str, ...]]) -> None:
    """Write the list; the text around it stays.

    Args:
        page: file with the marks `<!-- table -->` and `<!-- end -->`.
        rows: cells after the first, by the name of the test.
    """
    lines = [
        f"- `{name}`: {package} {version or '-'}, {day}: {ran or result}"
        for name, (package, version, ran, result, day) in sorted(rows.items())
    ]
    table = "\n".join(lines)
    page.write_text(filled(page.read_text("utf-8"), {"table": table}), encoding="utf-8")


def main() -> int:
    """Run the tests named, or all; return 1 if one does not pass."""
    tests = every_test()
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("name", nargs="*", choices=[[], *tests], help="tests; default all")
    parser.add_argument("--share", type=Path, help="environment whose packages are seen too")
    parser.add_argument("--remove", action="store_true", help="remove each environment after")
    args = parser.parse_args()
    PLACE.mkdir(exist_ok=True)
    share = args.share.resolve() if args.share else None
    good = True
    for name in args.name or tests:
        cells = row(name, tests[name], share)
        today = datetime.date.today().isoformat()
        write(PAGE, {**read(PAGE), name: (*cells, today)})  # at once: the next may take long
        print(f"{name} {cells[1]}: {cells[3]}", flush=True)
        good &= cells[3] == "passes"
        if args.remove:
            shutil.rmtree(PLACE / name, ignore_errors=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
