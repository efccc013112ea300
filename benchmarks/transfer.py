"""What plans are worth on machines other than described: suite transfer, by planner.

    python -m benchmarks.transfer --queries 10 --durations 1 2 4 --out out/transfer

Each question is answered once, written to --out, and not asked again. `known` is `refined` told
every machine exactly, without a price: what no plan made before the machine is known can be
expected to beat. Over all machines and questions:

- ratio: E_mean over the straight line's on the same machine;
- excess: E_mean less that of `known`, over the straight line's: the cost of not knowing;
- regret: E_mean over that of `known`;
- price: E_mean on the machine as described over that of `refined`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import store
from ves_gym._util.params import Array, write_text
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.suites import Suite, transfer
from ves_gym.system.system import System

KNOWN = "known"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicle", default="bent")
    parser.add_argument("--queries", type=int, default=10)
    parser.add_argument("--durations", type=float, nargs="+", default=[1.0, 2.0, 4.0])
    parser.add_argument("--planners", default="refined,robust,robust-worst")
    parser.add_argument("--out", type=Path, default=Path("out/transfer"))
    parser.add_argument("--machines", action="store_true", help="a median for every machine")
    parser.add_argument("--json", type=Path, help="write worst deciles to this file")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    planners = ["straight", *args.planners.split(","), KNOWN]
    suite = transfer(System(), args.vehicle, args.queries)
    for duration in args.durations:
        names = dict.fromkeys(q.name for _, q in suite.queries if q.duration == duration)
        table: dict[tuple[str, str, str], float] = {}
        for name in names:
            table |= _answered(suite, name, planners, args.out / args.vehicle)
        machines = list(dict.fromkeys(v for v, _ in suite.queries))
        energy = {
            p: np.array([[table[p, m, q] for q in names] for m in machines]) for p in planners
        }
        _print(args.vehicle, duration, machines, energy, args.machines)
        rows += _rows(duration, energy)
    if args.json:
        columns = ["duration", "planner", "ratio", "excess", "price"]
        store(args.json, columns, rows)


def _answered(
    suite: Suite, question: str, planners: list[str], folder: Path
) -> dict[tuple[str, str, str], float]:
    """E_mean by planner, machine and question [J], from a file of before where there is one."""
    path = folder / f"{question}.json"
    stored: dict[str, dict[str, float]] = {}
    if path.exists():
        stored = json.loads(path.read_text("utf-8"))
    queries = tuple((v, q) for v, q in suite.queries if q.name == question)
    missing = [p for p in planners if p not in stored and p != KNOWN]
    rows: list[dict[str, Any]] = []
    if missing:
        part = replace(suite, queries=queries)
        rows += run_benchmark(part, planners=missing, workers=1)["rows"]
    if KNOWN not in stored:
        actual = {v: q.system.actual for v, q in queries}
        part = replace(suite, queries=queries, described=actual)
        refined = run_benchmark(part, planners=["refined"], workers=1)["rows"]
        rows += [{**row, "planner": KNOWN} for row in refined if row["planner"] == "refined"]
    for row in rows:
        stored.setdefault(row["planner"], {})[row["vehicle"]] = row["E_mean"]
    if rows:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(stored, indent=1))
    return {(p, m, question): e for p, by in stored.items() for m, e in by.items()}


def _rows(duration: float, energy: dict[str, Array]) -> list[list[Any]]:
    """Planners with worst deciles of ratio and excess, and the median of the price."""
    straight, ideal, nominal = (energy[k] for k in ("straight", KNOWN, "refined"))
    return [
        [
            f"{duration:g} s",
            f"`{name}`",
            float(np.quantile(E / straight, 0.9)),
            float(np.quantile((E - ideal) / straight, 0.9)),
            float(np.median(E[0] / nominal[0])),
        ]
        for name, E in energy.items()
        if name != "straight"
    ]


def _print(
    vehicle: str, duration: float, machines: list[str], energy: dict[str, Array], each: bool
) -> None:
    straight, ideal, nominal = (energy[k] for k in ("straight", KNOWN, "refined"))
    count = straight.shape[1]
    print(f"{vehicle}, {duration:g} s, {len(machines)} machines, {count} questions")
    print(
        "planner        described   price (most)  | ratio: median  worst decile  worst"
        "  | worst decile of excess  regret"
    )
    for name, E in energy.items():
        if name == "straight":
            continue
        ratio, price = E / straight, E[0] / nominal[0]
        print(
            f"{name:13s}  {np.median(ratio[0]):9.4f}"
            f"  {np.median(price):6.3f} ({price.max():.3f})"
            f"  | {np.median(ratio):13.4f}  {np.quantile(ratio, 0.9):12.4f}  {ratio.max():.3f}"
            f"  | {np.quantile((E - ideal) / straight, 0.9):22.4f}"
            f"  {np.quantile(E / ideal, 0.9):6.3f}",
            flush=True,
        )
    for k, machine in enumerate(machines) if each else ():
        medians = (f"{p} {np.median((E / straight)[k]):.4f}" for p, E in energy.items())
        print(f"  {machine:28s} {'  '.join(medians)}")


if __name__ == "__main__":
    main()
