"""Captures in a run log: where rates jump, what the payload moves with, what a latch takes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.attitude import conjugate, rotate
from ves_gym.mechanics.spatial import matvec
from ves_gym.system.runlog import RunLog
from ves_gym.system.runlog_files import QUANTITIES
from ves_gym.system.system import System


def payload_energy(system: System, log: RunLog) -> Array:
    """Return the kinetic energy of the payload at each sample (N,) [J]; 0 without one.

    Args:
        system: with the payload's mass properties.
        log: with the column pd.
    """
    if system.payload is None or log.pd is None:
        return np.zeros(len(log))
    body = system.payload.inertial
    velocity, spin = log.pd[:, :3], log.pd[:, 3:]
    turning = np.sum(spin * matvec(np.array(body.inertia), spin), axis=1)
    out: Array = 0.5 * (body.mass * np.sum(velocity**2, axis=1) + turning)
    return out


def segments(log: RunLog) -> list[tuple[RunLog, float]]:
    """Return the pieces of a log between captures, with the energy lost at their starts [J].

    A sample at which a latch closes holds the rates after it; the piece before it ends there
    too, with the rates before it, which the metadata hold.

    Args:
        log: with the entry `captures`.

    Raises:
        ParameterError: a capture between two samples, or without its rates.
    """
    edges: list[tuple[int, dict[str, Any] | None]] = [(0, None)]
    for capture in log.meta["captures"]:
        k = int(np.argmin(np.abs(log.t - capture["time"])))
        if abs(log.t[k] - capture["time"]) > 1e-9:
            raise ParameterError(f"a capture at {capture['time']:g} s is no sample of the log")
        edges.append((k, capture))
    meta = {k: v for k, v in log.meta.items() if k != "captures"}
    out, lost = [], 0.0
    ends = [*edges[1:], (len(log) - 1, None)]
    for (first, _), (last, capture) in zip(edges, ends, strict=True):
        if last > first:
            rows = {name: getattr(log, name) for name in QUANTITIES}
            cut = {k: a[first : last + 1].copy() for k, a in rows.items() if a is not None}
            if capture is not None and capture["kind"] != "release":
                _set_before(cut, capture)
            out.append((replace(log, t=log.t[first : last + 1], meta=meta, **cut), lost))
            lost = 0.0
        lost += 0.0 if capture is None else capture["lost"]
    return out


def _set_before(cut: dict[str, Array], capture: dict[str, Any]) -> None:
    """Put the rates before a capture into the last row."""
    before = capture["before"]
    twist = np.array(before["payload"])
    cut["yd"][-1], cut["v"][-1], cut["tau"][-1] = before["yd"], before["v"], before["tau"]
    if "ud" in cut:
        cut["ud"][-1] = before["ud"]
    spin = rotate(conjugate(cut["p"][-1, 3:]), twist[3:])
    cut["pd"][-1] = np.r_[twist[:3], spin]
