"""A made-up benchmark result: plausible shapes and sizes, no simulation behind it."""

from __future__ import annotations

import html.parser
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

PLANNERS = {
    "straight": 1.0,
    "hotspot-q": 1.3,
    "hotspot-qt": 0.6,
    "direct": 0.3,
}  # of its energy
BEAM = np.array([*((x, 0, -8) for x in range(8, 0, -1)), *((0, 0, z) for z in range(-8, 1))])
ENERGIES = ("E_mean", "E_res", "E_peak", "E_strain_peak", "E_int", "W_port")
VEHICLE = "bent-thesis"
Result = dict[str, Any]


class Elements(html.parser.HTMLParser):
    """Start tags with attributes, the text of each script element, and all other text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, Any]]] = []
        self.scripts: list[str] = []
        self.text, self.inside = "", False
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.inside = tag == "script"
        if self.inside:
            self.scripts.append("")

    def handle_endtag(self, tag):
        self.inside = False

    def handle_data(self, data):
        if self.inside:
            self.scripts[-1] += data
        else:
            self.text += data


def rows_of(names: list[str], durations: list[float], queries: int) -> list[Result]:
    rng, rows = np.random.default_rng(0), []
    for duration, k in ((duration, k) for duration in durations for k in range(queries)):
        level = 20 / duration**2 * rng.lognormal(0, 0.7)
        for name in names:
            mean = level * PLANNERS[name] * (1 if name == "straight" else rng.lognormal(0, 0.4))
            error = rng.normal(0, 0.02)
            rows.append(
                {
                    "planner": name,
                    "query": f"reach-{duration:g}s-{k:03d}",
                    "vehicle": VEHICLE,
                    "mode": "ideal",
                    "duration": duration,
                    **{energy: mean * (1 + i / 2) for i, energy in enumerate(ENERGIES)},
                    "t_5": None if k % 2 else rng.uniform(5, 60),
                    "predicted": mean * (1 + error),
                    "prediction_error": error,
                    "plan_seconds": rng.lognormal(-2, 1),
                    "success": not (name == "hotspot-q" and k == 3),
                    "info": {},
                }
            )
    return rows


def summary_of(rows: list[Result]) -> list[Result]:
    straight = {r["query"]: r["E_mean"] for r in rows if r["planner"] == "straight"}
    out = []
    for duration, name in dict.fromkeys((r["duration"], r["planner"]) for r in rows):
        members = [r for r in rows if (r["duration"], r["planner"]) == (duration, name)]
        ratio = float(np.median([r["E_mean"] / straight[r["query"]] for r in members]))
        spread = 0.0 if name == "straight" else 0.3
        out.append(
            {
                "vehicle": VEHICLE,
                "duration": duration,
                "planner": name,
                "n": len(members),
                "success_rate": float(np.mean([r["success"] for r in members])),
                "E_mean_median": float(np.median([r["E_mean"] for r in members])),
                "ratio_median": ratio,
                "ratio_low": ratio * (1 - spread),
                "ratio_high": ratio * (1 + spread),
                "E_res_ratio_median": ratio,
                "E_peak_ratio_median": ratio**0.5,
                "prediction_error_median": 0.013,
                "plan_seconds_median": float(np.median([r["plan_seconds"] for r in members])),
            }
        )
    return out


def motion(name: str, duration: float, dt: float, tail: float) -> dict[str, np.ndarray]:
    """Time (N,), base (N, 6), its energy (N,) and points of an arm (N, 4, 3)."""
    t = np.arange(0, duration + tail, dt)
    s = np.clip(t / duration, 0, 1)
    y = np.zeros((len(t), 6))
    y[:, 0] = 0.02 * PLANNERS[name] ** 0.5 * s * np.sin(2.2 * t)
    arm = np.zeros((len(t), 4, 3))
    arm[:, 1:, 2] = 0.9
    arm[:, 2:, 0] += 0.43 * np.cos(s)[:, None]
    arm[:, 3, 1] += 0.43 * np.sin(s)
    return {"t": t, "y": y, "E": 5e3 * y[:, 0] ** 2, "arm": arm + y[:, None, :3]}


def trace_of(names: list[str], duration: float) -> Result:
    runs = {name: motion(name, duration, 0.05, 10) for name in names}
    series = [
        {"planner": name, "t": run["t"].round(4).tolist(), "E": run["E"].round(5).tolist()}
        for name, run in runs.items()
    ]
    query = f"reach-{duration:g}s-000"
    return {"vehicle": VEHICLE, "duration": duration, "query": query, "series": series}


def map_of(names: list[str], points: int) -> Result:
    x, y = np.linspace(-120, 120, points), np.linspace(-60, 60, points)
    X, Y = np.meshgrid(np.deg2rad(x), np.deg2rad(y), indexing="ij")
    u, s = np.linspace(-60, 60, 40), np.linspace(0, 1, 41)
    lines = [np.stack([c + u / 3, u], -1).tolist() for c in range(-110, 111, 20)]
    paths = {name: 40 * (PLANNERS[name] - 1) * np.sin(np.pi * s) for name in names}
    return {
        "vehicle": VEHICLE,
        "title": "Q_T, T = 2 s: joints 1 and 2 (q3 = 40 deg)",
        "joints": [1, 2],
        "x": x.tolist(),
        "y": y.tolist(),
        "most": (400 * (2.5 + np.cos(Y) + 0.5 * np.sin(X + Y))).round(2).tolist(),
        "lines": lines,
        "start": [-80, -30],
        "goal": [70, 30],
        "paths": [
            {"planner": k, "points": np.stack([150 * s - 80, 60 * s - 30 + bow], -1).tolist()}
            for k, bow in paths.items()
        ],
    }


def scene_of(names: list[str], duration: float) -> Result:
    along = np.linspace(0, 1, len(BEAM))[:, None] ** 2  # of the tip's displacement
    runs = []
    for name in names:
        run = motion(name, duration, 0.05, 4)
        beam = BEAM + along * run["y"][:, None, :3]
        lists = {"beam": beam, "arm": run["arm"], "base": run["y"], "E": run["E"]}
        plain = {key: values.round(5).tolist() for key, values in lists.items()}
        runs.append({"planner": name, "dt": 0.05, **plain})
    query = f"reach-{duration:g}s-000"
    return {
        "vehicle": VEHICLE, "duration": duration, "query": query, "runs": runs,
        "rest_beam": BEAM.tolist(),
    }  # fmt: skip


def fake_result(
    *,
    planners: int = 4,
    durations: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0),
    queries: int = 10,
    points: int = 61,
) -> Result:
    """A result of the schema `ves-benchmark/1`; `points` is the size of a map's axis."""
    names = list(PLANNERS)[:planners]
    rows = rows_of(names, list(durations), queries)
    return {
        "schema": "ves-benchmark/1",
        "suite": "reach100",
        "quick": True,
        "mode": "ideal",
        "drive": "motor",
        "seed": 0,
        "created": "2026-11-21T09:00:00Z",
        "command": "ves-gym benchmark --quick",
        "seconds": 63.2,
        "versions": {"ves-gym": "0.1.0", "mujoco": "4.0.0"},
        "systems": {VEHICLE: {"hash": "196bcf" * 10, "description": "puma560 on a bent beam"}},
        "planners": [{"name": n, "summary": f"the path {n}"} for n in names],
        "rows": rows,
        "summary": summary_of(rows),
        "traces": [trace_of(names, d) for d in durations],
        "maps": [map_of(names, points) for _ in range(3)],
        "scenes": [scene_of(names, d) for d in durations[-2:]],
    }


