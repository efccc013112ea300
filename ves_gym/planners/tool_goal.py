"""Goals given as tool poses: of all configurations that reach one, the cheapest for the base.

Where an arm has joints left over, or several postures, the goal is a choice. Configurations
are sampled by inverse kinematics, compared by the predicted E_mean of the straight line, the
best moved along what redundancy they have, and planned for; the least plan wins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.linalg

from ves_gym._util.params import Array, ParameterError, to_plain
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.kinematics import ToolPose, tool_twists
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED, Motion
from ves_gym.mechanics.tool_pose import CLOSE, configurations_at, towards_pose
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.obstacles import collisions
from ves_gym.planners.query import Plan, Planner, Query, solve

_STARTS = 128  # of the inverse kinematics
_NODES = 32  # of a prediction while goals are compared
_BEST = 4  # goals moved along their redundancy
_FIRST, _LAST = 0.4, 0.04  # rad: steps along it
_TURNS = 24  # steps at most
_TOO_FAST = 1e9  # J: behind everything that is not


def solve_to_tool(
    planner: Planner, query: Query, pose: ToolPose, seed: int = 0, *, tries: int = 3
) -> Plan:
    """Plan to a tool pose: to the configuration of least predicted E_mean that reaches it.

    Args:
        planner: any object of the `Planner` protocol.
        query: its goal is not used.
        pose: of the tool, base at rest.
        seed: of the planner, >= 0.
        tries: goals planned for, the cheapest straight lines first.

    Returns:
        The plan of least predicted E_mean, feasible ones first; its query has the goal chosen,
        its `info["tool"]` the pose and what the tries cost [J].

    Raises:
        ParameterError: the pose is out of reach.
    """
    goals = choose_goals(query, pose)[:tries]
    if not len(goals):
        raise ParameterError(_out_of_reach(query, pose))
    plans = [solve(planner, replace(query, goal=tuple(goal.tolist())), seed) for goal in goals]
    costs = [p.found and p.predicted.E_mean for p in plans]
    ranks = [
        (not p.feasible, np.inf if k is None else k) for p, k in zip(plans, costs, strict=True)
    ]
    best = plans[ranks.index(min(ranks))]
    info = {"pose": to_plain(pose), "goal": list(best.query.goal), "tried": costs}
    seconds = sum(p.seconds for p in plans)
    return replace(best, seconds=seconds, info={**best.info, "tool": info})


def choose_goals(query: Query, pose: ToolPose) -> Array:
    """Configurations (k, n) that bring the tool to a pose, the cheapest straight line first.

    Those too near an obstacle are left out; those the straight line cannot reach inside the
    speed limits come last. The query's goal is not used.
    """
    arm = query.system.arm
    start, _ = query.ends
    goals = configurations_at(arm, pose, near=start, starts=_STARTS)
    if query.surroundings is not None:
        checker = collisions(query.system.ideal(), query.surroundings)
        goals = np.array([q for q in goals if checker.is_clear(q)]).reshape(-1, arm.n)
    if not len(goals):
        return goals
    cost = _cost(query, goals[0])
    goals = goals[np.argsort(cost(goals), kind="stable")]
    for k in range(min(_BEST, len(goals))):
        goals[k] = _along_redundancy(arm, pose, goals[k], cost)
    if query.surroundings is not None:
        goals = goals[[checker.is_clear(q) for q in goals]]
    return np.asarray(goals[np.argsort(cost(goals), kind="stable")])


def _cost(query: Query, near: Array) -> Callable[[Array], Array]:
    """Predicted E_mean [J] of straight lines to goals (k, n), more where they are too fast.

    Its quadratic form with the inertia halfway to `near`, joints and base as at the start of
    the query: good enough to compare.
    """
    start, _ = query.ends
    limit = np.inf if query.v_max is None else np.array(query.v_max)
    energy = MeanEnergy(
        query.system,
        (start + near) / 2,
        query.duration,
        nodes=_NODES,
        base=query.base,
        start=start,
    )

    def cost(goals: Array) -> Array:
        lines = (Motion.straight(start, goal, query.duration) for goal in goals)
        energies = np.array([energy.of(line) for line in lines])
        fastest = QUINTIC_PEAK_SPEED / query.duration * np.abs(goals - start)
        excess = (fastest / limit).max(axis=1, initial=0.0) - 1
        return np.asarray(np.where(excess <= 0, energies, _TOO_FAST * (1 + excess) + energies))

    return cost


def _along_redundancy(
    arm: Arm, pose: ToolPose, q: Array, cost: Callable[[Array], Array]
) -> Array:
    """Step along the tool's self-motion while that is cheaper; the pose stays."""
    step, least = _FIRST, float(cost(q[None])[0])
    for _ in range(_TURNS):
        free = scipy.linalg.null_space(tool_twists(arm, q)[: pose.size], rcond=1e-6).T
        if step < _LAST or not len(free):
            break
        trials = q + step * np.vstack([free, -free])
        moved, miss = towards_pose(arm, pose, trials, rounds=12)
        costs = np.where(miss <= CLOSE, cost(moved), np.inf)
        k = int(np.argmin(costs))
        if costs[k] < least:
            q, least = moved[k], float(costs[k])
        else:
            step /= 2
    return q


def _out_of_reach(query: Query, pose: ToolPose) -> str:
    """Say how near the tool comes."""
    arm = query.system.arm
    start, _ = query.ends
    middle = (arm.column("q_min") + arm.column("q_max")) / 2
    _, miss = towards_pose(arm, pose, np.array([start, middle]))
    what = "tool pose" if pose.angles is not None else "tool position"
    note = "" if pose.angles is None else " and radians, root of squares"
    clear = "" if query.surroundings is None else " clear of the obstacles"
    return (
        f"{what} {pose.position} m must be within reach of {arm.name}{clear}: no configuration"
        f" was found, the nearest is {miss.min():.3g} m{note} away"
    )
