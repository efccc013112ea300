"""Probes by room, their stored results, and the judgement between the two."""

from __future__ import annotations

import json
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tests.golden.compare import Deviation, compare, rounded
from tests.golden.probe import Probe

ROOMS = ("simulations", "episodes", "planning")


@cache
def probes(room: str) -> dict[str, Probe]:
    """Return the probes of a room by name."""
    found: dict[str, Probe] = import_module(f"tests.golden.{room}").probes()
    return found


def every_probe() -> dict[str, tuple[str, Probe]]:
    """Return room and probe of every name."""
    return {name: (room, probe) for room in ROOMS for name, probe in probes(room).items()}


def path_of(room: str) -> Path:
    """Return the file of a room's results."""
    return Path(__file__).with_name(f"{room}.json")


@cache
def stored(room: str) -> dict[str, Any]:
    """Return the stored results of a room by the names of its probes."""
    path = path_of(room)
    found: dict[str, Any] = (
        json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    )
    return found


def write(room: str, results: dict[str, Any]) -> None:
    """Write a room's results, a line per probe, in the order of the probes."""
    chosen = [k for k in probes(room) if k in results]
    lines = (f"{json.dumps(k)}:{_text(results[k])}" for k in chosen)
    path_of(room).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _text(plain: Any) -> str:
    return json.dumps(plain, separators=(",", ":"))


def measure(probe: Probe) -> dict[str, Any]:
    """Run a probe; the results are as their file would give them back."""
    # sums over more than one thread would end in other bits every time
    with threadpool_limits(1), np.errstate(all="ignore"):
        out: dict[str, Any] = json.loads(_text(rounded(probe.measure())))
    return out


def judge(probe: Probe, expected: dict[str, Any], measured: dict[str, Any]) -> Deviation:
    """Return the worst difference between stored and measured results of a probe."""
    if missing := sorted(expected.keys() ^ measured.keys()):
        return Deviation(missing[0], float("inf"), False)
    parts = [
        compare(expected[k], measured[k], probe.loose.get(k, probe.relative), k)
        for k in expected
    ]
    return max(parts, key=lambda d: (not d.permitted, d.size))