def emulate(result: Result) -> Result:
    """The result as of mode emulated: the straight line stopped."""
    result["mode"] = "emulated"
    result["machine"] = {"operation": "microgravity", "effects": "none"}
    for row in result["rows"]:
        row.update(mode="emulated", stopped=None, E_mean_ideal=row["E_mean"])
        row.update(emulation_error=0.01, base_error=0.02)
        if row["planner"] == "straight":
            row.update(dict.fromkeys((*ENERGIES, "t_5", "emulation_error", "base_error")))
            row.update(stopped="platform frozen at t = 0.5000 s: too far", success=False)
    for row in result["summary"]:
        row.update(stopped=0, emulation_error_median=0.01)
        row.update(base_error_median=0.02, ratio_median=None, ratio_low=None, ratio_high=None)
        if row["planner"] == "straight":
            row.update(stopped=row["n"], E_mean_median=None)
            row.update(emulation_error_median=None, base_error_median=None)
    for series in (series for trace in result["traces"] for series in trace["series"]):
        curves = {k: series[k] for k in ("t", "E")} | {"strain": series["E"]}
        curves["distance"] = [0.01 * e for e in series["E"]]
        series.update(curves, ideal=dict(curves))
        if series["planner"] == "straight":
            series.update({k: v[:20] for k, v in curves.items()})
    return result


@pytest.fixture
def make_emulated() -> Callable[..., Result]:
    return lambda **options: emulate(fake_result(**options))


@pytest.fixture
def make_result() -> Callable[..., Result]:
    return fake_result
