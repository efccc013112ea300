"""Time and size of the benchmark's installation beside that of everything.

`python -m benchmarks.install`: from nothing, each in a directory of its own that goes again.
Every package is downloaded anew for each (no cache of pip's), the smaller set first.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
STAGES = {"benchmark": ".installed-run", "everything": ".installed-dev"}  # stamps of make


@dataclass(frozen=True)
class Installation:
    """An environment as `make` creates it."""

    seconds: float
    gigabytes: float  # 1e9 bytes on disk, byte code and the interpreter's links included
    packages: int


def install(stamp: str, python: str) -> Installation:
    """Create an environment up to a stamp of the Makefile, measure it and remove it.

    Args:
        stamp: name of the file that ends the stage, one of `STAGES`.
        python: interpreter that the environment is made with.

    Returns:
        Wall time, size and number of distributions.

    Raises:
        subprocess.CalledProcessError: make failed; its output was passed on.
    """
    with tempfile.TemporaryDirectory(prefix="ves-install-") as folder:
        venv = Path(folder) / "venv"
        begin = time.perf_counter()
        subprocess.run(
            ["make", "--silent", f"VENV={venv}", f"PYTHON={python}", f"{venv}/{stamp}"],
            cwd=ROOT,
            env={**os.environ, "PIP_NO_CACHE_DIR": "1"},
            check=True,
        )
        seconds = time.perf_counter() - begin
        files = [f for f in venv.rglob("*") if f.is_file() and not f.is_symlink()]
        # st_blocks: what the disk gives, in units of 512 bytes whatever its block size
        size = sum(f.stat().st_blocks * 512 for f in files) / 1e9
        packages = len(list(venv.glob("lib/python*/site-packages/*.dist-info")))
    return Installation(seconds, size, packages)


def main() -> None:
    """Measure both, print a table and the ratios, write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--python", default=sys.executable, help="interpreter to install for")
    args = parser.parse_args()
    results = {}
    for name, stamp in STAGES.items():
        results[name] = done = install(stamp, args.python)
        print(
            f"{name:<11} {done.seconds:6.1f} s  {done.gigabytes:5.2f} GB"
            f"  {done.packages:3} packages",
            flush=True,
        )
    small, everything = results["benchmark"], results["everything"]
    print(
        f"everything takes {everything.seconds / small.seconds:.2f} x the time and"
        f" {everything.gigabytes / small.gigabytes:.2f} x the size"
    )
    if args.json is not None:
        figures = {name: asdict(done) for name, done in results.items()}
        args.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
