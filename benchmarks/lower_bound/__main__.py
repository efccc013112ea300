"""How near the lower bound of E_mean comes to the best known energies of reach100.

`python -m benchmarks.lower_bound --durations 1,2 --first 20 --out bounds.jsonl`: one line per
query as it is found, then the distribution of bound over best known energy.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.best_known import best_known
from benchmarks.lower_bound.bound import bound_energy
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

NEAR = 0.7  # of the best known energy


def bound_row(name: str, duration: float, index: int) -> dict[str, Any]:
    """Bound and best known energy [J] of one query, and processor seconds.

    Args:
        name: of the vehicle.
        duration: of the queries [s].
        index: of the query, from 0.

    Returns:
        Plain numbers.
    """
    suite = reach100(System().ideal(), name, index + 1, durations=(duration,))
    query = suite.queries[index][1]
    best = best_known(query)
    began = time.process_time()
    bound = bound_energy(query)
    return {
        "query": query.name,
        "best_known": best,
        "bound": bound.energy,
        "share": bound.energy / best,
        "seconds": time.process_time() - began,
    }


def distribution(rows: list[dict[str, Any]]) -> str:
    """Deciles of the share, and how many reach `NEAR`."""
    share = np.array([r["share"] for r in rows])
    parts = " ".join(f"{x:.2f}" for x in np.percentile(share, [0, 10, 25, 50, 75, 90, 100]))
    near = f"{(share >= NEAR).sum()} of {len(share)} >= {NEAR}"
    seconds = np.median([r["seconds"] for r in rows])
    return f"min, 10, 25, 50, 75, 90 %, max: {parts}; {near}; median {seconds:.1f} s"


def main() -> None:
    """Bound the queries that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--durations", default="1,2,4", help="s, with commas")
    parser.add_argument("--first", type=int, default=100, help="queries of each duration")
    parser.add_argument("--vehicle", default="bent-thesis")
    parser.add_argument("--out", type=Path, help="file of JSON lines to append to")
    asked = parser.parse_args()
    for text in asked.durations.split(","):
        rows = []
        for index in range(asked.first):
            rows.append(bound_row(asked.vehicle, float(text), index))
            if asked.out is not None:
                with asked.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
        print(f"{text} s: {distribution(rows)}")


if __name__ == "__main__":
    main()
