"""The path benchmark: planners x queries, every answer simulated, one result.

`run_benchmark` plans in worker processes, plays all motions of a duration in one batch
on the full nonlinear system, and returns plain data (schema `ves-benchmark/1`). Planning
is for the space system. In mode emulated the laboratory plays the motions, the space
system plays them again, and the difference is the emulation error.

An answer is a success by the rule of the leaderboard: inside its limits as it is commanded,
and as the arm plays it (`execution_check.py`).
"""

from __future__ import annotations

import os
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields, replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
import scipy.stats
from pebble import ProcessExpired

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym._util.statistics import STATISTICS, bootstrap
from ves_gym._util.version import __version__
from ves_gym.hardware.leg_servo import LEG_SERVOS, LegServo
from ves_gym.planners.comparison import measured
from ves_gym.planners.execution_check import executed_violation, solve_with_reserve
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.query import Plan, Query
from ves_gym.planners.registry import get_planner
from ves_gym.planners.scenes import PlayedPlan, coupling_maps, scene, trace
from ves_gym.planners.suites import Suite
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.system.disturbance import MEASURES, disturbance_to_plain
from ves_gym.system.energy import TAIL, Energies
from ves_gym.system.system import System

SCHEMA = "ves-benchmark/1"
BASELINE = "straight"
_NO_RATIO = 1e-4  # of the run's own peak energy: below it there is no ratio to speak of
_RECORD = 12.5e-3  # s between records, or near it
_BATCH = 250  # motions played at once: bounds the memory of their records

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
    """Run planners on a suite and return the complete result as plain data.

    Args:
        suite: the queries, and the planners that answer them by default.
        planners: names; default the suite's own. The straight line is always included,
            since every energy is also given relative to it.
        seed: of every planner and of the laboratory's noise, >= 0.
        workers: planning processes; default one per processor, 1 plans in this process.
        command: the command line that the result names.
        progress: called with a stage name and the fraction done.

    Raises:
        MissingPackageError: a planner is a search with OMPL, which is not installed.
        ParameterError: an unknown planner, or a query that no planner may answer.
    """
    begin = time.perf_counter()
    names = list(dict.fromkeys([BASELINE, *(planners or suite.planners)]))
    for name in names:
        if isinstance(get_planner(name), Ompl):
            require(f"planner {name}", "ompl")  # before the others have planned for minutes
    report = progress or _silent
    questions = [(n, v, q) for v, q in suite.queries for n in names]
    work = [(n, replace(q, system=suite.described.get(v, q.system).ideal()), seed)
            for n, v, q in questions]  # fmt: skip
    plans: dict[Work, Plan] = {}
    alone = list(dict.fromkeys(work))  # machines that are described alike are planned for once
    for job, plan in zip(alone, _run_workers(alone, workers), strict=True):
        plans[job] = plan
        report("planning", len(plans) / len(alone))
    runs = [
        _Run(name, vehicle, plans[job], query.system)
        for (name, vehicle, query), job in zip(questions, work, strict=True)
    ]
    rows, groups = _simulate_all(runs, seed, report)
    first, showcase = suite.queries[0][1].system, _showcase(groups)
    engines = {name: version(name) for name in ("mujoco", "numpy", "scipy")}
    return {
        "schema": SCHEMA,
        "suite": suite.name,
        "mode": first.mode,
        "drive": first.drive,
        "seed": seed,
        "command": command,
        "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "versions": {"ves_gym": __version__, "python": platform.python_version(), **engines},
        "systems": {
            v: {"hash": s.hash, "description": f"{s.arm.name} on {s.vehicle.source}"}
            for v, s in {v: q.system for v, q in suite.queries}.items()
        },
        "frequency_weight": str(suite.queries[0][1].weight),
        **({"machine": _machine(first)} if first.mode == "emulated" else {}),
        "planners": [{"name": n, "summary": get_planner(n).summary} for n in names],
        "rows": rows,
        "summary": summarise(rows),
        **({"rank_correlation": rank_correlation(rows)} if first.mode == "emulated" else {}),
        "traces": [trace(*group) for group in groups],
        "maps": [m for v, group in showcase for m in coupling_maps(v, [p.plan for p in group])],
        "scenes": [scene(*group) for group in showcase],
        "seconds": round(time.perf_counter() - begin, 2),
    }


