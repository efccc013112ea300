"""Planning time by the number of joints: processor time of each planner on reach100.

On the arms that come with the package, bent beam, motor drive, the third of the durations that
the suite asks of each. `--json docs/results/planning.json` stores the table.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

from benchmarks import store
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.planners.query import solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100, reach_durations
from ves_gym.system.system import System

PLANNERS = (
    "straight",
    "shaped-zv",
    "bad-path",
    "hotspot-q",
    "hotspot-qt",
    "reaction-null",
    "direct",
    "refined",
)
COUNT = 5  # queries, and one before them that compiles


def planning_seconds(name: str, arm: str, count: int = COUNT) -> float:
    """Median processor time of a planner on an arm [s].

    Args:
        name: of the planner.
        arm: its name.
        count: queries timed.
    """
    system = System(arm=get_arm(arm))
    duration = reach_durations(system.arm)[2]
    suite = reach100(system, "bent", count + 1, durations=(duration,))
    planner, seconds = get_planner(name), []
    for _, query in suite.queries:
        begin = time.process_time()
        solve(planner, query)
        seconds.append(time.process_time() - begin)
    return statistics.median(seconds[1:])


def main() -> None:
    """Print a row per planner."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", default=",".join(arm_names()), help="like ur5e,iiwa14")
    parser.add_argument("--planners", default=",".join(PLANNERS), help="like direct,refined")
    parser.add_argument("--count", type=int, default=COUNT, help="queries timed")
    parser.add_argument("--json", type=Path, help="write the table to this file")
    args = parser.parse_args()
    arms, rows = args.arms.split(","), []
    print("planner", *(f"{k}, {get_arm(k).n} joints" for k in arms), sep="  ")
    for name in args.planners.split(","):
        seconds = [planning_seconds(name, arm, args.count) for arm in arms]
        print(name, *(f"{s:.2f}" for s in seconds), sep="  ", flush=True)
        rows.append([f"`{name}`", *seconds])
    if args.json:
        store(args.json, ["seconds", *(f"`{k}`" for k in arms)], rows)


if __name__ == "__main__":
    main()
