"""The studio: one HTML file in which a path is drawn and the base's energy follows.

The page simulates by itself, from the description of arm and base that stands in it; it shows
how far its energies are from those of the simulator for the motions that came with it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from ves_gym._util.params import Array, ParameterError, to_plain, toml
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.limits import limit_ratios
from ves_gym.mechanics.link import Inertial
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.servo import OWN_GAINS
from ves_gym.mechanics.spatial import matvec
from ves_gym.mechanics.vehicle import beam_line, vehicle_name
from ves_gym.planners.case import Case
from ves_gym.planners.prediction import predict
from ves_gym.planners.query import Plan, Query
from ves_gym.planners.scenes import platform_data
from ves_gym.report.pages import page, part, require_schema
from ves_gym.simulation.playback import play_motions
from ves_gym.simulation.recording import Recording
from ves_gym.system.energy import TAIL
from ves_gym.system.system import System

SCHEMA = "ves-studio/1"
_SCRIPTS = (  # one module, in this order
    "dom drawing studio_dynamics studio_motion studio_base scene platform player studio_map"
    " studio_charts studio_files studio_share studio"
)
SHOWN = 4.0  # s after the motion that the page shows
_RECORD = 0.0125  # s between samples of the motions that the page's energies are compared with
_JOINT = ("damping", "friction", "q_min", "q_max", "v_max", "tau_max")
_BEGIN = (0.25, 0.6)  # of the duration, where the search for way-points begins
_LOOKS = 16  # of that search
_ROOM = 1e-2  # that it leaves of each limit: its own is a little soft
_SHARES = {"position": 1.0, "velocity": 1.0, "torque": 0.7}  # of limits
_SLOWER = (1.0, 1.5)  # durations of these, over that of the motion shown


def low_energy_waypoints(query: Query, near: Motion | None = None) -> list[Array]:
    """Return two way-points (n,) [rad] that make the drawn path calm, or none if none do.

    E_mean of the path through them is minimised within the arm's limits, from half way between
    the straight line and a motion, such as a planner's.
    """
    system = playable(query.system)
    arm, (start, goal), T = system.arm, query.ends, query.duration
    servo, straight = OWN_GAINS.for_arm(arm, system.vehicle), query.straight
    middle = np.array(_BEGIN) * T
    points = (straight.at(middle).q + (near or straight).at(middle).q) / 2

    def through(x: Array) -> Motion:
        return Motion.through([start, *x.reshape(points.shape), goal], T)

    def energy(x: Array) -> float:  # its logarithm, so that arms of any size stop alike
        return float(np.log(predict(system, through(x), servo).E_mean / E_straight))

    E_straight = predict(system, straight, servo).E_mean
    best = minimize(
        energy,
        points.ravel(),
        method="SLSQP",
        bounds=list(zip(arm.column("q_min"), arm.column("q_max"), strict=True)) * len(points),
        constraints={"type": "ineq", "fun": lambda x: _room(arm, through(x)) - _ROOM},
        options={"maxiter": _LOOKS, "eps": 1e-4, "ftol": 1e-2},
    )
    calmer = best.fun < 0 and _possible(arm, through(best.x))
    return list(best.x.reshape(points.shape)) if calmer else []


def playable(system: System) -> System:
    """Return a system as the page simulates it: in space, nominal, without effects.

    Refused: links or gears that give way, joints that slide, wheels or appendages on the base,
    or a base with quadratic drag.
    """
    arm, base = system.arm, system.base
    arm.require_rigid("the studio")
    arm.require_turning("the studio")
    arm.require_alone("the studio")
    for what, there in (
        ("gears that give way", arm.geared),
        ("wheels or appendages on its base", base.carried),
        ("a base with quadratic drag", base.drag is not None),
    ):
        if there:
            raise ParameterError(
                f"the studio simulates a rigid arm on a linear base, got {system!r} with {what}"
            )
    nominal = system.ideal() if system.mode != "ideal" else system
    return nominal.replace(effects=()) if nominal.effects else nominal


def machine_data(system: System) -> dict[str, Any]:
    """Describe arm, base, servo, beam and platform as plain numbers in SI units; in mode
    emulated the platform stands in the beam's place. The base's matrices are over (Y, internal
    modes)."""
    platform, system = platform_data(system), playable(system)
    arm, base = system.arm, system.base
    M, D, K = base.full()
    servo = OWN_GAINS.for_arm(arm, system.vehicle) if system.drive == "motor" else None
    return {
        "name": f"{arm.name} on {vehicle_name(system.vehicle)}",
        "hash": system.hash,
        "arm": _arm(arm),
        "base": {"M": M.tolist(), "D": D.tolist(), "K": K.tolist()},
        "servo": None if servo is None else {"kp": list(servo.kp), "kd": list(servo.kd)},
        "beam": None if platform else _beam(system.vehicle, base),
        "platform": platform,
    }


def _arm(arm: Arm) -> dict[str, Any]:
    R = np.eye(3) if arm.mount is None else arm.mount.rotation
    p = (0.0, 0.0, 0.0) if arm.mount is None else arm.mount.position
    names = [link.name or f"joint {k + 1}" for k, link in enumerate(arm.links)]
    if all(re.search(r"[_-]joint$", name) for name in names):  # then it says nothing
        names = [name[: -len("_joint")] for name in names]
    links = []
    for name, link in zip(names, arm.links, strict=True):
        turns = {"a": link.alpha or 0.0, "b": link.beta or 0.0}
        links.append(
            {
                "name": name,
                # rounded, so that a right angle is one
                **{f"c{k}": round(math.cos(x), 15) for k, x in turns.items()},
                **{f"s{k}": round(math.sin(x), 15) for k, x in turns.items()},
                "slides": bool(link.slides),
                **_inertial(link.inertial),
                "rotor": link.rotor_inertia,
                **{x: getattr(link, x) or 0.0 for x in ("d", "a", "offset", *_JOINT)},
            }
        )
    return {
        "name": arm.name,
        "mount": {"R": R.T.ravel().tolist(), "p": list(p)},
        "base": _inertial(arm.base),
        "links": links,
    }


def _inertial(body: Inertial) -> dict[str, Any]:
    inertia = [list(row) for row in body.inertia]
    return {"mass": body.mass, "com": list(body.com), "inertia": inertia}


def _beam(vehicle: Any, base: BaseModel) -> dict[str, Any] | None:
    """Centreline at rest (k, 3) and its displacement per coordinate of the base (k, 3, b)."""
    still = beam_line(vehicle, np.zeros((1, 6)), np.zeros((1, base.m)))
    if still is None:
        return None
    unit = np.eye(6 + base.m)
    bent = beam_line(vehicle, unit[:, :6], unit[:, 6:])
    assert bent is not None
    return {
        "rest": still[0].round(5).tolist(),
        "shape": np.moveaxis(bent - still, 0, -1).round(9).tolist(),
    }


def reference_motions(
    system: System, start: Array, goal: Array, duration: float
) -> list[tuple[str, Motion]]:
    """Return motions to compare the page's energies with, between joint angles (n,) [rad] in a
    duration [s]: straight ones and through points."""
    arm = system.arm
    low, high = arm.column("q_min"), arm.column("q_max")
    middle = (start + goal) / 2
    side = np.where(np.arange(arm.n) % 2, -1.0, 1.0) * np.minimum(0.25, (high - low) / 8)
    detour = np.clip(middle + side, low, high)
    other = np.clip(middle - 2 * side, low, high)
    back = np.clip(2 * start - goal, low, high)
    out = []
    for T in (duration * k for k in _SLOWER):
        out += [
            (f"straight, {T:g} s", Motion.straight(start, goal, T)),
            (f"straight to the other side, {T:g} s", Motion.straight(start, back, T)),
            (f"through one point, {T:g} s", Motion.through([start, detour, goal], T)),
            (f"through two points, {T:g} s", Motion.through([start, detour, other, goal], T)),
        ]
    return [(name, motion) for name, motion in out if _possible(arm, motion)]


def _possible(arm: Arm, motion: Motion) -> bool:
    """True if joints and motors keep their limits, with room for what the base adds."""
    return bool((_room(arm, motion) >= 0).all())


def _room(arm: Arm, motion: Motion) -> Array:
    """What a motion leaves of `_SHARES`, per limit and joint; below 0 where it takes more."""
    ratios = limit_ratios(arm, motion)
    return np.concatenate([most - ratios[k] for k, most in _SHARES.items()])


def references(system: System, motions: Sequence[tuple[str, Motion]]) -> list[dict[str, Any]]:
    """Simulate motions and return their energies beside what the page needs to play them.

    In mode emulated also what the platform does in the laboratory, as described, without
    effects: the legs' largest way from home [m] and speed [m/s].
    """
    lab = system.replace(effects=()) if system.mode == "emulated" else None
    system = playable(system)
    out: list[dict[str, Any]] = []
    for T in dict.fromkeys(motion.duration for _, motion in motions):
        group = [(name, motion) for name, motion in motions if motion.duration == T]
        run = _played(system, group, system.physics_dt)
        real = None if lab is None else _played(lab, group, lab.control_dt)
        for k, ((name, motion), energies) in enumerate(zip(group, run.energies(), strict=True)):
            row = {"name": name, "motion": to_plain(motion)}
            row |= {"E_mean": energies.E_mean, "E_peak": energies.E_peak}
            out.append(row if real is None else row | {"legs": _legs(real, k)})
    return out


def _played(system: System, group: Sequence[tuple[str, Motion]], period: float) -> Recording:
    """Motions of one duration, recorded about every `_RECORD` s, at multiples of a period."""
    return play_motions(
        system,
        [motion for _, motion in group],
        servo=OWN_GAINS,
        settle=TAIL,
        record_dt=max(1, round(_RECORD / period)) * period,
    )


def _legs(run: Recording, k: int) -> dict[str, float | None]:
    """Largest way from home [m] and speed [m/s] of a leg; None of a platform that stopped."""
    if any(event.simulation == k for event in run.events):
        return {"way": None, "speed": None}
    stewart = run.system.emulator_settings.stewart
    early = run.t <= run.duration + SHOWN
    y, yd = run.y[k, early], run.yd[k, early]
    way = stewart.leg_lengths(y) - stewart.home_lengths
    speed = matvec(stewart.jacobian(y), yd)
    return {"way": float(np.abs(way).max()), "speed": float(np.abs(speed).max())}


def studio_data(
    query: Query,
    via: Sequence[Array] = (),
    opened: Sequence[dict[str, Any]] = (),
    plans: Sequence[Plan] = (),
) -> dict[str, Any]:
    """Return all that the page holds: a query, way-points (n,) between its ends [rad], files
    opened as `studio_files` reads them, and plans to compare with."""
    system = query.system
    planned = [
        {"kind": "motion", "name": plan.planner, "motion": to_plain(plan.motion)}
        for plan in plans
        if plan.found
    ]
    start, goal = query.ends
    motions = reference_motions(system, start, goal, query.duration)
    return {
        "schema": SCHEMA,
        "machine": machine_data(system),
        "case": toml(Case(system=system.replace(effects=())).to_dict()),
        "start": start.tolist(),
        "goal": goal.tolist(),
        "via": [np.asarray(q, float).tolist() for q in via],
        "duration": query.duration,
        "references": references(system, motions),
        "opened": list(opened),
        "planned": planned,
    }


def render_studio(data: dict[str, Any]) -> str:
    """Return the text of the page of what `studio_data` returns."""
    require_schema(data, SCHEMA, "data")
    return page(
        "report/studio.html",
        title=f"Studio: {data['machine']['name']}",
        styles=("report/studio.css",),
        scripts=[f"report/{name}.js" for name in _SCRIPTS.split()],
        data=data,
        scene_controls=part("report/scene_controls.html"),
    )
