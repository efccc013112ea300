"""A benchmark's result as one HTML file, and as text: tables of medians and notes on them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from textwrap import wrap
from typing import Any

from ves_gym._util.params import write_text
from ves_gym._util.tables import table
from ves_gym.planners.bounds import NO_MORE
from ves_gym.report.pages import page, part, require_schema

SCHEMA = "ves-benchmark/1"
_SCRIPTS = "dom drawing page tables charts scene platform player scenes"  # in this order


def write_page(result: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the HTML report of a benchmark result, completely or not at all."""
    require_schema(result, SCHEMA)
    text = page(
        "report/page.html",
        title=f"Energy in the base: {result.get('suite', 'benchmark')}",
        scripts=[f"report/{name}.js" for name in _SCRIPTS.split()],
        data=result,
        scene_controls=part("report/scene_controls.html"),
    )
    write_text(path, text)


# ---------------------------------------------------------------------------- text

Result = dict[str, Any]
Columns = dict[str, Callable[[Result], str]]  # heading -> cell of a row of the summary
_MOST = 10  # stopped runs, and reasons of failures, that are named
_WIDTH = 80  # characters, in a pipe
_ENERGIES = """\
Medians over queries. ratio: E_mean over the straight line's on the same query;
peaks: largest linear and angular acceleration of the base, likewise; success:
of all queries; limits: successes in which the simulated arm passes one; plan:
planning time."""
_DETAILS = """\
interval: of the median ratio, 95 %; E_res, E_peak: over the straight line's;
off: predicted E_mean against the simulated one; longest: planning time."""
_EMULATED = """\
Energies are those of the emulated base. emulation error: its E_mean over that of the same
motion in space, less 1; base error: largest distance between the two base positions over the
largest displacement in space; off: against E_mean in space."""
_MOTION = """\
Medians. peak, angular: largest acceleration of the arm's mount and of the base;
tip: largest error of the tool, and at the end; turned: the base at the end;
weighted: mean energy after a filter of gain {weight}."""
_MOVED = {  # measure -> heading
    "acceleration_peak": "peak\nm/s^2",
    "angular_peak": "angular\nrad/s^2",
    "tip_peak": "tip\nm",
    "tip_end": "at end\nm",
    "attitude_end": "turned\nrad",
    "E_weighted": "weighted\nJ",
}


def benchmark_text(result: Result) -> str:
    """Return the answer, tables of a result, and how failures, limits and stops are spread."""
    emulated = result["mode"] == "emulated"
    motion = {heading: _median(name, ".2g") for name, heading in _MOVED.items()}
    lines = [*_answer(result), *_tables(result, "Energy and its price", _PRICE), _ENERGIES]
    lines += [*_tables(result, "Details", _details(emulated)), _DETAILS]
    lines += _tables(result, "Motion of base and tool", motion)
    lines.append(_MOTION.format(weight=result["frequency_weight"]))
    lines += _failures(result) + _limits(result)
    if emulated:
        lines += [_EMULATED, *_machine(result)]
    return "\n".join(lines)


