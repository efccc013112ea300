"""What recorders make of a run: coloured noise, clocks, quantisation, dropouts; and tolerances.

Three recorders, none in step with another: the robot's controller (q, v, tau), a tracker of the
base (y, yd), and in weightlessness the amplifier of the force sensor (w). In the laboratory
w, wg and y_cmd are the loop's own numbers, and the noise of w goes around the loop.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.signal import lfilter

from benchmarks.independent_trial.machine import PERIOD, STEPS, Machine, Run

SHARES = {"white": 0.8, "drift": 0.5, "pickup": 0.33}  # of sigma; squares sum to 1.00
NOISE = {  # one sigma of all three together
    "q": 2e-5,
    "v": 1e-3,
    "tau": 0.2,
    "y": (1e-4, 1e-4, 1e-4, 5e-5, 5e-5, 5e-5),
    "yd": (1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 5e-4),
    "w": (0.35, 0.2, 0.4, 0.3, 0.3, 0.05),
}
STEP = {"q": 2 * np.pi / 2**19, "v": 1e-4, "tau": 0.02, "y": 1e-5, "yd": 1e-5, "w": 0.02}
SMALL_ARM = {"q": 5.0, "tau": 0.1, "w": 0.1}  # of the noise, for the light arm of seven joints
TOLERANCES = {  # one sigma; drawn for every case
    "link masses and inertias": (0.003, "share, each body"),
    "base stiffness": (0.003, "share, each mode"),
    "base damping": (0.05, "share, each mode"),
    "drive gain": (0.002, "share, each joint"),
    "platform bandwidth": (0.005, "share, each axis"),
    "sensor gain": (0.0005, "share, each axis, and as much of cross-talk"),
    "time between recorders": (3e-4, "s"),
    "jitter of sampling": (1e-4, "s"),
    "clock rate": (2e-5, "share (20 ppm)"),
}
CAP = 2.5  # sigmas: nothing is further off than that

Array = np.ndarray


def sigma(channel: str, width: int, joints: int) -> Array:
    """(width,) total standard deviation of a channel."""
    share = SMALL_ARM.get("w" if channel == "wg" else channel, 1.0) if joints == 7 else 1.0
    key = {"wg": "w", "y_cmd": "y"}.get(channel, channel)
    return share * np.broadcast_to(np.asarray(NOISE[key], float), width)


def noise(rng: np.random.Generator, rows: int, std: Array) -> Array:
    """(rows, k): white, a first-order process of 2 s, and a line of wandering phase."""
    k = len(std)
    white = rng.standard_normal((rows, k))
    a = np.exp(-PERIOD / 2.0)
    start = rng.standard_normal((1, k)) * a
    drift = lfilter(
        [np.sqrt(1 - a * a)], [1, -a], rng.standard_normal((rows, k)), axis=0, zi=start
    )[0]
    f = rng.uniform(8.0, 36.0, k)
    wander = np.cumsum(rng.standard_normal((rows, k)) * 0.05, axis=0)
    angle = 2 * np.pi * f * PERIOD * np.arange(rows)[:, None] + wander
    line = np.sqrt(2) * np.sin(angle + rng.uniform(0, 2 * np.pi, k))
    parts = {"white": white, "drift": drift, "pickup": line}
    return std * sum(SHARES[name] * part for name, part in parts.items())


def draw(rng: np.random.Generator, key: str, factor: float, size: Any = None) -> Any:
    """Deviation within a stated tolerance, `factor` times too large."""
    return factor * TOLERANCES[key][0] * np.clip(rng.standard_normal(size), -CAP, CAP)


def deviate(known: Machine, rng: np.random.Generator, factor: float) -> Machine:
    """The machine that is there, all numbers a little off those that are stated."""
    m = known.copy()
    for body in m.arm.bodies:
        share = 1 + draw(rng, "link masses and inertias", factor)
        body.mass, body.inertia = body.mass * share, body.inertia * share
    w2, phi = eigh(m.base.K, m.base.M)
    g = m.base.M @ phi
    ratios = np.diag(phi.T @ m.base.D @ phi)
    k = 1 + draw(rng, "base stiffness", factor, len(w2))
    d = np.maximum(1 + draw(rng, "base damping", factor, len(w2)), 0.05)
    m.base.K, m.base.D = (g * (w2 * k)) @ g.T, (g * (ratios * d)) @ g.T
    m.drive = 1 + draw(rng, "drive gain", factor, m.arm.n)
    if m.lab is not None:
        m.lab.omega = m.lab.omega * (1 + draw(rng, "platform bandwidth", factor, 6))
        m.lab.gain = np.eye(6) + draw(rng, "sensor gain", factor, (6, 6)) * unit_ratio()
    return m


def unit_ratio() -> Array:
    """Cross-talk between N and N m per metre of the sensor's 0.1 m."""
    return np.kron(np.array([[1.0, 1.0], [0.1, 1.0]]), np.ones((3, 3)))


def clocks(rng: np.random.Generator, rows: int, factor: float) -> dict[str, Array]:
    """True instants (rows,) at which each recorder samples what it stamps k PERIOD."""
    t = np.arange(rows) * PERIOD
    out = {}
    for recorder in ("robot", "tracker", "amplifier"):
        offset = 0.0 if recorder == "robot" else draw(rng, "time between recorders", factor)
        rate = draw(rng, "clock rate", factor)
        out[recorder] = t * (1 + rate) + offset + draw(rng, "jitter of sampling", factor, rows)
    return out


def read_off(run: Run, when: dict[str, Array]) -> dict[str, Array]:
    """Channels (rows, k) at the recorders' instants, without noise."""
    dense = np.arange(run.rows * STEPS) * PERIOD / STEPS
    take = lambda t, x, at: np.stack([np.interp(at, t, c) for c in x.T], axis=1)  # noqa: E731
    out = {k: take(dense, getattr(run, k), when["robot"]) for k in ("q", "v")}
    out["tau"] = take(run.t, run.tau, when["robot"])
    out |= {k: take(dense, getattr(run, k), when["tracker"]) for k in ("y", "yd")}
    if run.emulated:
        return out | {"w": run.w, "wg": run.wg, "y_cmd": run.y_cmd}
    return out | {"w": take(run.t, run.w, when["amplifier"])}


def record(run: Run, effects: Any, sizes: Any, rng: np.random.Generator, factor: float) -> Any:
    """The log's columns: what a run looks like after all of it."""
    rows = read_off(run, clocks(rng, run.rows, factor))
    for effect, s in zip(effects, sizes, strict=True):
        effect.record(rows, run.t, s, rng)
    n = run.tau.shape[1]
    for name in ("q", "v", "tau", "y", "yd", *(() if run.emulated else ("w",))):
        x = rows[name] + noise(rng, run.rows, sigma(name, rows[name].shape[1], n))
        rows[name] = np.round(x / STEP[name]) * STEP[name]
    for k in np.flatnonzero(rng.random(run.rows) < 0.002):  # the tracker repeats itself
        rows["y"][k], rows["yd"][k] = rows["y"][max(k - 1, 0)], rows["yd"][max(k - 1, 0)]
    return {"q_cmd": run.q_cmd, "v_cmd": run.v_cmd} | rows
