"""Files that the studio opens: run logs and episodes, cases, diagnoses."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError, read_table, to_plain
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.case import Case, load_case
from ves_gym.planners.coupling import blocks
from ves_gym.planners.query import Plan
from ves_gym.planners.robust import DIAGNOSIS, read_uncertainty
from ves_gym.report.studio import SHOWN, machine_data, playable
from ves_gym.system.disturbance import tool_error
from ves_gym.system.energy import (
    base_rate,
    internal_of,
    log_base_energy,
    log_energies,
    motion_end,
    system_of,
)
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

_LOGS = (".csv", ".parquet")
_RECORDS = 600  # samples of a log, at most
_DIGITS = 5


def open_item(
    item: str | os.PathLike[str] | RunLog | Case | Plan | Motion, system: System
) -> Any:
    """Turn a file, or what one would be read into, into what the page shows of it: its `kind`
    is log, motion or diagnosis.

    A run log or episode (.csv, .parquet), a case (.toml, .json), the diagnosis.json of `ves-gym
    diagnose`; or a log, a case, a plan or a motion itself. What names no system has the page's.
    """
    if isinstance(item, RunLog):
        return _log(str(item.meta.get("note") or "log"), item, system)
    if isinstance(item, Plan):
        return _motion(item.planner, item.motion, item.query.system, system)
    if isinstance(item, Motion):
        return _motion("motion", item, None, system)
    if isinstance(item, Case):
        return _case("case", item, system)
    return _opened(Path(item), system)


def _opened(file: Path, system: System) -> dict[str, Any]:
    if file.suffix.lower() in _LOGS:
        return _log(file.stem, RunLog.load(file), system)
    table = read_table(file)
    if table.get("schema") == DIAGNOSIS:
        return _opened_diagnosis(file, table)
    if "system" not in table:
        raise ParameterError(
            f"{file}: expected a run log (.csv, .parquet), a case or {DIAGNOSIS}, got"
            f" {table.get('schema')!r}"
        )
    return _case(file.stem, load_case(file), system)


def _case(name: str, case: Case, displayed: System) -> dict[str, Any]:
    if case.motion is None:
        raise ParameterError(f"{name}: the case has no motion")
    return _motion(name, case.motion, case.system, displayed)


def _motion(
    name: str, motion: Motion, described: System | None, displayed: System
) -> dict[str, Any]:
    arm = (described or displayed).arm
    if motion.n != arm.n:
        raise ParameterError(f"{name}: {arm.name} has {arm.n} joints, got {motion.n}")
    if motion.moving:
        raise ParameterError(f"{name}: the studio plays motions that begin at rest")
    item = {"kind": "motion", "name": name, "motion": to_plain(motion)}
    return item | _machine(described, displayed)


def _machine(described: System | None, displayed: System) -> dict[str, Any]:
    """The machine of a file, where it is another than the page's."""
    if described is None or described.hash == displayed.hash:
        return {}
    return {"machine": machine_data(described)}


def _log(name: str, log: RunLog, displayed: System) -> dict[str, Any]:
    system = system_of(log) if "system" in log.meta else None
    machine = _machine(system, displayed)
    system = playable(system or displayed)
    if log.n_joints != system.arm.n:
        raise ParameterError(
            f"{name}: {system.arm.name} has {system.arm.n} joints, the log has {log.n_joints}"
        )
    clock = log.t - log.t[0]
    last = int(np.searchsorted(clock, motion_end(log) + SHOWN, side="right"))
    at = np.unique(np.linspace(0, last - 1, min(last, _RECORDS)).round().astype(int))
    rate, internal = base_rate(log), internal_of(system, log)
    omega, modes = _by_mode(log, system, rate, internal)
    columns: dict[str, Array | None] = {
        "t": clock,
        "q": log.q,
        "v": np.gradient(log.q, clock, axis=0) if log.v is None else log.v,
        "tau": log.tau,
        "tool": np.linalg.norm(tool_error(system.arm, log.q, log.q_cmd, log.y), axis=-1),
        "y": log.y,
        "yd": rate,
        "u": None if internal is None else internal[0],
        "ydd": np.gradient(rate, clock, axis=0),
        "E": log_base_energy(log, system).total,
        "modes": modes,
    }
    track: dict[str, Any] = {
        name: None if values is None else _rounded(values[at])
        for name, values in columns.items()
    }
    if omega is not None:
        omega = omega.tolist()
    track |= {"duration": motion_end(log), "omega": omega, **_energies(log, system)}
    track["stops"] = log.meta.get("events", [])
    return {"kind": "log", "name": name, "track": track} | machine


def _energies(log: RunLog, system: System) -> dict[str, float | None]:
    """E_mean and E_peak; None of a log that ends before the mean's time does."""
    try:
        energies = log_energies(log)
    except ParameterError:
        peak = float(log_base_energy(log, system).total.max())
        return {"E_mean": None, "E_peak": peak}
    return {"E_mean": energies.E_mean, "E_peak": energies.E_peak}


def _by_mode(
    log: RunLog, system: System, rate: Array, internal: tuple[Array, Array] | None
) -> tuple[Array | None, Array | None]:
    """Frequencies (b,) [rad/s] of the base under the arm as it ends, energies (N, b) [J]."""
    K = system.base.full()[2]
    if not K.any():
        return None, None
    inertia = blocks(system, log.q[-1]).Mt
    solution = natural_modes(K, inertia)
    x, xd = log.y, rate
    if internal is not None:
        x, xd = np.hstack([x, internal[0]]), np.hstack([xd, internal[1]])
    rows = inertia @ solution.shapes
    return solution.omega, 0.5 * ((xd @ rows) ** 2 + (x @ rows * solution.omega) ** 2)


def _opened_diagnosis(path: Path, table: Mapping[str, Any]) -> dict[str, Any]:
    keys = ("schema", "verdict", "sentence", "effects")
    displayed = {key: table[key] for key in keys if key in table}
    item: dict[str, Any] = {"kind": "diagnosis", "name": path.stem, "diagnosis": displayed}
    try:
        machine = read_uncertainty(path).estimate
    except ParameterError:  # nothing of arm or base: the described machine moves as before
        machine = None
    if machine is not None:
        item["machine"] = machine_data(machine)
    return item


def _rounded(values: Array) -> Any:
    """Significant digits that a picture needs, as plain numbers."""
    return json.loads(
        json.dumps(values.tolist()),
        parse_float=lambda text: float(f"{float(text):.{_DIGITS}g}"),
    )
