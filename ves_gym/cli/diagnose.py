"""`ves-gym diagnose`: where logs and description disagree, and what is missing."""

from __future__ import annotations

import argparse
import difflib
import importlib.util
import shlex
import sys
from pathlib import Path
from typing import Any

from ves_gym.cli.common import out_dir, progress, write_json
from ves_gym.core.params import ParameterError, write_text
from ves_gym.core.runlog import RunLog
from ves_gym.core.system import System

SCHEMA = "ves-diagnose/1"
_SHOWN = 12  # channels in the table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "logs", metavar="LOG", nargs="+", help="run logs of one machine, or folders of them"
    )
    parser.add_argument(
        "--system", metavar="FILE", help="the machine as described (default: that of the logs)"
    )
    parser.add_argument(
        "--final",
        metavar="N",
        type=int,
        help="logs to hold back and open once, at the end: the last N (default: those that say"
        " `held_back`, else the last third)",
    )
    parser.add_argument(
        "--without",
        metavar="KIND",
        action="append",
        default=[],
        help="leave out of the library",
    )
    parser.add_argument(
        "--band", metavar="HZ", type=float, default=12.0, help="compare up to (default 12)"
    )
    parser.add_argument("--no-figures", action="store_true", help="skip the HTML report")


def run(args: argparse.Namespace) -> int:
    """Diagnose, print the verdict, write the better description and the report."""
    from ves_gym import __version__
    from ves_gym.discrepancy import diagnosis as d
    from ves_gym.discrepancy.candidates import library, without
    from ves_gym.discrepancy.runs import require_plausible, run_of
    from ves_gym.discrepancy.system_machine import SystemMachine

    paths = _paths(args.logs)
    logs = [RunLog.load(path) for path in paths]
    system = System.load(args.system) if args.system else _system_of(logs, paths)
    for log, path in zip(logs, paths, strict=True):
        require_plausible(log, system, path.name)
    machine = SystemMachine(system)
    fitted, final = _split(logs, args.final)
    runs = {i: run_of(logs[i], paths[i].name, args.band) for i in (*fitted, *final)}
    some = [runs[i] for i in fitted]
    candidates = library(
        system.arm.n, [p.name for p in machine.ports], system.mode, [r.name for r in some]
    )
    with progress() as tell:
        found = d.diagnose(
            machine,
            some,
            [runs[i] for i in final],
            candidates=without(candidates, args.without),
            progress=lambda done, what: tell("diagnose", done),
            seed=args.seed,
        )
    folder = out_dir(args, "out/diagnose")
    better = machine.model(d.added(found)).system
    better.save(folder / "system.toml")
    result = {
        "schema": SCHEMA,
        **d.plain(found),
        "logs": {p.name: log.digest for p, log in zip(paths, logs, strict=True)},
        "held_back": [paths[i].name for i in final],
        "machine": machine.name,
        "described": system.hash,
        "better": better.hash,
        "system": better.to_dict(),
        "seed": args.seed,
        "version": __version__,
        "command": shlex.join(["ves-gym", *sys.argv[1:]]),
    }
    _print(found, result)
    print(folder / "system.toml")
    write_json(args.json, result)
    write_json(str(folder / "diagnosis.json"), result)
    write_text(folder / "verdict.txt", found.sentence + "\n")
    if not args.no_figures:
        _report({**result, "diff": _diff(system, better)}, found, folder / "diagnosis.html")
    return 1 if found.verdict in (d.UNKNOWN, d.MORE, d.WEAK) else 0


def _paths(given: list[str]) -> list[Path]:
    out: list[Path] = []
    for text in given:
        path = Path(text)
        if path.is_dir():
            inside = sorted([*path.glob("*.parquet"), *path.glob("*.csv")])
            if not inside:
                raise ParameterError(f"{path}: no run log (.parquet, .csv) in this folder")
            out += inside
        else:
            out.append(path)
    names = [p.name for p in out]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ParameterError(f"{twice[0]} is given more than once")
    return out


def _system_of(logs: list[RunLog], paths: list[Path]) -> System:
    """The one system that all logs name."""
    systems = []
    for log, path in zip(logs, paths, strict=True):
        if "system" not in log.meta:
            raise ParameterError(f"{path}: names no system; give --system FILE")
        systems.append(System.from_dict(log.meta["system"], str(path)))
    for system, path in zip(systems, paths, strict=True):
        if system.hash != systems[0].hash:
            raise ParameterError(
                f"{path}: is of another system than {paths[0]} ({system.hash[:12]},"
                f" {systems[0].hash[:12]}): one machine at a time"
            )
    return systems[0]


def _split(logs: list[RunLog], final: int | None) -> tuple[list[int], list[int]]:
    """Logs to fit, and logs to hold back."""
    every = range(len(logs))
    if final is None:
        held = [i for i in every if logs[i].meta.get("held_back")]
        if not held:
            held = list(every)[len(logs) - len(logs) // 3 :]
    else:
        if not 0 <= final < len(logs):
            raise ParameterError(
                f"--final must leave a log to fit: 0 to {len(logs) - 1}, got {final}"
            )
        held = list(every)[len(logs) - final :]
    fitted = [i for i in every if i not in held]
    if not fitted:
        raise ParameterError("every log is held back: none is left to fit")
    return fitted, held


def _report(result: dict[str, Any], found: Any, path: Path) -> None:
    """Write the HTML report; a machine without the extra gets everything else."""
    if importlib.util.find_spec("matplotlib") is None:
        print("no HTML report: it needs matplotlib; pip install 'ves-gym[report]'")
        return
    from ves_gym.discrepancy.findings import overlays
    from ves_gym.report.diagnosis import write_page

    write_page({**result, "overlays": overlays(found.selection, found.evidence)}, path)
    print(path)


def _diff(system: System, better: System) -> str:
    """What changed in the description, as a unified diff of the TOML files."""
    import tomli_w

    old, new = (tomli_w.dumps(s.to_dict()).splitlines() for s in (system, better))
    lines = difflib.unified_diff(old, new, "described", "system.toml", n=2, lineterm="")
    return "\n".join(lines)


def _print(found: Any, result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from ves_gym.discrepancy.diagnosis import UNKNOWN

    console = Console(width=None if sys.stdout.isatty() else 110, markup=False)
    console.print(found.sentence, style="bold")
    if found.verdict == UNKNOWN and found.found:
        console.print("the best that the library can do, not a name:")
    for f in found.found:
        numbers = ", ".join(
            f"{name} = {value:.4g} +- {1.645 * std:.2g} {unit}"
            for name, value, std, unit in zip(
                f.candidate.names, f.values, f.std, f.candidate.units, strict=True
            )
        )
        console.print(f"  {f.candidate.name}: {numbers} (90 %), p = {f.probability:.2f}")
    gaps = found.final or found.gaps
    table = Table(
        title="gap in standard deviations of noise, "
        + (f"held back: {', '.join(result['held_back'])}" if found.final else "the runs fitted")
    )
    for name in ("port", "channel", "before", "after"):
        table.add_column(name, justify="left" if name in ("port", "channel") else "right")
    for gap in sorted(gaps, key=lambda g: -g.before)[:_SHOWN]:
        table.add_row(gap.port, gap.channel, f"{gap.before:.2f}", f"{gap.after:.2f}")
    console.print(table)
    for port, lacks in result["untestable"].items():
        console.print(f"not tested: {port}, the logs lack {', '.join(lacks)}", style="dim")
