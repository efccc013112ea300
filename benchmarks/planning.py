"""Planning time by the number of joints: processor time of each planner on reach100.

The arm is the PUMA 560 with as many of its links again as it takes, on the bent beam, motor
drive. `python -m benchmarks.planning` prints the table of docs/planners.md.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import statistics
import time

from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.puma import PUMA_560
from ves_gym.planners.query import solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.suites import reach100
from ves_gym.system.system import System

JOINTS = (3, 5, 6, 7, 9)
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
DURATION = 2.0  # s
COUNT = 5  # queries, and one before them that compiles


def stacked_puma(n: int) -> Arm:
    """The PUMA 560 with n joints: its links over and over."""
    links = tuple(itertools.islice(itertools.cycle(PUMA_560.links), n))
    return dataclasses.replace(PUMA_560, name=f"puma560-{n}", links=links)


def planning_seconds(name: str, n: int, count: int = COUNT) -> float:
    """Median processor time of a planner on an arm of n joints [s].

    Args:
        name: of the planner.
        n: joints.
        count: queries timed.
    """
    system = System(arm=stacked_puma(n))
    suite = reach100(system, "bent", count + 1, durations=(DURATION,))
    planner, seconds = get_planner(name), []
    for _, query in suite.queries:
        begin = time.process_time()
        solve(planner, query)
        seconds.append(time.process_time() - begin)
    return statistics.median(seconds[1:])


def main() -> None:
    """Print a row per planner."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--joints", default=",".join(map(str, JOINTS)), help="like 3,7")
    parser.add_argument("--planners", default=",".join(PLANNERS), help="like direct,refined")
    parser.add_argument("--count", type=int, default=COUNT, help="queries timed")
    args = parser.parse_args()
    joints = [int(k) for k in args.joints.split(",")]
    print("| planner | " + " | ".join(f"{n} joints" for n in joints) + " |")
    print("|---|" + "---|" * len(joints))
    for name in args.planners.split(","):
        row = [planning_seconds(name, n, args.count) for n in joints]
        print(f"| `{name}` | " + " | ".join(f"{s:.2f}" for s in row) + " |", flush=True)


if __name__ == "__main__":
    main()
