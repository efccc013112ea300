"""Write the table of docs/install.md of what works where: `python scripts/platforms.py UV`.

The index is asked which of the package's requirements can be resolved to wheels on each
platform and Python. UV is the program that resolves: pip takes environment markers from the
machine it runs on, uv from the one that is asked about. `make platforms` gets it and runs this.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from scripts.marks import filled  # noqa: E402 - run as a file, the root is not on the path

PAGE = ROOT / "docs" / "install.md"
MARK = "platforms"
PLATFORMS = {  # column -> uv's name
    "Linux x86-64": "x86_64-manylinux_2_28",
    "Linux arm64": "aarch64-manylinux_2_28",
    "macOS arm64": "aarch64-apple-darwin",
    "macOS x86-64": "x86_64-apple-darwin",
    "Windows x86-64": "x86_64-pc-windows-msvc",
}
MACOS = "15.0"  # the oldest that all of it has wheels for
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
WHAT = {  # row -> its requirements: an extra, a package of the core, or the core ("")
    "simulation, planners, environments": "",
    "planners `ompl-*`": "ompl",
    "figures, GIF (`report`)": "report",
    "MP4 (`movie`)": "movie",
    "Parquet (`parquet`)": "parquet",
    "training (`rl`)": "rl",
    "sweeps on clusters (`scale`)": "scale",
    "`pinocchio_model` (`pinocchio`)": "pinocchio",
}


def requirements(what: str) -> list[str]:
    """Return a row's requirements; a package's marker is dropped: what it says is found here.

    Args:
        what: an extra, a package of the core, or "" for the core without such packages.
    """
    with open(ROOT / "pyproject.toml", "rb") as file:
        project = tomllib.load(file)["project"]
    core = project["dependencies"]
    if not what:
        return [text for text in core if ";" not in text]
    texts = project["optional-dependencies"].get(what)
    texts = texts or [text for text in core if re.match(rf"{what}\b", text)]
    return [text.partition(";")[0] for text in texts]


def resolves(uv: str, texts: list[str], platform: str, python: str) -> str:
    """Resolve requirements to wheels for a machine that need not be this one.

    Args:
        uv: the program.
        texts: requirements.
        platform: uv's name of it.
        python: version, such as "3.12".

    Returns:
        "" if there are wheels for all of them, else the resolver's words.
    """
    options = ["--quiet", "--no-header", "--no-annotate", "--only-binary", ":all:"]
    options += ["--python-platform", platform, "--python-version", python]
    done = subprocess.run(
        [uv, "pip", "compile", "-", *options],
        input="\n".join(texts),
        capture_output=True,
        text=True,
        cwd="/",  # no settings of the project's
        env={**os.environ, "MACOSX_DEPLOYMENT_TARGET": MACOS},
    )
    return " ".join(done.stderr.split()) if done.returncode else ""


def table(uv: str) -> str:
    """Return the table in Markdown; each cell names the Pythons that have wheels."""
    lines = [f"| | {' | '.join(PLATFORMS)} |", "|---" * (len(PLATFORMS) + 1) + "|"]
    core = requirements("")
    machines = [(platform, python) for platform in PLATFORMS.values() for python in PYTHONS]
    for label, what in WHAT.items():
        texts = [*core, *requirements(what)] if what else core  # an extra stands on the core
        with ThreadPoolExecutor(4) as pool:  # they wait for the index
            answers = list(pool.map(lambda m, texts=texts: resolves(uv, texts, *m), machines))
        for machine, why in zip(machines, answers, strict=True):
            if why:
                print(f"{label}, {' '.join(machine)}: {why}", file=sys.stderr)
        good = [machine for machine, why in zip(machines, answers, strict=True) if not why]
        cells = [span([v for p, v in good if p == platform]) for platform in PLATFORMS.values()]
        lines.append(f"| {label} | {' | '.join(cells)} |")
        if not what:
            machines = good  # where the core has no wheels nothing else helps
    return "\n".join(lines)


def span(versions: list[str]) -> str:
    """Return Python versions as a cell: all, none, a range or a list."""
    if not versions:
        return "-"
    if len(versions) == 1:
        return versions[0]
    first, last = (PYTHONS.index(versions[k]) for k in (0, -1))
    whole = tuple(versions) == PYTHONS[first : last + 1]
    return f"{versions[0]}-{versions[-1]}" if whole else ", ".join(versions)


def main() -> None:
    """Ask, and put the table between the two marks of the page."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    text = table(sys.argv[1])
    PAGE.write_text(filled(PAGE.read_text("utf-8"), {MARK: text}), encoding="utf-8")


if __name__ == "__main__":
    main()
