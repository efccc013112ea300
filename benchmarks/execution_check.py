"""Answers that the arm keeps: `python -m benchmarks.execution_check [--queries N] [NAME]`.

Per planner and problem of the track *paths*: answers inside the limits as they are commanded,
and those that the simulated arm keeps at every physics step (`planners/execution_check.py`),
with the query's speed limits and with the reserve that is left on the board.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

from ves_gym.leaderboard.problems import get_problem, problems, seeds_of
from ves_gym.leaderboard.tracks.paths import path_queries
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.execution_check import RESERVE, executed_violation, solve_with_reserve
from ves_gym.planners.query import Query, first_violation
from ves_gym.planners.registry import get_planner
from ves_gym.simulation.playback import play_motions

QUICK = (
    "straight",
    "smooth-jerk",
    "shaped-zv",
    "shaped-zvd",
    "reaction-null",
    "direct",
    "refined",
)
_SETTLE = 0.5  # s
_AT_ONCE = 25


def kept(answers: Sequence[tuple[Query, Motion]]) -> Counter[str]:
    """Return how many answers of one problem the arm keeps, and why not the others.

    Args:
        answers: queries with motions that keep their limits as they are commanded.
    """
    out: Counter[str] = Counter()
    for at in range(0, len(answers), _AT_ONCE):
        part = answers[at : at + _AT_ONCE]
        query = part[0][0]
        run = play_motions(
            query.system, [m for _, m in part], servo=query.servo, settle=_SETTLE,
            record_dt=query.system.physics_dt,
        )  # fmt: skip
        for i, (asked, _) in enumerate(part):
            why = executed_violation(asked, run, i)
            kinds = ("velocity", "position", "goal", "touches", "stops")
            out["kept" if why is None else next(k for k in kinds if k in why)] += 1
    return out


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("names", nargs="*", default=QUICK)
    parser.add_argument("--queries", type=int, default=20)
    parser.add_argument("--problem", action="append")
    args = parser.parse_args(words)
    names = args.problem or [p for p in problems("paths") if not p.endswith("-quick")]
    print("| planner | problem | reserve | commanded | kept | why not |")
    print("|---|---|---|---|---|---|")
    for name in args.names or QUICK:
        for problem in (get_problem("paths", p) for p in names):
            queries = path_queries(problem, seeds_of(problem, None))[: args.queries]
            for reserve in (0.0, RESERVE):
                plans = [
                    solve_with_reserve(get_planner(name), q, reserve=reserve) for q in queries
                ]
                answers = [
                    (q, p.motion)
                    for q, p in zip(queries, plans, strict=True)
                    if p.motion is not None and first_violation(q, p.motion) is None
                ]
                counts = kept(answers)
                well = counts.pop("kept", 0)
                why = ", ".join(f"{v} {k}" for k, v in counts.items()) or "-"
                print(
                    f"| {name} | {problem.name} | {reserve:g} | {len(answers)} of"
                    f" {len(queries)} | {well} | {why} |",
                    flush=True,
                )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
