"""Side-by-side timings, never asserted in a test; and tables of results, which are stored."""

import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def store(path: Path, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write a table of results and the command that measured it, for scripts/results.py.

    Args:
        path: of the file, the command's `--json`.
        columns: heads.
        rows: cells of each: text, numbers (to four digits) or None.
    """
    words = [word for word in sys.orig_argv[1:] if word not in ("--json", str(path))]
    words = [Path(word).name if Path(word).is_absolute() else word for word in words]
    write(path, shlex.join(["python", *words]), columns, rows)


def write(path: Path, command: str, columns: Sequence[str], rows: Sequence[Any]) -> None:
    """Write a table as `store` does, measured by another command."""
    head = json.dumps({"command": command, "columns": columns}, indent=1)[:-2]
    short = [[float(f"{k:.4g}") if isinstance(k, float) else k for k in row] for row in rows]
    lines = ",\n".join(f"  {json.dumps(row)}" for row in short)
    path.write_text(f'{head},\n "rows": [\n{lines}\n ]\n}}\n', encoding="utf-8")
