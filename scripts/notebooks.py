"""Run the notebooks and store what they show: `make notebooks`, or `scripts/notebooks.py`.

Each runs in an empty folder with a kernel of its own, so that it reads nothing but the
installed package. With `--check` nothing is stored. Exit status 1 where a cell fails.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
NOTEBOOKS = ROOT / "notebooks"
LIMIT = 300_000  # bytes of a stored notebook
TIMEOUT = 600  # s per cell


def execute(path: Path) -> Any:
    """Run a notebook in an empty folder and return it with its outputs.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell fails.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook: Any = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=TIMEOUT, resources=resources).execute()
    return tidy(notebook)


def tidy(notebook: Any) -> Any:
    """Drop what differs from run to run: times, the kernel's version, bars that are full."""
    notebook.metadata.language_info = {"name": "python"}
    for cell in notebook.cells:
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if not _is_bar(output)]
    return notebook


def _is_bar(output: Any) -> bool:
    return "<progress" in output.get("data", {}).get("text/html", "")


def main() -> int:
    """Run notebooks; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="such as train; default all")
    parser.add_argument("--check", action="store_true", help="store nothing")
    args = parser.parse_args()
    import nbformat
    from nbclient.exceptions import CellExecutionError

    every = {path.stem: path for path in sorted(NOTEBOOKS.glob("*.ipynb"))}
    unknown = set(args.names) - set(every)
    if unknown:
        parser.error(f"notebooks are {', '.join(every)}, got {', '.join(sorted(unknown))}")
    failed = 0
    for name in args.names or every:
        start = time.perf_counter()
        try:
            notebook = execute(every[name])
        except CellExecutionError as error:
            print(f"{name}: {error}", file=sys.stderr)
            failed = 1
            continue
        text = nbformat.writes(notebook) + "\n"
        size = len(text.encode())
        print(f"{name}: {time.perf_counter() - start:.0f} s, {size / 1000:.0f} kB")
        if size > LIMIT:
            print(f"{name}: at most {LIMIT / 1000:.0f} kB are stored", file=sys.stderr)
            failed = 1
        elif not args.check:
            every[name].write_text(text, "utf-8")
    return failed


if __name__ == "__main__":
    sys.exit(main())