def run_query(planner: str, vehicle: str, query: Query, seed: int = 0) -> dict[str, Any]:
    """Simulate one planner's answer to one query: a row of `run_benchmark`.

    Energies relative to the straight line's are not in it, for that is another row. The motion
    is played on the query's system; planning is for the ideal one.
    """
    plan = _plan_one((planner, replace(query, system=query.system.ideal()), seed))
    runs = [_Run(planner, vehicle, plan, query.system)]
    return _simulate_all(runs, seed, _silent)[0][0]


def _silent(stage: str, done: float) -> None: ...


# ------------------------------------------------------------------------- planning

Work = tuple[str, Query, int]  # planner, query, seed


def _plan_one(job: Work) -> Plan:
    name, query, seed = job
    begin = time.perf_counter()
    try:
        plan = solve_with_reserve(get_planner(name), query, seed)
        _ = plan.reference  # once, here where processors are many
        return plan
    except ParameterError:
        raise  # a wrong question, not a planner that failed
    except Exception as error:  # reported for this query; the run goes on
        why = f"{type(error).__name__}: {error}"
        return Plan(name, query, None, time.perf_counter() - begin, why)


def _run_workers(
    work: list[Work], workers: int | None, plan: Callable[[Work], Plan] = _plan_one
) -> Iterator[Plan]:
    """Plans in order; one that takes its process down with it is a failure of its query."""
    workers = min(workers or os.cpu_count() or 1, len(work))
    if workers == 1:
        yield from map(plan, work)
        return
    with Workers(workers) as pool:
        for job, future in zip(work, [pool.submit(plan, job) for job in work], strict=True):
            try:
                yield future.result()
            except ProcessExpired:
                why = "the planning process crashed"
                yield Plan(job[0], job[1], None, 0.0, why)


# ----------------------------------------------------------------------- simulation

Group = tuple[str, list[PlayedPlan]]  # vehicle, the planners' answers to one query


class _Run(NamedTuple):
    """A plan and the system its motion is played on."""

    planner: str  # its name
    vehicle: str
    plan: Plan
    system: System


def _simulate_all(
    runs: list[_Run], seed: int, report: Progress
) -> tuple[list[dict[str, Any]], list[Group]]:
    """Rows in the order of the runs, and those to show (one query per duration)."""
    batches: dict[tuple[str, System, float], list[int]] = defaultdict(list)
    rows: dict[int, dict[str, Any]] = {}
    for i, run in enumerate(runs):
        if run.plan.found is None:
            rows[i] = _unplayed(run)
        else:
            batches[run.vehicle, run.system, run.plan.query.duration].append(i)
    pictures: dict[tuple[str, str], list[PlayedPlan]] = defaultdict(list)
    for (vehicle, system, _), members in batches.items():
        named = list(dict.fromkeys(runs[i].plan.query.name for i in members))
        showcase = named if len(named) <= 3 else named[:1]  # queries whose traces are kept
        for part in (members[k : k + _BATCH] for k in range(0, len(members), _BATCH)):
            batch = [runs[i] for i in part]
            plans = [r.plan for r in batch]
            recording = _play(system, plans, system, seed)
            energies = measured(recording)
            ideal, in_space = None, energies
            if system.mode == "emulated":
                ideal = _play(system.ideal(), plans, system, seed)
                in_space = measured(ideal)
            for k, (i, run) in enumerate(zip(part, batch, strict=True)):
                played = PlayedPlan(run.plan, recording, k, run.planner, ideal)
                rows[i] = _played(run, played, energies[k], in_space[k])
                if run.plan.query.name in showcase:
                    pictures[vehicle, run.plan.query.name].append(played)
            report("simulating", len(rows) / len(runs))
    groups = [(vehicle, answers) for (vehicle, _), answers in pictures.items()]
    return [rows[i] for i in range(len(runs))], groups


def _play(system: System, plans: Sequence[Plan], clock: System, seed: int) -> Recording:
    """Play motions; the laboratory (`clock`) records whole control periods."""
    motions, servo = [plan.motion for plan in plans], plans[0].query.servo
    dt = _RECORD
    if clock.mode == "emulated":
        dt = max(1, round(dt / clock.control_dt)) * clock.control_dt
    return play_motions(
        system, motions, servo=servo, settle=TAIL, record_dt=dt, seed=seed, watch=True
    )


def _showcase(groups: list[Group]) -> list[Group]:
    """Groups whose maps and animation are shown: at most three, the middle durations.

    One of each vehicle before a second of any.
    """
    ordered = sorted(groups, key=lambda g: abs(np.log(g[1][0].plan.query.duration / 2.0)))
    names = [vehicle for vehicle, _ in ordered]
    first = sorted(enumerate(ordered), key=lambda p: names[: p[0]].count(p[1][0]))
    return [group for _, group in first[:3]]


