"""`ves-gym list`: what exists."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym._util.own import installed
from ves_gym._util.params import ParameterError, read_table
from ves_gym._util.tables import table
from ves_gym.baselines.policy import RELEASED
from ves_gym.baselines.registry import CONTROLLERS
from ves_gym.cli.flags import Answer, Context, Flag, one_of
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.main import COMMANDS
from ves_gym.effects import EFFECTS
from ves_gym.engine.backends import BACKENDS
from ves_gym.envs.build import build_task
from ves_gym.envs.registration import ENTRY_POINT, IDS
from ves_gym.envs.signals import goal_space, observation_space
from ves_gym.hardware.leg_response import bandwidth, gain_margin
from ves_gym.hardware.leg_servo import LEG_SERVOS, leg_clock
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.mechanics.servo import own_gains
from ves_gym.mechanics.vehicle import BENT, VEHICLES
from ves_gym.planners.case import Case
from ves_gym.planners.coupling import modes
from ves_gym.planners.registry import PLANNERS
from ves_gym.planners.suites import SUITES, get_suite
from ves_gym.simulation.emulation_loop import EmulationLoop
from ves_gym.system.system import System

BLOCKS = "blocks"  # of an emulation loop; `KINDS` has all that exists once
UNITS = {"hz": "Hz", "s": "s"}  # endings of the keys of quantities
Rows = list[dict[str, Any]]


def show(at: Context, *, what: str | None = None) -> Answer:
    """Return one table per kind."""
    kinds = [*KINDS, BLOCKS] if what is None else [what]
    tables = {name: KINDS[name]() for name in kinds if name in KINDS}
    if BLOCKS in kinds:
        tables |= _blocks(at.case)
    elif at.machine:
        option = next(iter(at.machine)).replace("_", "-")
        raise ParameterError(f"--{option} is for `list {BLOCKS}`, got `list {what}`")
    text = "\n".join(_table(name, rows) for name, rows in tables.items())
    return Answer(text=text, plain={"schema": "ves-list/1", **tables})


def _blocks(case: Case) -> dict[str, Rows]:
    """Blocks of an emulation loop, and the wires between them."""
    mode = case.system.mode
    if mode != "emulated":
        raise ParameterError(f"list {BLOCKS} is about --mode emulated, got {mode}")
    loop = EmulationLoop(case.system, 1, [np.random.default_rng(case.seed)])
    return {
        BLOCKS: loop.wiring.describe_blocks(loop.p),
        "wires": loop.wiring.describe(loop.shape),
    }


def _arms() -> Rows:
    return [
        {
            "name": name,
            "joints": arm.n,
            "mass": f"{arm.mass:.4g} kg",
            "length": f"{sum(np.hypot(link.a, link.d) for link in arm.links):.3g} m",
            "servo": own_gains(arm, BENT).source,
            "source": arm.source,
        }
        for name, arm in ((name, get_arm(name)) for name in arm_names())
    ]


def _vehicles() -> Rows:
    rows = []
    for name, vehicle in VEHICLES.items():
        system = System(vehicle=vehicle)
        hertz = modes(system, np.zeros(system.arm.n)).omega / (2 * np.pi)
        stiff = bool(system.base.K.any())
        rows.append(
            {
                "name": name,
                "kind": type(vehicle).kind,
                "frequencies_hz": [float(f"{f:.4g}") for f in hertz] if stiff else [],
                "source": vehicle.source,
            }
        )
    return rows


def _suites() -> Rows:
    return [
        {
            "name": name,
            "queries": len(suite.queries),
            "durations_s": sorted({q.duration for _, q in suite.queries}),
            "vehicles": sorted({v for v, _ in suite.queries}),
            "planners": list(suite.planners),
        }
        for name, suite in ((name, get_suite(name, system=System())) for name in SUITES)
    ]


def _effects() -> Rows:
    def parameter(field: Any) -> str:
        (low, high), unit = field.metadata["bounds"], field.metadata["unit"]
        size = " x ".join("any" if k is None else str(k) for k in field.metadata["shape"])
        name = f"{field.name} ({size})" if size else field.name
        return f"{name} {low:g} to {high:g}{'' if unit == '1' else f' {unit}'}"

    return [
        {
            "name": kind,
            "modes": list(effect.modes),
            "parameters": [parameter(f) for f in dataclasses.fields(effect)],  # type: ignore[arg-type]
            "summary": " ".join((effect.__doc__ or "").split("\n\n")[0].split()),
        }
        for kind, effect in sorted(EFFECTS.items())
    ]


def _platforms() -> Rows:
    rows: Rows = [{"name": "a number", "kind": "pose", "source": "second-order pose servo, Hz"}]
    for name, servo in LEG_SERVOS.items():
        control_dt, _ = leg_clock(servo)
        what = f"-3 dB at {bandwidth(servo):.2g} Hz, gain margin {gain_margin(servo):.2g},"
        what += f" {1 / control_dt:.4g} Hz control rate: {servo.source}"
        rows.append({"name": name, "kind": "legs", "source": what})
    return rows


def _environments() -> Rows:
    rows = []
    for id, spec in gym.registry.items():
        if spec.entry_point != ENTRY_POINT:  # another package's, or the user's own
            continue
        settings = dict(spec.kwargs)
        goal = settings.pop("goal", False)
        task = build_task(**settings)
        box = observation_space(task)
        parts = goal_space(task, box) if goal else {"": box}
        shapes = {name: list(part.shape or ()) for name, part in parts.items()}
        rows.append(
            {
                "name": id,
                "version": spec.version,
                "task": task.kind,
                "observation": shapes if goal else shapes[""],
                "action": [task.action_width],
                "max_episode_steps": spec.max_episode_steps,
            }
        )
    return rows


def _policies() -> Rows:
    return [
        {
            "environment": plain["about"]["env"],
            "name": path.stem,
            "seed": plain["about"]["seed"],
            "steps": plain["about"]["steps"],
            "layers": plain["network"]["sizes"],
        }
        for path, plain in ((k, read_table(k)) for k in sorted(RELEASED.glob("*/*.json")))
    ]


KINDS: dict[str, Callable[[], Rows]] = {
    "arms": _arms,
    "vehicles": _vehicles,
    "planners": lambda: [
        *({"name": k, "summary": p.summary} for k, p in PLANNERS.items()),
        *({"name": k.name, "summary": k.value} for k in installed("planners")),
    ],
    "suites": _suites,
    "effects": _effects,
    "platforms": _platforms,
    "environments": _environments,
    "backends": lambda: [{"name": name} for name in BACKENDS],
    "controllers": lambda: [
        *(
            {
                "name": name,
                "tasks": list(entry.tasks) if len(entry.tasks) < len(IDS) else ["all"],
                "summary": entry.summary,
            }
            for name, entry in CONTROLLERS.items()
        ),
        *({"name": k.name, "tasks": [], "summary": k.value} for k in installed("controllers")),
    ],
    "policies": _policies,
    "commands": lambda: [{"name": k, "summary": text} for k, (_, text) in COMMANDS.items()],
}


def _table(title: str, rows: Rows) -> str:
    head = []
    for key in rows[0]:
        name, _, last = key.rpartition("_")
        head.append(f"{name} [{UNITS[last]}]" if last in UNITS else key.replace("_", " "))
    note = "\nfrequencies: arm at q = 0, joints locked" if title == "vehicles" else ""
    cells = [[_text(value) for value in row.values()] for row in rows]
    return table(head, cells, title=title, left=range(len(head)), width=164) + note


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in value) or "-"
    if isinstance(value, dict):
        return ", ".join(f"{k} ({_text(v)})" if v else k for k, v in value.items()) or "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value) or "-"


TABLE = {
    "list": (show, (
        Flag("WHAT", "", one_of(*KINDS, BLOCKS), optional=True,
             help=f"{', '.join([*KINDS, BLOCKS])} (the options below say of which emulated"
             " system); default all of them"),
        *MACHINE,
    )),
}  # fmt: skip
