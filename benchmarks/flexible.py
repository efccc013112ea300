"""What plans leave in a finite-element beam, judged on more modes than the planner knows.

    python -m benchmarks.flexible --vehicle bent --damping 0.05 --queries 100

reach100's questions; E_mean of each planner's motion over the straight line's, both simulated
on the same structure with `--judged` internal modes. Prints a line per duration as it is done.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from ves_gym.mechanics.flexible_base import FlexibleBase
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.simulation.playback import play_motions
from ves_gym.system.system import System


def ratios(
    queries: list[Query], judge: System, planner: str
) -> tuple[list[float], list[float], list[float]]:
    """Return E_mean over the straight line, simulated and predicted, and planning times [s]."""
    simulated, predicted, seconds = [], [], []
    for query in queries:
        begin = time.process_time()
        plan = solve(get_planner(planner), query)
        seconds.append(time.process_time() - begin)
        assert plan.feasible, plan.failure
        run = play_motions(judge, [query.straight, plan.motion], servo=query.servo)
        straight, found = (e.E_mean for e in run.energies())
        simulated.append(found / straight)
        predicted.append(plan.predicted.E_mean / straight)
    return simulated, predicted, seconds


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicle", default="bent")
    parser.add_argument("--damping", type=float, default=0.05, help="ratio of every mode")
    parser.add_argument("--modes", type=int, help="that the planner knows; default: stored")
    parser.add_argument("--judged", type=int, default=14, help="modes of the judge")
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--durations", type=float, nargs="+", default=[1.0, 2.0, 4.0])
    parser.add_argument("--planner", default="refined")
    args = parser.parse_args()
    vehicle = get_vehicle(args.vehicle)
    assert isinstance(vehicle, FlexibleBase)
    vehicle = replace(vehicle, damping_ratio=args.damping)
    described = replace(vehicle, modes=args.modes or vehicle.modes)
    judge = System(vehicle=replace(vehicle, modes=args.judged))
    print(
        f"{args.vehicle}, {100 * args.damping:g} % damping, planned on {described.modes} modes,"
        f" judged on {judge.base.m}; {args.planner}"
    )
    print("T [s]  queries  median  90 %   worst  above 1  simulated/predicted  planning [s]")
    for duration in args.durations:
        suite = reach100(System(), args.vehicle, args.queries, durations=(duration,))
        queries = [replace(q, system=System(vehicle=described)) for _, q in suite.queries]
        simulated, predicted, seconds = map(np.array, ratios(queries, judge, args.planner))
        print(
            f"{duration:5g}  {len(queries):7d}  {np.median(simulated):.4f}"
            f"  {np.quantile(simulated, 0.9):.4f} {simulated.max():.4f}"
            f"  {int((simulated > 1).sum()):7d}  {np.median(simulated / predicted):19.3f}"
            f"  {np.median(seconds):11.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
