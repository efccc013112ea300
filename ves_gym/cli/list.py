"""`ves-gym list`: what exists."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.cli.common import add_system_arguments, system_from, write_json

SCHEMA = "ves-list/1"
BLOCKS = "blocks"  # of an emulation loop; `KINDS` has all that exists once
UNITS = {"hz": "Hz", "s": "s"}  # endings of the keys of quantities


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "what",
        nargs="?",
        metavar="WHAT",
        help=f"{', '.join([*KINDS, BLOCKS])} (the options below say of which emulated system);"
        " default all of them",
    )
    add_system_arguments(parser, angles=False)


def run(args: argparse.Namespace) -> int:
    """Print one table per kind."""
    known = [*KINDS, BLOCKS]
    if args.what is not None and args.what not in known:
        raise ParameterError(
            f"WHAT must be one of {', '.join(known)}, got {args.what!r}"
            f"{did_you_mean(args.what, known)}"
        )
    names = known if args.what is None else [args.what]
    if BLOCKS not in names:
        _require_no_system(args)
    tables = {name: KINDS[name]() for name in names if name in KINDS}
    if BLOCKS in names:
        tables |= _blocks(args)
    write_json(args.json, {"schema": SCHEMA, **tables})
    for name, rows in tables.items():
        _print_table(name, rows)
    return 0


Rows = list[dict[str, Any]]


def _require_no_system(args: argparse.Namespace) -> None:
    """Refuse options that only the list of blocks goes by."""
    parser = argparse.ArgumentParser()
    add_system_arguments(parser, angles=False)
    for name, default in vars(parser.parse_args([])).items():
        if getattr(args, name) != default:
            raise ParameterError(
                f"--{name.replace('_', '-')} is for `list {BLOCKS}`, got `list {args.what}`"
            )


def _blocks(args: argparse.Namespace) -> dict[str, Rows]:
    """Blocks of an emulation loop, and the wires between them."""
    from ves_gym.simulation.emulation_loop import EmulationLoop

    if args.mode not in (None, "emulated"):
        raise ParameterError(f"list {BLOCKS} is about --mode emulated, got {args.mode}")
    if args.system is None:  # a file says its own mode
        args.mode = "emulated"
    loop = EmulationLoop(system_from(args), 1, [np.random.default_rng(args.seed)])
    return {
        BLOCKS: loop.wiring.describe_blocks(loop.p),
        "wires": loop.wiring.describe(loop.shape),
    }


def _arms() -> Rows:
    from ves_gym.mechanics.arm_library import arm_names, get_arm
    from ves_gym.mechanics.servo import own_gains

    out = []
    for name in arm_names():
        arm = get_arm(name)
        reach = float(sum(np.hypot(link.a, link.d) for link in arm.links))
        row = {"name": name, "joints": arm.n, "mass": f"{arm.mass:.4g} kg"}
        row |= {"length": f"{reach:.3g} m", "servo": own_gains(arm).source}
        out.append({**row, "source": arm.source})
    return out


def _vehicles() -> Rows:
    from ves_gym.mechanics.vehicle import VEHICLES
    from ves_gym.planners.coupling import modes
    from ves_gym.system.system import System

    out = []
    for name, vehicle in VEHICLES.items():
        system = System(vehicle=vehicle)
        rates = modes(system, np.zeros(system.arm.n)).omega / (2 * np.pi)
        frequencies = [] if not system.base.K.any() else [float(f"{f:.4g}") for f in rates]
        out.append(
            {
                "name": name,
                "kind": type(vehicle).kind,
                "frequencies_hz": frequencies,
                "source": vehicle.source,
            }
        )
    return out


def _planners() -> Rows:
    from ves_gym.planners.registry import PLANNERS

    return [{"name": name, "summary": p.summary} for name, p in PLANNERS.items()]


def _suites() -> Rows:
    from ves_gym.planners.suites import SUITES, get_suite
    from ves_gym.system.system import System

    out = []
    for name in SUITES:
        suite = get_suite(name, system=System())
        out.append(
            {
                "name": name,
                "queries": len(suite.queries),
                "durations_s": sorted({q.duration for _, q in suite.queries}),
                "vehicles": sorted({v for v, _ in suite.queries}),
                "planners": list(suite.planners),
            }
        )
    return out


def _effects() -> Rows:
    from ves_gym.effects import EFFECTS

    out = []
    for kind in sorted(EFFECTS):
        effect = EFFECTS[kind]
        fields = dataclasses.fields(effect)  # type: ignore[arg-type]
        parts = []
        for f in fields:
            low, high = f.metadata["bounds"]
            size = " x ".join("any" if k is None else str(k) for k in f.metadata["shape"])
            unit = "" if f.metadata["unit"] == "1" else f" {f.metadata['unit']}"
            parts.append(f"{f.name}{f' ({size})' if size else ''} {low:g} to {high:g}{unit}")
        summary = (effect.__doc__ or "").split("\n\n")[0]
        out.append({"name": kind, "parameters": parts, "summary": " ".join(summary.split())})
    return out


def _platforms() -> Rows:
    from ves_gym.hardware.leg_response import bandwidth, gain_margin
    from ves_gym.hardware.leg_servo import LEG_SERVOS, leg_clock

    rows: Rows = [{"name": "a number", "kind": "pose", "source": "second-order pose servo, Hz"}]
    for name, servo in LEG_SERVOS.items():
        control_dt, _ = leg_clock(servo)
        what = f"-3 dB at {bandwidth(servo):.2g} Hz, gain margin {gain_margin(servo):.2g},"
        what += f" {1 / control_dt:.4g} Hz control rate: {servo.source}"
        rows.append({"name": name, "kind": "legs", "source": what})
    return rows


def _environments() -> Rows:
    import gymnasium as gym

    from ves_gym.envs.build import build_task
    from ves_gym.envs.registration import ENTRY_POINT
    from ves_gym.envs.spaces import goal_space, observation_space

    out = []
    for id, spec in gym.registry.items():
        if spec.entry_point != ENTRY_POINT:  # another package's, or the user's own
            continue
        settings = dict(spec.kwargs)
        goal = settings.pop("goal", False)
        task = build_task(**settings)
        box = observation_space(task)
        parts = goal_space(task, box) if goal else {"": box}
        shapes = {name: list(part.shape or ()) for name, part in parts.items()}
        out.append(
            {
                "name": id,
                "version": spec.version,
                "task": task.kind,
                "observation": shapes if goal else shapes[""],
                "action": [task.action_width],
                "max_episode_steps": spec.max_episode_steps,
            }
        )
    return out


def _backends() -> Rows:
    from ves_gym.engine.backends.registry import BACKENDS

    return [{"name": name} for name in BACKENDS]


def _policies() -> Rows:
    from ves_gym._util.params import read_table
    from ves_gym.baselines.policy import RELEASED

    out = []
    for path in sorted(RELEASED.glob("*/*.json")):
        plain = read_table(path)
        about = plain["about"]
        out.append(
            {
                "environment": about["env"],
                "name": path.stem,
                "seed": about["seed"],
                "steps": about["steps"],
                "layers": plain["network"]["sizes"],
            }
        )
    return out


def _commands() -> Rows:
    from ves_gym.cli.main import COMMANDS

    return [{"name": name, "summary": text} for name, text in COMMANDS.items()]


KINDS: dict[str, Callable[[], Rows]] = {
    "arms": _arms,
    "vehicles": _vehicles,
    "planners": _planners,
    "suites": _suites,
    "effects": _effects,
    "platforms": _platforms,
    "environments": _environments,
    "backends": _backends,
    "policies": _policies,
    "commands": _commands,
}


def _print_table(title: str, rows: Rows) -> None:
    from rich.console import Console
    from rich.table import Table

    note = "frequencies: arm at q = 0, joints locked" if title == "vehicles" else None
    table = Table(title=title, title_justify="left", caption=note, caption_justify="left")
    for key in rows[0]:
        name, _, last = key.rpartition("_")
        table.add_column(f"{name} [{UNITS[last]}]" if last in UNITS else key.replace("_", " "))
    for row in rows:
        table.add_row(*(_text(value) for value in row.values()))
    Console(width=None if sys.stdout.isatty() else 164, markup=False).print(table)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in value) or "-"
    if isinstance(value, dict):
        parts = [f"{k} ({_text(v)})" if v else k for k, v in value.items()]
        return ", ".join(parts) or "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value) or "-"
