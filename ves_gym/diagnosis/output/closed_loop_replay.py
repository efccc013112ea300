"""Closed-loop replay: the whole loop simulated from a log's start state with its references.

A port shows on measured input the place of a fault; a replay shows its consequence for the
machine as a whole, all parts on each other's output.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.base import WRENCH
from ves_gym.mechanics.motion import Samples
from ves_gym.mechanics.spatial import AXES
from ves_gym.simulation.machines import Divergence
from ves_gym.simulation.playback import base_wrench
from ves_gym.simulation.simulator import Simulator
from ves_gym.system.system import System

SIGNALS = ("q", "tau", "y", "w")  # compared
_DRAWS = 8  # of the noise
_REPEATED = 2.0  # s that a file read back is simulated: what comes after follows from it
_BASE = ("m",) * 3 + ("rad",) * 3
_FORCE = ("N",) * 3 + ("N m",) * 3


@dataclass(frozen=True)
class ClosedLoopReplay:
    """The loop as described and as diagnosed, left to itself on some runs."""

    runs: tuple[str, ...]
    gaps: tuple[ReplayGap, ...]
    difference: float  # of what is read back from what was found, in parts of a signal
    why_not: str  # where there are none


@dataclass(frozen=True)
class ReplayGap:
    """Root mean square up to the band, of a channel that was left to itself."""

    signal: str
    channel: str
    unit: str
    before: float
    after: float
    noise: float


def why_not(system: System, runs: Sequence[Run]) -> str:
    """Return the reason why runs cannot be replayed; empty where they can."""
    if system.drive != "motor":
        return f"the drive is {system.drive}"
    servo = runs[0].servo
    if servo is None or any(run.servo != servo for run in runs):
        return "the logs do not name one controller"
    posed = system.mode == "emulated" and system.emulator_settings.operation == "position"
    if posed and not all("y_cmd" in run for run in runs):
        return "the logs have no y_cmd"
    return ""


def replay_runs(
    system: System, runs: Sequence[Run], seconds: float = np.inf
) -> list[dict[str, Array]]:
    """Simulate the loop at the instants of each run, all in lockstep.

    References go linearly from sample to sample and are held where a run ends before others;
    state and clock begin as logged.

    Args:
        system: the machine.
        runs: whose references and start states count.
        seconds: simulated; after them, the last values are held.

    Returns:
        q, tau (T, n), y, w (T, 6) of each run.

    Raises:
        ParameterError: the logs lack what a replay needs.
        Divergence: a loop left the meaningful range.
    """
    lacks = why_not(system, runs)
    if lacks:
        raise ParameterError(f"no free run: {lacks}")
    servo = runs[0].servo
    assert servo is not None
    sim, k = Simulator(system, len(runs), servo=servo, warn_at=None), system.substeps
    q, v, y, yd = (np.stack(series) for series in zip(*map(_start, runs), strict=True))
    sim.reset(q=q, v=v, y=y, yd=yd)

    last = min(seconds, max((run.length - 1) * run.dt for run in runs))
    periods = int(np.ceil(last / system.control_dt - 1e-9))
    t = _clock(periods * k + 1, system.physics_dt)
    q, v = (np.stack([_at(t, run, run[key]) for run in runs]) for key in ("q_cmd", "v_cmd"))
    v[t > np.array([[(run.length - 1) * run.dt] for run in runs])] = 0.0
    samples = Samples(t, q, v, np.gradient(v, system.physics_dt, axis=1))
    fed = servo.torque_feedforward(system.arm, samples)
    for i, run in enumerate(runs):
        if "tau_ff" in run:
            fed[i] = _at(t, run, run["tau_ff"])
    commands = sim.servo_command(q, v, fed)
    follow = None
    if system.mode == "emulated" and system.emulator_settings.operation == "position":
        pose = np.stack([_at(t[:-1:k], run, run["y_cmd"]) for run in runs])
        rate = np.gradient(pose, system.control_dt, axis=1)
        follow = np.concatenate([pose, rate], axis=-1)
    rows = []
    for i in range(periods + 1):
        tau, ydd = sim.evaluate(commands[:, i * k])
        state = sim.state
        if system.mode == "emulated":
            wrench = sim.readings.wrench
        else:
            wrench = base_wrench(system, state.y, state.yd, ydd, sim.internal_state)
        rows.append((sim.measured[0].copy(), tau.copy(), state.y.copy(), wrench.copy()))
        if i < periods:
            platform = None if follow is None else follow[:, i : i + 1]
            sim.play(commands[:, i * k : (i + 1) * k + 1], platform=platform)
    ticks = _clock(periods + 1, system.control_dt)
    every: list[Array] = [np.stack(x, axis=1) for x in zip(*rows, strict=True)]
    return [
        {
            name: _between(_clock(run.length, run.dt), ticks, x[i])
            for name, x in zip(SIGNALS, every, strict=True)
        }
        for i, run in enumerate(runs)
    ]


def compare_replays(
    described: System, better: System, reloaded: System, runs: Sequence[Run]
) -> ClosedLoopReplay:
    """Replay the description, the better one, and first seconds of the better as read back."""
    names = tuple(run.name for run in runs)
    lacks = why_not(described, runs)
    if lacks:
        return ClosedLoopReplay(names, (), 0.0, lacks)
    try:
        after = replay_runs(better, runs)
        before = after if better == described else replay_runs(described, runs)
        repeated = replay_runs(reloaded, runs, _REPEATED)
    except Divergence as error:
        return ClosedLoopReplay(names, (), 0.0, str(error))
    largest = 0.0
    for run, a, b in zip(runs, after, repeated, strict=True):
        window = slice(int(_REPEATED / run.dt))
        for name in SIGNALS:
            size = max(np.abs(a[name]).max(), 1e-300)
            largest = max(largest, float(np.abs(a[name] - b[name])[window].max() / size))
    return ClosedLoopReplay(names, replay_gaps(runs, before, after), largest, "")


def _start(run: Run) -> list[Array]:
    """Return q, v, y, yd at a run's beginning: as its metadata say, else as measured."""
    initial = run.meta.get("initial", {})
    measured = {"q": run.joints.x, "v": run.joints.v, "y": run.base.x, "yd": run.base.v}
    return [np.asarray(initial.get(k, x[0]), float) for k, x in measured.items()]


