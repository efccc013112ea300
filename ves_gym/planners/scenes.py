"""Simulated paths as page data: energy traces, coupling maps, the moving structure."""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import Array, to_plain
from ves_gym.mechanics.kinematics import joint_positions
from ves_gym.mechanics.spatial import rotation
from ves_gym.mechanics.vehicle import beam_line
from ves_gym.planners.coupling_map import CouplingMap, coupling_map
from ves_gym.planners.query import Plan
from ves_gym.simulation.recording import Recording
from ves_gym.system.energy import (
    base_energy,
    internal_of,
    log_base_energy,
    motion_end,
    system_of,
)
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System


class PlayedPlan(NamedTuple):
    """A plan, and which run of a recording plays it."""

    plan: Plan
    run: Recording
    k: int
    label: str  # the planner's name, as it was asked
    ideal: Recording | None = None  # mode emulated: the same motions in space


_FRAME = 0.05  # s between frames of an animation
_AFTER = 4.0  # s of an animation after the motion
_POINTS = 49  # per axis of a map


def trace(vehicle: str, runs: list[PlayedPlan]) -> dict[str, Any]:
    """Base energy against time of every planner's answer to one query: t [s] and E [J].

    Mode emulated: also strain energy and distance of the base from rest, and all of them
    in space (`ideal`); a stopped run ends with its stop.
    """
    query = runs[0].plan.query
    series: list[dict[str, Any]] = []
    for _, run, k, label, ideal in runs:
        series.append({"planner": label, **_curves(run, k, ideal is not None)})
        if ideal is not None:
            series[-1]["ideal"] = _curves(ideal, k, True)
    return {
        "vehicle": vehicle,
        "duration": query.duration,
        "query": query.name,
        "series": series,
    }


def _curves(run: Recording, k: int, detailed: bool) -> dict[str, list[float]]:
    """Time [s] and energy [J] of a run, about 400 points; `more`: strain [J], distance [m]."""
    part = slice(0, run.records(k), max(1, len(run.t) // 400))
    motion = run.q[k, part], run.y[k, part], run.yd[k, part]
    energy = base_energy(run.system, *motion, run.internal(k, part))
    out = {"t": _round(run.t[part], 4), "E": _digits(energy.total)}
    if detailed:
        out["strain"] = _digits(energy.strain)
        out["distance"] = _digits(np.linalg.norm(run.y[k, part, :3], axis=-1))
    return out


def coupling_maps(vehicle: str, plans: list[Plan]) -> list[dict[str, Any]]:
    """Map the cross-sections of the first three joints through the start of a query.

    With the path of every plan drawn on them; of an arm of two joints, one.
    """
    query = plans[0].query
    pairs = itertools.combinations(range(min(3, query.system.arm.n)), 2)
    maps = (coupling_map(query.system, two, query.start, points=_POINTS) for two in pairs)
    return [map_data(vehicle, section, plans) for section in maps]


def map_data(vehicle: str, section: CouplingMap, plans: list[Plan]) -> dict[str, Any]:
    """Turn a coupling map into plain data: axes, lines and paths [deg], coupling [J/rad^2]."""
    i, j = section.joints
    others = ", ".join(
        f"q{k + 1} = {np.rad2deg(value) + 0.0:.0f}°"
        for k, value in enumerate(section.fixed)
        if k not in section.joints
    )
    if section.others != "given":
        others = f"others where coupling is {section.others}"
    what = "Q" if section.duration is None else f"Q_T for {section.duration:g} s"
    data: dict[str, Any] = {
        "vehicle": vehicle,
        "title": f"{what}: joints {i + 1} and {j + 1} ({others})",
        "joints": [i + 1, j + 1],
        "x": _degrees(section.axes[0]),
        "y": _degrees(section.axes[1]),
        "most": [[float(f"{v:.4g}") for v in row] for row in section.most],
        "lines": [[_degrees(p) for p in curve[::3]] for curve in section.lines()],
        "paths": [],
    }
    for plan in plans:
        path = plan.motion.at(np.linspace(0, plan.query.duration, 41)).q[:, [i, j]]
        data["paths"].append({"planner": plan.planner, "points": [_degrees(p) for p in path]})
    if plans:
        start, goal = plans[0].query.ends
        data["start"], data["goal"] = _degrees(start[[i, j]]), _degrees(goal[[i, j]])
    return data


def platform_data(system: System) -> dict[str, Any] | None:
    """Describe the platform that stands under the arm in mode emulated; None in space.

    Joints of the six legs (6, 3) seen from the platform top at home [m], `heads` in its frame,
    and limits [m], [m/s].
    """
    if system.mode != "emulated":
        return None
    stewart = system.emulator_settings.stewart
    return {
        "feet": _round(stewart.feet, 6),
        "heads": _round(np.array(stewart.top), 6),
        **{name: getattr(stewart, name) for name in ("length_min", "length_max", "speed_max")},
    }


def scene(vehicle: str, runs: list[PlayedPlan]) -> dict[str, Any]:
    """The arm on the swaying base, frame by frame, for every planner's answer to one query.

    Points of arm and beam [m], base pose [m, rad], E [J]; the platform of an emulated run.
    """
    query = runs[0].plan.query
    data: dict[str, Any] = {
        "vehicle": vehicle,
        "duration": query.duration,
        "query": query.name,
        "rest_beam": _rest_beam(query.system),
        "obstacles": to_plain(query.surroundings.obstacles if query.surroundings else ()),
    }
    at = np.arange(0, query.duration + _AFTER, _FRAME)
    data["runs"] = [_frames(plan.planner, run.log(k), at) for plan, run, k, *_ in runs]
    return data


def log_scene(name: str, log: RunLog) -> dict[str, Any]:
    """The same of one recorded run, whole, under a name."""
    at = np.arange(0, log.t[-1] - log.t[0] + 1e-9, _FRAME)
    return {
        "duration": motion_end(log),
        "rest_beam": _rest_beam(system_of(log)),
        "runs": [_frames(name, log, at)],
    }


def _rest_beam(system: System) -> Any:
    line = beam_line(system.vehicle, np.zeros((1, 6)))
    return None if line is None else _round(line[0], 3)


def _frames(name: str, log: RunLog, at: Array) -> dict[str, Any]:
    """A run at times (T,) [s] after its start; one that stopped stays where it stopped."""
    system, clock = system_of(log), log.t - log.t[0]
    index = np.searchsorted(clock, at - 1e-9).clip(max=len(clock) - 1)
    y, q, modes = log.y[index], log.q[index], internal_of(system, log)
    arm = joint_positions(system.arm, q) @ np.swapaxes(rotation(y), -1, -2)
    beam = beam_line(system.vehicle, y, None if modes is None else modes[0][index])
    return {
        "planner": name,
        "dt": _FRAME,
        "arm": _round(arm + y[:, None, :3], 4),
        "base": _round(y, 5),
        "beam": None if beam is None else _round(beam, 4),
        "E": _digits(log_base_energy(log, system).total[index], 4),
        "platform": platform_data(system),
    }


def _degrees(values: Array) -> list[float]:
    return _round(np.rad2deg(values), 2)


def _digits(values: Array, digits: int = 5) -> list[float]:
    """Rounded to significant digits."""
    return [float(f"{value:.{digits}g}") for value in values]


def _round(values: Array, digits: int) -> Any:
    return np.round(values, digits).tolist()
