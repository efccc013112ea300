"""How far a benchmark's energies are from the least there can be, where that is certified."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from ves_gym._util.process_pool import WorkerDied, Workers
from ves_gym.planners.lower_bound import bound_energy
from ves_gym.planners.query import NoPlan, Query, on_one_thread

NOT_ASKED = "not asked for"
_JOINTS = 3  # of more, the bound is little (docs/planners.md) or takes long


def reason_without_bound(query: Query) -> str | None:
    """Say why a query's energy has no certified lower bound; None where it has one."""
    system = query.system
    if system.mode != "ideal":
        return "no bound in the laboratory"
    if system.effects:
        return "no bound with effects"
    if system.arm.n > _JOINTS:
        return f"no bound of {system.arm.n} joints"
    if system.base.internal is not None:
        return f"no bound on a base with {system.base.m} internal modes"
    if query.is_moving or query.base is not None:
        return "no bound where arm or base move at the start"
    return None


def add_gaps(
    rows: Sequence[dict[str, Any]],
    queries: Sequence[tuple[str, Query]],
    asked: bool,
    workers: int | None,
    report: Callable[[str, float], None],
) -> None:
    """Give rows `bound` [J], `gap` = E_mean / bound, and `no_gap`, the reason where it is None.

    Args:
        rows: of a benchmark.
        queries: with the name of their vehicle.
        asked: find bounds at all.
        workers: processes; default one per processor.
        report: called with a stage name and the fraction done.
    """
    why = {
        (vehicle, query.name): reason_without_bound(query) if asked else NOT_ASKED
        for vehicle, query in queries
    }
    able = [(v, q) for v, q in queries if why[v, q.name] is None]
    bounds: dict[tuple[str, str], float] = {}
    found = _bounds([query for _, query in able], workers)
    for k, ((vehicle, query), value) in enumerate(zip(able, found, strict=True)):
        if isinstance(value, str):
            why[vehicle, query.name] = value
        else:
            bounds[vehicle, query.name] = value
        report("bounding", (k + 1) / len(able))
    for row in rows:
        key = row["vehicle"], row["query"]
        bound, reason = bounds.get(key), why[key]
        if reason is None and not row["success"]:
            reason = "the motion is no answer"
        fits = reason is None and bound is not None and bound > 0
        row["bound"] = bound
        row["gap"] = row["E_mean"] / bound if fits else None
        row["no_gap"] = reason


def _bounds(queries: Sequence[Query], workers: int | None) -> list[float | str]:
    """Bounds [J], or why there is none."""
    workers = min(workers or os.cpu_count() or 1, len(queries))
    if workers <= 1:
        return [_bound(query) for query in queries]
    out: list[float | str] = []
    with Workers(workers, deaths=2) as pool:
        for future in [pool.submit(_bound, query) for query in queries]:
            try:
                out.append(future.result())
            except WorkerDied:
                out.append("the process that looked for a bound crashed")
    return out


def _bound(query: Query) -> float | str:
    try:
        with on_one_thread():
            return bound_energy(query).energy
    except NoPlan as error:
        return str(error)
