"""What plans are worth on machines other than described: suite transfer, by planner.

    python -m benchmarks.transfer --vehicle bent-flexible --queries 10 --durations 1 2 4

Over all machines and questions: median, worst decile and worst of E_mean over the straight
line's on the same machine, and what each planner costs on the machine as described, over
`refined` (median over the questions).
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.suites import transfer
from ves_gym.system.system import System


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicle", default="bent-flexible")
    parser.add_argument("--queries", type=int, default=10)
    parser.add_argument("--durations", type=float, nargs="+", default=[1.0, 2.0, 4.0])
    parser.add_argument("--planners", default="refined,robust,robust-worst")
    parser.add_argument("--workers", type=int)
    args = parser.parse_args()
    suite = transfer(System(), args.vehicle, args.queries)
    for duration in args.durations:
        part = replace(
            suite, queries=tuple((v, q) for v, q in suite.queries if q.duration == duration)
        )
        rows = run_benchmark(part, planners=args.planners.split(","), workers=args.workers)[
            "rows"
        ]
        table = {(r["planner"], r["vehicle"], r["query"]): r["E_mean"] for r in rows}
        machines, asked = (
            list(dict.fromkeys(r[k] for r in rows)) for k in ("vehicle", "query")
        )
        print(
            f"{args.vehicle}, {duration:g} s, {len(machines)} machines, {len(asked)} questions"
        )
        print("planner       as described   price  | all machines: median  worst decile  worst")
        for name in args.planners.split(","):
            energy, straight, known = (
                np.array([[table[k, m, q] for q in asked] for m in machines])
                for k in (name, "straight", "refined")
            )
            ratio, price = energy / straight, np.median(energy[0] / known[0])
            print(
                f"{name:13s} {np.median(ratio[0]):12.4f}  {price:6.3f}  |"
                f" {np.median(ratio):20.4f}  {np.quantile(ratio, 0.9):12.4f}"
                f"  {ratio.max():.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
