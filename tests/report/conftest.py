"""A made-up benchmark result: plausible shapes and sizes, no simulation behind it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

PLANNERS = {
    "straight": ("straight joint line, quintic time law", 1.0),
    "hotspot-q": ("path along the coupling map of raw Q", 1.3),
    "hotspot-qt": ("path along the band-limited coupling map", 0.6),
    "direct": ("path optimised on the predicted E_mean", 0.3),
}
REST = np.array([*((x, 0, -8) for x in range(8, 0, -1)), *((0, 0, z) for z in range(-8, 1))])
OMEGA = 2 * np.pi * np.array([0.35, 0.9])  # rad/s, two modes of the base
Result = dict[str, Any]


def arm_points(q: np.ndarray) -> np.ndarray:
    """Base, shoulder, elbow, tool of a 3-joint arm: (n, 3) -> (n, 4, 3) [m]."""
    out = np.zeros((len(q), 4, 3))
    out[:, 1:, 2] = 0.9
    pan = np.stack([np.cos(q[:, 0]), np.sin(q[:, 0])], axis=-1)
    for k, angle in ((2, q[:, 1]), (3, q[:, 1] + q[:, 2])):
        out[:, k] = out[:, k - 1]
        out[:, k, :2] += 0.43 * np.cos(angle)[:, None] * pan
        out[:, k, 2] += 0.43 * np.sin(angle)
    return out


def motion(duration: float, gain: float, dt: float, tail: float) -> dict[str, np.ndarray]:
    """Two lightly damped modes, pushed by the acceleration of a quintic."""
    t = np.arange(0, duration + tail, dt)
    s = np.clip(t / duration, 0, 1)
    push = np.where(s < 1, (60 * s - 180 * s**2 + 120 * s**3) / duration**2, 0)
    y = np.zeros((len(t), 6))
    E = np.zeros(len(t))
    for k, omega in enumerate(OMEGA):
        kernel = np.exp(-0.01 * omega * t) * np.sin(omega * t) / omega
        x = 0.02 * np.sqrt(gain) * np.convolve(push, kernel)[: len(t)] * dt
        y[:, 2 * k] = x
        E += 0.5 * 100 * (np.gradient(x, dt) ** 2 + (omega * x) ** 2)
    law = s**3 * (10 - 15 * s + 6 * s**2)
    q = np.array([-0.4, 0.3, 0.8]) + np.outer(law, [1.6, 0.7, -1.2])
    q += gain * np.outer(np.sin(np.pi * law), [0.1, -0.4, 0.3])
    return {"t": t, "q": q, "y": y, "E": E}


def fake_rows(
    names: list[str], durations: list[float], queries: int, rng: np.random.Generator
) -> list[Result]:
    rows = []
    for duration in durations:
        for k in range(queries):
            level = 20 / duration**2 * rng.lognormal(0, 0.7)
            for name in names:
                spread = 1.0 if name == "straight" else rng.lognormal(0, 0.4)
                mean = level * PLANNERS[name][1] * spread
                predicted = mean * rng.normal(1, 0.02)
                rows.append(
                    {
                        "planner": name,
                        "query": f"reach-{duration:g}s-{k:03d}",
                        "vehicle": "bent-thesis",
                        "mode": "ideal",
                        "duration": duration,
                        "E_mean": mean,
                        "E_res": mean * rng.uniform(0.5, 1.5),
                        "E_peak": mean * rng.uniform(2, 4),
                        "E_strain_peak": mean * rng.uniform(1, 3),
                        "E_int": mean * rng.uniform(4, 6),
                        "W_port": mean * rng.uniform(1, 2),
                        "t_5": None if k % 2 else rng.uniform(5, 60),
                        "predicted": predicted,
                        "prediction_error": predicted / mean - 1,
                        "plan_seconds": rng.lognormal(-2, 1),
                        "success": not (name == "hotspot-q" and k == 3),
                        "info": {},
                    }
                )
    return rows


def fake_summary(rows: list[Result]) -> list[Result]:
    straight = {r["query"]: r for r in rows if r["planner"] == "straight"}
    out = []
    for duration, name in dict.fromkeys((r["duration"], r["planner"]) for r in rows):
        members = [r for r in rows if (r["duration"], r["planner"]) == (duration, name)]
        ratio = [r["E_mean"] / straight[r["query"]]["E_mean"] for r in members]
        middle = float(np.median(ratio))
        out.append(
            {
                "vehicle": "bent-thesis",
                "duration": duration,
                "planner": name,
                "n": len(members),
                "success_rate": float(np.mean([r["success"] for r in members])),
                "E_mean_median": float(np.median([r["E_mean"] for r in members])),
                "ratio_median": middle,
                "ratio_low": middle if name == "straight" else 0.8 * middle,
                "ratio_high": middle if name == "straight" else 1.3 * middle,
                "E_res_ratio_median": middle,
                "E_peak_ratio_median": middle**0.5,
                "prediction_error_median": 0.013,
                "plan_seconds_median": float(np.median([r["plan_seconds"] for r in members])),
            }
        )
    return out


def fake_trace(names: list[str], duration: float) -> Result:
    series = []
    for name in names:
        run = motion(duration, PLANNERS[name][1], 0.0125, 10)
        t, E = run["t"][::4], run["E"][::4]
        series.append({"planner": name, "t": t.round(4).tolist(), "E": E.round(5).tolist()})
    return {
        "vehicle": "bent-thesis",
        "duration": duration,
        "query": f"reach-{duration:g}s-000",
        "series": series,
    }


def fake_map(names: list[str], points: int) -> Result:
    x, y = np.linspace(-120, 120, points), np.linspace(-60, 60, points)
    X, Y = np.meshgrid(np.deg2rad(x), np.deg2rad(y), indexing="ij")
    most = 400 * (1.2 + np.cos(Y) * (1 + 0.4 * np.cos(2 * X)) + 0.5 * np.sin(X + Y))
    u = np.linspace(-60, 60, 40)
    lines = [
        np.stack([c + 25 * np.sin(np.deg2rad(2 * u)), u], -1) for c in range(-110, 111, 20)
    ]
    s = np.linspace(0, 1, 41)
    paths = []
    for name in names:
        bow = 40 * (PLANNERS[name][1] - 1) * np.sin(np.pi * s)
        curve = np.stack([-80 + 150 * s, -30 + 60 * s + bow], -1).round(2).tolist()
        paths.append({"planner": name, "points": curve})
    return {
        "vehicle": "bent-thesis",
        "title": "Q_T, T = 2 s: joints 1 and 2 (q3 = 40 deg)",
        "joints": [1, 2],
        "x": x.tolist(),
        "y": y.tolist(),
        "most": most.round(2).tolist(),
        "lines": [curve.round(2).tolist() for curve in lines],
        "start": [-80, -30],
        "goal": [70, 30],
        "paths": paths,
    }


def fake_scene(names: list[str], duration: float) -> Result:
    along = np.linspace(0, 1, len(REST))[:, None] ** 2  # of the tip's displacement
    runs = []
    for name in names:
        run = motion(duration, PLANNERS[name][1], 0.05, 4)
        shift = run["y"][:, None, :3]
        runs.append(
            {
                "planner": name,
                "dt": 0.05,
                "beam": (REST + along * shift).round(4).tolist(),
                "arm": (arm_points(run["q"]) + shift).round(4).tolist(),
                "base": run["y"].round(5).tolist(),
                "E": run["E"].round(5).tolist(),
            }
        )
    return {
        "vehicle": "bent-thesis",
        "duration": duration,
        "query": f"reach-{duration:g}s-000",
        "rest_beam": REST.tolist(),
        "runs": runs,
    }


def fake_result(
    *,
    planners: int = 4,
    durations: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0),
    queries: int = 10,
    points: int = 61,
) -> Result:
    """A result of the schema `ves-benchmark/1`; `points` is the size of a map's axis."""
    names = list(PLANNERS)[:planners]
    rows = fake_rows(names, list(durations), queries, np.random.default_rng(0))
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
        "systems": {
            "bent-thesis": {"hash": "196bcf" * 10, "description": "puma560 on a bent beam"}
        },
        "planners": [{"name": n, "summary": PLANNERS[n][0]} for n in names],
        "rows": rows,
        "summary": fake_summary(rows),
        "traces": [fake_trace(names, d) for d in durations],
        "maps": [fake_map(names, points) for _ in range(3)],
        "scenes": [fake_scene(names, d) for d in durations[-2:]],
    }


def emulate(result: Result) -> Result:
    """The result as of mode emulated: the straight line stopped."""
    result["mode"] = "emulated"
    result["machine"] = {"operation": "microgravity", "effects": "none"}
    energies = ("E_mean", "E_res", "E_peak", "E_strain_peak", "E_int", "W_port", "t_5")
    for row in result["rows"]:
        row.update(mode="emulated", stopped=None, E_mean_ideal=row["E_mean"])
        row.update(emulation_error=0.01, base_error=0.02)
        if row["planner"] == "straight":
            row.update(dict.fromkeys((*energies, "emulation_error", "base_error")))
            row.update(stopped="platform frozen at t = 0.5000 s: too far", success=False)
    for row in result["summary"]:
        row.update(stopped=0, emulation_error_median=0.01)
        row.update(base_error_median=0.02, ratio_median=None, ratio_low=None, ratio_high=None)
        if row["planner"] == "straight":
            row.update(stopped=row["n"], E_mean_median=None)
            row.update(emulation_error_median=None, base_error_median=None)
    for trace in result["traces"]:
        for series in trace["series"]:
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
