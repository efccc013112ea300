"""The stated machines against noise-free runs of the package that is judged, as files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.independent_trial import cases, measurement
from benchmarks.independent_trial.machine import Plant, Run
from benchmarks.independent_trial.motions import Motion


def replay(system: str, t: np.ndarray, q: np.ndarray, v: np.ndarray, duration: float) -> Run:
    """The stated machine under a commanded motion known at the rows only.

    Accelerations at rows come from a compact formula of fourth order, at rest they are nought;
    what a run differs by from the original is mostly that.
    """
    m = cases.stated(system)
    moving = t <= duration + 1e-9
    q_, v_, h = q[moving], v[moving], t[1] - t[0]
    a = np.zeros_like(q_)
    a[1:-1] = 2 * (q_[2:] - 2 * q_[1:-1] + q_[:-2]) / h**2 - (v_[2:] - v_[:-2]) / (2 * h)
    motion = Motion.through(t[moving], q_, v_, a)
    return Plant(m, m, []).run(motion, len(t))


def table(folder: Path) -> None:
    """Print, for every channel, the largest and the r.m.s. difference in noise levels."""
    for system in cases.SPACE + cases.LAB:
        path = folder / f"{system}_run.csv"
        names = path.read_text().split("\n", 1)[0].split(",")
        data = np.loadtxt(path, delimiter=",", skiprows=1)
        column = lambda key: data[:, [n.rpartition("_")[0] == key for n in names]]  # noqa: E731, B023
        duration = json.loads(path.with_suffix(".json").read_text())["duration"]
        run = replay(system, data[:, 0], column("q_cmd"), column("v_cmd"), duration)
        print(f"\n{system}")
        for key, x in run.sampled().items():
            d = np.abs(x - column(key)) / measurement.sigma(key, x.shape[1], run.tau.shape[1])
            rms = np.sqrt((d**2).mean(axis=0)).max()
            when = data[d.max(axis=1).argmax(), 0]
            print(f"  {key:6} max {d.max():.4f} at {when:.2f} s, r.m.s. {rms:.4f}")