def _clock(count: int, dt: float) -> Array:
    return np.asarray(np.arange(count) * dt, np.float64)


def _at(t: Array, run: Run, x: Array) -> Array:
    return _between(t, _clock(run.length, run.dt), x)


def _between(t: Array, clock: Array, x: Array) -> Array:
    """x (T, c), linear between samples and held outside, at t."""
    return np.stack([np.interp(t, clock, c) for c in x.T], axis=1)


def replay_gaps(
    runs: Sequence[Run],
    before: Sequence[Mapping[str, Array]],
    after: Sequence[Mapping[str, Array]],
) -> tuple[ReplayGap, ...]:
    """Return measured less simulated, before and after, of the channels that all runs hold."""
    out = []
    n = runs[0]["q"].shape[1]
    joints = tuple(str(i + 1) for i in range(n))
    labels = {
        "q": (tuple(f"q_{i}" for i in joints), ("rad",) * n),
        "tau": (tuple(f"tau_{i}" for i in joints), ("N m",) * n),
        "y": (AXES, _BASE),
        "w": (WRENCH, _FORCE),
    }
    for name in (s for s in SIGNALS if all(s in run for run in runs)):
        sizes = [
            _size(runs, [run[name] - x[name] for run, x in zip(runs, simulated, strict=True)])
            for simulated in (before, after)
        ]
        rng = np.random.default_rng(0)
        noise = _size(runs, [run.noise[name].draw(rng, _DRAWS, run.length) for run in runs])
        for i, (channel, unit) in enumerate(zip(*labels[name], strict=True)):
            row = [float(x[i]) for x in (*sizes, noise)]
            out.append(ReplayGap(name, channel, unit, *row))
    return tuple(out)


def _size(runs: Sequence[Run], parts: Sequence[Array]) -> Array:
    """Return (c,) root mean square inside the band of signals (..., T, c) of every run."""
    power = []
    for run, x in zip(runs, parts, strict=True):
        spectrum = np.abs(run.window.spectrum(x)) ** 2
        share = 2 * run.dt / (run.length * run.dt)  # of the whole spectrum, per coefficient
        power.append(spectrum.sum(axis=-2).reshape(-1, x.shape[-1]).mean(axis=0) * share)
    return np.asarray(np.sqrt(np.mean(power, axis=0)))
