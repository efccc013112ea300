"""The path benchmark: planners x queries, every answer simulated, one result.

`run_benchmark` plans in worker processes, plays all motions of a duration in one batch
on the full nonlinear system, and returns plain data (schema `ves-benchmark/1`).
"""

from __future__ import annotations

import multiprocessing
import os
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from ves_gym import __version__
from ves_gym.core.energy import TAIL, energies
from ves_gym.core.playback import play_motions
from ves_gym.core.system import System
from ves_gym.planners.query import Plan, Query, solve
from ves_gym.planners.registry import get_planner
from ves_gym.planners.scenes import Shown, coupling_maps, scene, trace
from ves_gym.planners.suites import Suite

SCHEMA = "ves-benchmark/1"
BASELINE = "straight"
_RECORD = 12.5e-3  # s between records
_BATCH = 250  # motions played at once: bounds the memory of their records
_NOTHING = 1e-4  # of the run's own peak energy: below it there is no ratio to speak of
_RESAMPLES = 2000  # of the bootstrap

Progress = Callable[[str, float], None]


def run_benchmark(
    suite: Suite,
    *,
    planners: Sequence[str] | None = None,
    seed: int = 0,
    workers: int | None = None,
    command: str = "",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run planners on a suite.

    Args:
        planners: names; default the suite's own. The straight line is always included,
            since every energy is also given relative to it.
        workers: planning processes; default one per processor, 1 plans in this process.
        progress: called with a stage name and the fraction done.

    Returns:
        Plain data: rows, summary, traces, maps and scenes, and what reproduces them.
    """
    begin = time.perf_counter()
    names = list(dict.fromkeys([BASELINE, *(planners or suite.planners)]))
    for name in names:
        get_planner(name)
    tell = progress or (lambda stage, done: None)
    plans = _plan_all([(n, v, q) for v, q in suite.queries for n in names], seed, workers, tell)
    rows, keep = _simulate_all(plans, tell)
    first = suite.queries[0][1].system
    return {
        "schema": SCHEMA,
        "suite": suite.name,
        "mode": first.mode,
        "drive": first.drive,
        "seed": seed,
        "command": command,
        "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "versions": _versions(),
        "systems": _systems(suite),
        "planners": [{"name": n, "summary": get_planner(n).summary} for n in names],
        "rows": rows,
        "summary": summarise(rows),
        "traces": [trace(*group) for group in keep],
        "maps": [
            m
            for group in _showcase(keep)
            for m in coupling_maps(group[0], [p for p, _, _ in group[1]])
        ],
        "scenes": [scene(*group) for group in _showcase(keep)],
        "seconds": round(time.perf_counter() - begin, 2),
    }


# ------------------------------------------------------------------------- planning

Job = tuple[str, str, Query]  # planner, vehicle, query


def _plan_one(job: tuple[str, Query, int]) -> Plan:
    name, query, seed = job
    return solve(get_planner(name), query, seed)


def _plan_all(
    jobs: list[Job], seed: int, workers: int | None, tell: Progress
) -> list[tuple[str, Plan]]:
    work = [(name, query, seed) for name, _, query in jobs]
    plans: list[tuple[str, Plan]] = []
    for (_, vehicle, _), plan in zip(jobs, _mapped(work, workers), strict=True):
        plans.append((vehicle, plan))
        tell("planning", len(plans) / len(jobs))
    return plans


def _mapped(work: list[tuple[str, Query, int]], workers: int | None) -> Iterator[Plan]:
    workers = min(workers or os.cpu_count() or 1, len(work))
    if workers == 1:
        yield from map(_plan_one, work)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        yield from pool.map(_plan_one, work, chunksize=4)


# ----------------------------------------------------------------------- simulation

Group = tuple[str, list[Shown]]  # vehicle, the planners' answers to one query


def _simulate_all(
    plans: list[tuple[str, Plan]], tell: Progress
) -> tuple[list[dict[str, Any]], list[Group]]:
    """Rows in the order of the plans, and the runs to show (one query per duration)."""
    batches: dict[tuple[str, float], list[int]] = defaultdict(list)
    for i, (vehicle, plan) in enumerate(plans):
        batches[vehicle, plan.query.duration].append(i)
    rows: dict[int, dict[str, Any]] = {}
    shown: dict[tuple[str, str], list[Shown]] = defaultdict(list)
    for (vehicle, duration), members in batches.items():
        showcase = _shown_queries([plans[i][1].query for i in members])
        for part in (members[k : k + _BATCH] for k in range(0, len(members), _BATCH)):
            some = [plans[i][1] for i in part]
            system, servo = some[0].query.system, some[0].query.servo
            run = play_motions(
                system, [p.motion for p in some], servo=servo, settle=TAIL, record_dt=_RECORD
            )
            for k, (i, measured) in enumerate(
                zip(
                    part,
                    energies(system, run.t, run.q, run.y, run.yd, duration=duration),
                    strict=True,
                )
            ):
                rows[i] = _row(vehicle, some[k], measured.to_dict())
                if some[k].query.name in showcase:
                    shown[vehicle, some[k].query.name].append((some[k], run, k))
            tell("simulating", len(rows) / len(plans))
    return [rows[i] for i in range(len(plans))], [(v, runs) for (v, _), runs in shown.items()]


def _shown_queries(queries: list[Query]) -> set[str]:
    """Queries of a batch whose traces are kept: the first, or all when there are few."""
    names = list(dict.fromkeys(q.name for q in queries))
    return set(names if len(names) <= 3 else names[:1])


def _showcase(groups: list[Group]) -> list[Group]:
    """Groups whose maps and animation are shown: at most three, the middle durations."""
    ordered = sorted(groups, key=lambda g: abs(np.log(g[1][0][0].query.duration / 2.0)))
    return ordered[:3]


def _row(vehicle: str, plan: Plan, measured: dict[str, float | None]) -> dict[str, Any]:
    mean = measured["E_mean"]
    assert mean is not None  # a simulated energy is finite, or the run has diverged
    return {
        "planner": plan.planner,
        "query": plan.query.name,
        "vehicle": vehicle,
        "mode": plan.query.system.mode,
        "duration": plan.query.duration,
        **measured,
        "predicted": plan.predicted.E_mean,
        "prediction_error": plan.predicted.E_mean / mean - 1 if mean > 0 else None,
        "plan_seconds": plan.seconds,
        "success": plan.feasible,
        "info": plan.info,
    }


# -------------------------------------------------------------------------- summary


def summarise(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Medians per vehicle, duration and planner; ratios are to the straight line's.

    A ratio is taken query by query; `ratio_low` and `ratio_high` are the 95 % bootstrap
    interval of its median. A failed plan stays in the medians: the straight line's own
    energy and its own are both simulated facts; `success_rate` says how many failed.
    """
    baseline = {(r["vehicle"], r["query"]): r for r in rows if r["planner"] == BASELINE}
    groups: dict[tuple[str, float, str], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        groups[row["vehicle"], row["duration"], row["planner"]].append(row)
    out = []
    for (vehicle, duration, planner), members in groups.items():
        ratios = {key: _ratios(members, baseline, key) for key in ("E_mean", "E_res", "E_peak")}
        low, high = _interval(ratios["E_mean"])
        errors = [
            abs(r["prediction_error"]) for r in members if r["prediction_error"] is not None
        ]
        out.append(
            {
                "vehicle": vehicle,
                "duration": duration,
                "planner": planner,
                "n": len(members),
                "success_rate": float(np.mean([r["success"] for r in members])),
                "E_mean_median": _median([r["E_mean"] for r in members]),
                "ratio_median": _median(ratios["E_mean"]),
                "ratio_low": low,
                "ratio_high": high,
                "E_res_ratio_median": _median(ratios["E_res"]),
                "E_peak_ratio_median": _median(ratios["E_peak"]),
                "prediction_error_median": _median(errors),
                "plan_seconds_median": _median([r["plan_seconds"] for r in members]),
            }
        )
    return out


def _ratios(
    rows: Sequence[dict[str, Any]], baseline: dict[tuple[str, str], dict[str, Any]], key: str
) -> list[float]:
    """Energy over the straight line's, where that is not nothing.

    A free base is at rest after any motion: its E_res has no ratio.
    """
    out = []
    for row in rows:
        reference = baseline[row["vehicle"], row["query"]]
        if reference[key] > _NOTHING * reference["E_peak"]:
            out.append(row[key] / reference[key])
    return out


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _interval(values: Sequence[float]) -> tuple[float | None, float | None]:
    """95 % percentile bootstrap interval of the median; the same draws every time."""
    if not values:
        return None, None
    draws = np.random.default_rng(0).integers(len(values), size=(_RESAMPLES, len(values)))
    low, high = np.percentile(np.median(np.array(values)[draws], axis=1), [2.5, 97.5])
    return float(low), float(high)


def _versions() -> dict[str, str]:
    engines = {name: version(name) for name in ("mujoco", "numpy", "scipy")}
    return {"ves_gym": __version__, "python": platform.python_version(), **engines}


def _systems(suite: Suite) -> dict[str, dict[str, str]]:
    systems: dict[str, System] = {v: q.system for v, q in suite.queries}
    return {
        name: {"hash": s.hash, "description": f"{s.arm.name} on {s.vehicle.source}"}
        for name, s in systems.items()
    }
