"""`make bench`: every timing of docs/claims.md in one run, as ratios."""

from __future__ import annotations

import argparse
import json
import os
import platform
from dataclasses import asdict
from pathlib import Path

from benchmarks.coupling import COUNT, coupling_against_loop
from benchmarks.simulator import simulator_against_batch, steps_per_second


def main() -> None:
    """Measure, print, and write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    print(
        f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}"
    )
    results = {}
    for n in (1, 256):
        pair = simulator_against_batch(n)
        results[f"simulator_n{n}"] = asdict(pair)
        print(
            f"Simulator n = {n:<4} {pair.ratio:5.2f} of bare batch physics"
            f" ({pair.low:.2f}-{pair.high:.2f}), {steps_per_second(n, pair):,.0f} steps/s"
        )
    pair = coupling_against_loop()
    results["coupling"] = asdict(pair)
    print(
        f"Q(q)             {pair.ratio:5.1f} x a loop over pin.crba"
        f" ({pair.low:.1f}-{pair.high:.1f}), {COUNT / pair.ours:,.0f} Q/s"
    )
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