def _answer(result: Result) -> list[str]:
    """The path that disturbs the base least, the one that does so without shaking it more than
    the straight line, and their price: of the middle duration."""
    rows = [r for r in result["summary"] if r["ratio_median"] is not None]
    durations = sorted({r["duration"] for r in rows})
    rows = [r for r in rows if r["duration"] == durations[len(durations) // 2]]
    if len(rows) < 2:
        return []
    rows.sort(key=lambda r: (-r["success_rate"], r["ratio_median"]))
    best = rows[0]
    calmest = next((r for r in rows if _is_calm(r)), best)
    medians = [
        f"{best['planner']} disturbs {best['vehicle']} least in {best['duration']:g} s:"
        f" {_price(best)}.",
        *(
            [f"No more acceleration: {calmest['planner']}, {_price(calmest)}."]
            * (calmest != best)
        ),
        f"Medians of {best['n']} queries, in brackets 95 % intervals.",
    ]
    return [line for text in medians for line in wrap(text, 80)]


_PEAKS = "acceleration_peak", "angular_peak"


def _is_calm(row: Result) -> bool:
    peaks = [row[f"{k}_ratio_median"] for k in _PEAKS]
    return all(peak is not None and peak <= NO_MORE for peak in peaks)


def _price(row: Result) -> str:
    """A planner's energy, and what it costs."""
    linear, angular = (_number(row[f"{k}_ratio_median"], ".3g") for k in _PEAKS)
    return (
        f"{row['ratio_median']:.3f} ({_interval(row)}) of the straight line's energy, {linear}"
        f" and {angular} of its linear and angular peak acceleration, success"
        f" {100 * row['success_rate']:.0f} %, planned in {row['plan_seconds_median']:.2f} s"
    )


def _details(emulated: bool) -> Columns:
    out: Columns = {
        "interval": _interval,
        "E_res": _median("E_res_ratio", ".3f"),
        "E_peak": _median("E_peak_ratio", ".3f"),
    }
    if emulated:
        out["emulation\nerror"] = lambda row: (
            "stopped" if _stopped(row) else _number(row["emulation_error_median"], "+.2%")
        )
        out["base\nerror"] = lambda row: (
            "-" if _stopped(row) else _number(row["base_error_median"], ".2%")
        )
    return out | {
        "off": _median("prediction_error", ".2%"),
        "longest\n[s]": lambda row: f"{row['plan_seconds_max']:.2f}",
    }


def _median(name: str, form: str) -> Callable[[Result], str]:
    return lambda row: _number(row[f"{name}_median"], form)


_PRICE: Columns = {
    "E_mean\n[J]": _median("E_mean", ".3g"),
    "ratio": _median("ratio", ".3f"),
    "peaks\nlin., ang.": lambda row: " ".join(
        _number(row[f"{k}_ratio_median"], ".3g") for k in ("acceleration_peak", "angular_peak")
    ),
    "success": lambda row: f"{100 * row['success_rate']:.0f} %",
    "limits": lambda row: f"{row['arm_breaks']}",
    "plan\n[s]": _median("plan_seconds", ".2f"),
}


def _tables(result: Result, what: str, columns: Columns) -> list[str]:
    """A table per vehicle, with a line between durations."""
    out = []
    for vehicle in result["systems"]:
        rows: list[list[str] | None] = []
        duration = None
        for row in (r for r in result["summary"] if r["vehicle"] == vehicle):
            if duration not in (None, row["duration"]):
                rows.append(None)
            duration = row["duration"]
            cells = [cell(row) for cell in columns.values()]
            rows.append([f"{duration:g}", row["planner"], *cells])
        title = f"{what}: suite {result['suite']}, {vehicle}"
        head = ("T\n[s]", "planner", *columns)
        out.append(table(head, rows, title=title, left=(0, 1), width=_WIDTH))
    return out


def _failures(result: Result) -> list[str]:
    """The reasons why planners had no answer, most frequent first."""
    failures = Counter((r["planner"], r["failure"]) for r in result["rows"] if r["failure"])
    lines = [f"failed {n} x: {name}: {why}" for (name, why), n in failures.most_common(_MOST)]
    if len(failures) > _MOST:
        lines.append(f"... and {len(failures) - _MOST} more reasons, see benchmark.json")
    rates: dict[str, list[int]] = {}
    for s in result["summary"]:
        if s["solvable"] < s["n"]:
            rate = rates.setdefault(s["planner"], [0, 0])
            rate[0] += round((s["solvable_rate"] or 0.0) * s["solvable"])
            rate[1] += s["solvable"]
    if rates:
        text = ", ".join(f"{name} {a}/{b}" for name, (a, b) in rates.items())
        lines.append(f"of the solvable queries: {text}")
    return lines


def _limits(result: Result) -> list[str]:
    """Which successes leave the limits: as commanded, and as the arm moved."""
    lines = []
    for of, key in (("reference", "reference_breaks"), ("simulated arm", "arm_breaks")):
        broken = [row for row in result["rows"] if row["success"] and row[key]]
        if not broken:
            lines.append(f"{of} inside the limits on every success")
            continue
        counts, first = Counter(row["planner"] for row in broken), broken[0]
        text = ", ".join(f"{name} {count}" for name, count in counts.items())
        lines.append(f"{of} NOT inside the limits, of the successes: {text}")
        lines.append(f"  such as {first['planner']}, {first['query']}: {first[key]}")
    return lines


def _machine(result: Result) -> list[str]:
    """The emulator's settings and the runs that it had to stop."""
    lines = ["; ".join(f"{k}: {v}" for k, v in result["machine"].items())]
    for entry in result["rank_correlation"]:
        lines.append(
            f"planners rank as in space: {entry['vehicle']}, T = {entry['duration']:g} s:"
            f" rho = {_number(entry['rho_median'], '.2f')} (median of {entry['n']})"
        )
    stopped = [row for row in result["rows"] if row["stopped"]]
    for row in stopped[:_MOST]:
        lines.append(
            f"stopped: {row['vehicle']}, {row['query']}, {row['planner']}: {row['stopped']}"
        )
    if len(stopped) > _MOST:
        lines.append(f"... and {len(stopped) - _MOST} more stopped, see benchmark.json")
    return lines


def _stopped(row: Result) -> bool:
    """True where every run of a row was stopped."""
    return bool(row["stopped"] == row["n"])


def _interval(row: Result) -> str:
    if row["n"] == 1 or row["ratio_low"] is None:
        return "-"
    return f"{row['ratio_low']:.2f}-{row['ratio_high']:.2f}"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