def _unplayed(run: _Run) -> dict[str, Any]:
    """The row of a query that the planner had no answer to."""
    query, emulated = run.plan.query, run.system.mode == "emulated"
    return {
        "planner": run.planner,
        "query": query.name,
        "vehicle": run.vehicle,
        "mode": run.system.mode,
        "duration": query.duration,
        "obstacles": query.surroundings is not None,
        **dict.fromkeys((*_MEASURES, *MEASURES, "predicted", "prediction_error")),
        "plan_seconds": run.plan.seconds,
        "success": False,
        "failure": run.plan.failure,
        **dict.fromkeys(("reference_breaks", "arm_breaks", "energy_residual")),
        "info": run.plan.info,
        **dict.fromkeys(_EMULATED_COLUMNS if emulated else ()),
    }


def _played(
    run: _Run, played: PlayedPlan, measured: Energies | None, in_space: Energies | None
) -> dict[str, Any]:
    """The row of a motion that was played."""
    plan, recording, k, _, ideal = played
    query = plan.query
    assert in_space is not None  # nothing stops a run in space
    assert plan.reference is not None
    why, moved = plan.failure, None
    if measured is not None:
        moved = recording.disturbance(k, as_it_is=True, weight=query.weight)
        why = why or executed_violation(query, recording, k)
    row = {
        **_unplayed(run),
        **({} if measured is None else measured.to_dict()),
        **disturbance_to_plain(moved),
        "predicted": plan.predicted.E_mean,
        "prediction_error": _excess(plan.predicted.E_mean, in_space.E_mean),
        "success": why is None and measured is not None,
        "failure": why,
        "reference_breaks": plan.reference.reasons,
        "arm_breaks": recording.limit_check(k, v_max=query.v_max).reasons,
        "energy_residual": recording.energy_residual(k),
    }
    return row if ideal is None else row | _emulation(recording, ideal, k, row, in_space)


_EMULATED_COLUMNS = ("stopped", "E_mean_ideal", "E_res_ideal", "E_peak_ideal",
                     "emulation_error", "base_error")  # fmt: skip
_MEASURES = tuple(field.name for field in fields(Energies))


def _emulation(
    run: Recording, ideal: Recording, k: int, row: dict[str, Any], in_space: Energies
) -> dict[str, Any]:
    """Columns of mode emulated: the same motion in space, and the difference."""
    stop = next((str(e) for e in run.events if e.simulation == k), None)
    base_error = None
    if stop is None:
        place, reference = run.y[k, :, :3], ideal.y[k, :, :3]
        largest = float(np.linalg.norm(reference, axis=-1).max())
        if largest > 0:
            base_error = float(np.linalg.norm(place - reference, axis=-1).max()) / largest
    values = (stop, in_space.E_mean, in_space.E_res, in_space.E_peak,
              _excess(row["E_mean"], in_space.E_mean), base_error)  # fmt: skip
    return dict(zip(_EMULATED_COLUMNS, values, strict=True))


def _excess(value: float | None, reference: float) -> float | None:
    """value / reference - 1, where there is such a thing."""
    return value / reference - 1 if value is not None and reference > 0 else None


def _machine(system: System) -> dict[str, str]:
    """The laboratory in words."""
    lab = system.emulator_settings
    if isinstance(lab.platform, LegServo):
        platform = next((k for k, v in LEG_SERVOS.items() if v == lab.platform), "own")
        platform = f"six legs, {platform} servo"
    else:
        platform = f"pose servo, {lab.platform.bandwidth:g} Hz"
    weight = {
        "microgravity": "calibrated estimate subtracted"
        if lab.gravity
        else "exact estimate subtracted",
        "admittance": "not compensated",
        "position": "no part in it",
    }[lab.operation]
    inertia = "compensated by model" if lab.payload_compensation else "not compensated"
    return {
        "operation": lab.operation,
        "platform": platform,
        "arm's weight": weight + (", sensor zeroed at the start" if lab.zero_at_start else ""),
        "arm's inertia": inertia,
        "sample rate": f"{1 / system.control_dt:g} Hz",
        "effects": ", ".join(map(str, system.effects)) or "none",
    }


