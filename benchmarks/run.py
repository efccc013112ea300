"""`make bench`: the timings of benchmarks/README.md side by side, as ratios.

make bench ARGS="kernel environments --json out/bench.json"
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from pathlib import Path

from benchmarks import (
    coupling,
    environments,
    kernel,
    laboratory,
    resets,
    simulator,
    startup,
    sweep,
    training,
)

PARTS = {
    "simulator": simulator.report,
    "laboratory": laboratory.report,
    "kernel": kernel.report,
    "coupling": coupling.report,
    "environments": environments.report,
    "resets": resets.report,
    "training": training.report,
    "startup": startup.report,
    "sweep": sweep.report,
}


def main() -> None:
    """Measure, print, and write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"default all: {', '.join(PARTS)}"
    )
    parser.add_argument("--small", action="store_true", help="see that the parts run")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    unknown = [name for name in args.parts if name not in PARTS]
    if unknown:
        parser.error(f"a part is one of {', '.join(PARTS)}, got {unknown[0]}")
    print(
        f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}"
    )
    results = {name: PARTS[name](args.small) for name in args.parts or PARTS}
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
