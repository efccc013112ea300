"""The verdict on a motion as the arm plays it, beside that on the motion as it is commanded.

`first_violation` judges a reference. The arm follows it on a servo, over a base that moves,
and between the instants at which a reference is sampled a motion can do what it likes. So an
answer that counts is simulated, and the joints, as they moved at every record, must keep the
limits of the query, arrive, and touch nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.limits import check_limits, middle_of_range
from ves_gym.planners.case import AIM
from ves_gym.planners.obstacles import RESOLUTION, collisions
from ves_gym.planners.query import Plan, Planner, Query, answer_limits, first_violation, solve
from ves_gym.simulation.energy_account import TRUSTED
from ves_gym.simulation.recording import Recording

# Of a speed limit. Motions whose reference lies on it are followed within 1.9 % (`refined` and
# `direct` on reach100, bent-thesis, 2 s: `benchmarks.execution_check`): half is the servo's.
RIPPLE = 0.01
RESERVE = 0.02  # of the speed limits: what planners on the board leave where they can


def executed_violation(query: Query, run: Recording, i: int) -> str | None:
    """Name the first thing that keeps a played motion from being an answer to a query, or None.

    Args:
        query: ends, limits and surroundings.
        run: the motion played and held for `SETTLING` s or more, watched or recorded at every
            physics step.
        i: number of the run.
    """
    arm, steps = query.system.arm, run.closely(i)
    t, q, v = steps.t, steps.q, steps.v
    limits = answer_limits(query)
    loose = {"position": limits["position"] + AIM}
    if "velocity" in limits:
        loose["velocity"] = limits["velocity"] * (1 + RIPPLE)
    values = {"position": q - middle_of_range(arm), "velocity": v}
    broken = check_limits(loose, t, values, arm.sliding).broken
    if broken:
        return f"the arm: {broken[0].short}, tolerance included"
    if t[-1] < run.duration - 1e-9:
        return "the arm stops before the motion ends"
    after = t >= run.duration - 1e-9
    miss = np.abs(q[after] - query.ends[1])
    if miss.max() > AIM:
        k, j = (int(x) for x in np.unravel_index(miss.argmax(), miss.shape))
        return (
            f"the arm: joint {j + 1} is {miss[k, j]:.4f} rad from the goal at t ="
            f" {t[after][k]:.3f} s, at most {AIM:g}"
        )
    if (gap := run.energy_residual(i) or 0.0) > TRUSTED:
        return f"the energy account is open by {gap:.2g}, at most {TRUSTED:g}: no such run"
    return _touched(query, q, steps.y)


def _touched(query: Query, q: Array, y: Array) -> str | None:
    """Shapes that touch, as the arm moved on the base as it moved."""
    if query.surroundings is None:
        return None
    checker = collisions(query.system.ideal(), query.surroundings)
    last = np.inf
    for at, pose in zip(q, y, strict=True):
        if np.abs(at - last).max() < RESOLUTION / 8:
            continue
        last = at  # looked at
        if names := checker.touching(at, pose):
            return f"the arm touches: {', '.join(names)}"
    return None


def solve_with_reserve(
    planner: Planner, query: Query, seed: int = 0, *, reserve: float = RESERVE
) -> Plan:
    """Plan with lower speed limits, so that the arm that follows keeps the query's.

    Where the planner has no answer to that, it plans with the limits as they are; the plan's
    seconds are those of all planning. `reserve`: share of the limits that is left, in [0, 1).
    """
    if query.v_max is None or reserve == 0:
        return solve(planner, query, seed)
    slower = replace(query, v_max=tuple((1 - reserve) * k for k in query.v_max))
    plan = solve(planner, slower, seed)
    within = plan.found and first_violation(query, plan.motion) is None
    if plan.feasible and within:
        return replace(plan, query=query)
    plan_again = solve(planner, query, seed)
    return replace(plan_again, seconds=plan.seconds + plan_again.seconds)
