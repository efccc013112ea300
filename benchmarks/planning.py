"""Planning time by the number of joints: processor time of each planner on reach100.

On the arms that come with the package, bent beam, motor drive, the third of the durations that
the suite asks of each. `python -m benchmarks.planning` prints the table of docs/results.md.
"""

from __future__ import annotations

import argparse
import statistics
import time

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
    args = parser.parse_args()
    arms = args.arms.split(",")
    print("| planner | " + " | ".join(f"{k}, {get_arm(k).n}" for k in arms) + " |")
    print("|---|" + "---|" * len(arms))
    for name in args.planners.split(","):
        row = [planning_seconds(name, arm, args.count) for arm in arms]
        print(f"| `{name}` | " + " | ".join(f"{s:.2f}" for s in row) + " |", flush=True)


if __name__ == "__main__":
    main()
