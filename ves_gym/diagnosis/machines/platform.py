"""The platform's port, and what the platform does between two samples of a log."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym._util.signals import differentiated
from ves_gym.diagnosis.data.measured_run import Kinematics, Run
from ves_gym.diagnosis.machines.admittance import sent_rates
from ves_gym.diagnosis.machines.controller_signals import on_its_clock
from ves_gym.diagnosis.machines.platform_response import (
    Platforms,
    platform_response,
    within_reach,
)
from ves_gym.simulation.blocks.platform import EngineInput
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect_rows import stacked
from ves_gym.system.system import System


def platform_gap(run: Run, systems: Sequence[System], described: System) -> Array:
    """Return the pose less the platform's answer to its command, all models at once.

    Args:
        run: with y, y_cmd; with w, weight, q and gains the rates sent are known, too.
        systems: m of them, which differ in effects.
        described: the system without candidates.

    Returns:
        (m, ..., T, 6) [m, rad].
    """
    copies, length = run["y"].shape[:-2], run.length
    k, m = int(np.prod(copies, dtype=int)), len(systems)
    settings = described.emulator_settings
    nominals = [LoopParameters.nominal(s.arm, settings, k).edited(s.effects) for s in systems]
    p = nominals[0].mapped(stacked, *nominals[1:])
    y, command, begin = _start(run, p, described, m)
    out = y - platform_response(described, p, command, y[:, 0], begin)
    return out.reshape(m, *copies, length, 6)


def followed(run: Run, described: System) -> set[str]:
    """Return the names of the signals that say how the platform moves.

    Args:
        run: the log.
        described: the system.
    """
    if described.mode == "ideal":
        return set()
    return {"y", "y_cmd", *(("w", "weight", "q") if _knows_rates(run, described) else ())}


def ridden(run: Run, described: System) -> Kinematics | None:
    """Return how the platform as described follows a log's commands; None on another clock.

    Args:
        run: with y, y_cmd.
        described: the system.

    Returns:
        (T, k + 1, 6) at the nodes of the period that ends at each sample; lines between the
        accelerations lead from pose to pose.
    """
    if not on_its_clock(run, described):
        return None
    return run.derived("ridden", followed(run, described), lambda: path_of(run, described))


def path_of(run: Run, described: System) -> Kinematics:
    """Return what `ridden` does, computed anew, for a log on the system's clock.

    Args:
        run, described: see `ridden`.
    """
    p = described.loop_parameters
    first = Run(
        run.name,
        run.dt,
        {name: x.reshape(-1, *x.shape[-2:])[:1] for name, x in run.signals.items()},
        run.noise,
        run.meta,
        run.band,
    )
    y, command, begin = _start(first, p, described, 1)
    command = within_reach(described, p, command, y[:, 0], begin)
    platforms = Platforms(described, p, y[:, 0], begin)
    at_rest = np.zeros((described.substeps + 1, 6))
    parts = [{"y": at_rest + y[0, 0], "yd": at_rest, "ydd": at_rest}]
    for t in range(1, run.length):
        parts.append({k: v[0] for k, v in platforms.advance(command[:, t]).items()})
    path = {k: np.stack([part[k] for part in parts]) for k in ("y", "yd", "ydd")}
    begin_of = {f"{k}_engine": path[k][:, 0] for k in ("y", "yd")}
    moved = EngineInput(platforms.shape).step({}, {}, {**path, **begin_of})[1]
    return Kinematics(path["y"], path["yd"], moved["acceleration"])


def _start(run: Run, p: LoopParameters, system: System, m: int) -> tuple[Array, Array, Array]:
    """Poses (m k, T, 6), commands (m k, T, 12) and first rates (m k, 6) of k copies."""
    delay, length = p.platform_delay, run.length
    k = len(delay) // m

    def rows(x: Array) -> Array:
        alike = x.reshape(k, length, 6)
        return np.broadcast_to(alike, (m, k, length, 6)).reshape(m * k, length, 6)

    y, y_cmd = rows(run["y"]), rows(run["y_cmd"])
    command = np.empty((*y_cmd.shape[:2], 12))
    sent = rows(sent_rates(run, system)) if _knows_rates(run, system) else None
    for late in np.unique(delay):
        selected = delay == late
        x, rate, _ = differentiated(y_cmd[selected], run.dt, run.band, ahead=-float(late))
        if not late:
            x, rate = y_cmd[selected], rate if sent is None else sent[selected]
        command[selected] = np.concatenate([x, rate], axis=-1)
    begin = differentiated(y[:, : 4 * run.window.skip], run.dt, run.band)[1][:, 0]
    return y, command, begin


def _knows_rates(run: Run, system: System) -> bool:
    """Return True if the log holds what tells the rates that go with the commands."""
    settings = system.emulator_settings
    if settings.operation == "position" or not settings.payload_compensation:
        return False
    return all(k in run for k in ("w", "weight", "q", "controller"))