def summarise(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Medians per vehicle, duration and planner; ratios are to the straight line's.

    A ratio is taken query by query; `ratio_low` and `ratio_high` are the 95 % bootstrap
    interval of its median. A failed plan stays in the medians: the straight line's own
    energy and its own are both simulated facts; `success_rate` says how many failed.
    Errors of the prediction are those of motions that keep their limits. A stopped run and
    a query without an answer have no energy and are in none. A query is solvable if any
    planner of the run solved it.
    """
    baseline = {(r["vehicle"], r["query"]): r for r in rows if r["planner"] == BASELINE}

    def ratios(members: Sequence[dict[str, Any]], name: str, least: float) -> list[float]:
        """Of a column to the straight line's, where that is more than `least` of its peak."""
        pairs = [(r.get(name), baseline[r["vehicle"], r["query"]]) for r in members]
        return [
            value / base[name]
            for value, base in pairs
            if value is not None
            and base.get(name) is not None
            and base[name] > least * (base["E_peak"] or 0.0)
        ]

    solvable = {(r["vehicle"], r["query"]) for r in rows if r["success"]}
    out = []
    for (vehicle, duration, planner), members in _grouped(rows, *_CASE).items():

        def median(name: str, members: list[dict[str, Any]] = members) -> float | None:
            return _median(_numbers(members, name))

        # a free base is at rest after any motion: its E_res has no ratio
        mean, residual, peak = (
            ratios(members, name, _NO_RATIO) for name in ("E_mean", "E_res", "E_peak")
        )
        interval = bootstrap([np.array(mean)], STATISTICS["median"]) if mean else None
        emulated: dict[str, Any] = {}
        if "stopped" in members[0]:
            emulated["stopped"] = sum(r["stopped"] is not None for r in members)
            emulated |= {f"{k}_median": median(k) for k in ("emulation_error", "base_error")}
        feasible = [r for r in members if r["failure"] is None]
        errors = [abs(e) for e in _numbers(feasible, "prediction_error")]
        possible = [r["success"] for r in members if (vehicle, r["query"]) in solvable]
        seconds = [r["plan_seconds"] for r in members]
        out.append(
            {
                "vehicle": vehicle,
                "duration": duration,
                "planner": planner,
                "n": len(members),
                "success_rate": float(np.mean([r["success"] for r in members])),
                # successes that break a limit: within the tolerance, or one not asked for
                **{
                    k: sum(bool(r["success"] and r.get(k)) for r in members)
                    for k in ("reference_breaks", "arm_breaks")
                },
                "E_mean_median": median("E_mean"),
                "ratio_median": _median(mean),
                "ratio_low": interval and interval.low,
                "ratio_high": interval and interval.high,
                "E_res_ratio_median": _median(residual),
                "E_peak_ratio_median": _median(peak),
                **{f"{k}_median": median(k) for k in MEASURES},
                **{f"{k}_ratio_median": _median(ratios(members, k, 0.0)) for k in MEASURES},
                "solvable": len(possible),
                "solvable_rate": float(np.mean(possible)) if possible else None,
                "prediction_error_median": _median(errors),
                "prediction_error_max": max(errors, default=None),
                "plan_seconds_median": _median(seconds),
                "plan_seconds_p95": float(np.percentile(seconds, 95)),
                "plan_seconds_max": max(seconds),
                **emulated,
            }
        )
    return out


def rank_correlation(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Spearman's rho of the planners' order in the laboratory and in space, by query.

    Per vehicle and duration the median of rho over queries with three planners or more that
    have an energy in both.
    """
    played = [row for row in rows if row["E_mean"] is not None]
    groups: dict[tuple[str, float], list[float]] = defaultdict(list)
    for (vehicle, duration, _), members in _grouped(
        played, "vehicle", "duration", "query"
    ).items():
        emulated, ideal = np.array([(r["E_mean"], r["E_mean_ideal"]) for r in members]).T
        if len(members) >= 3 and np.ptp(emulated) > 0 and np.ptp(ideal) > 0:
            rho_query = scipy.stats.spearmanr(emulated, ideal).statistic
            groups[vehicle, duration].append(float(rho_query))
    return [
        {"vehicle": v, "duration": d, "n": len(rho), "rho_median": _median(rho)}
        for (v, d), rho in groups.items()
    ]


_CASE = "vehicle", "duration", "planner"


def _grouped(rows: Iterable[dict[str, Any]], *keys: str) -> dict[Any, list[dict[str, Any]]]:
    """Rows that are alike in some columns, in the order of their first."""
    groups = defaultdict(list)
    for row in rows:
        groups[tuple(row[key] for key in keys)].append(row)
    return groups


def _numbers(rows: Iterable[dict[str, Any]], key: str) -> list[float]:
    return [row[key] for row in rows if row.get(key) is not None]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None
