"""`ves-gym diagnose`: where logs and description disagree, and what is missing."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ves_gym._util.optional import lacking
from ves_gym._util.params import ParameterError, from_plain, read_table, write_text
from ves_gym.cli.common import (
    add_arm_argument,
    add_effect_argument,
    out_dir,
    parse_effect,
    progress,
    write_json,
)
from ves_gym.mechanics.arm_library import get_arm
from ves_gym.system.system_library import get_system

if TYPE_CHECKING:
    from ves_gym.diagnosis.data.measured_run import Run
    from ves_gym.diagnosis.diagnose import Diagnosis
    from ves_gym.diagnosis.inputs import DiagnosisInputs

SCHEMA = "ves-diagnose/1"
_SHOWN = 12  # channels in the table
_SEEN = 0.005  # probability from which a hypothesis is printed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "logs",
        metavar="LOG",
        nargs="+",
        help="run logs of one machine, or folders of them; with --machine data files (.mat,"
        " .csv), or folders of .csv files that belong together",
    )
    parser.add_argument(
        "--system", metavar="FILE", help="the machine as described (default: that of the logs)"
    )
    add_arm_argument(parser, "that of the system or the logs")
    add_effect_argument(parser)
    parser.add_argument(
        "--machine",
        metavar="FILE",
        help="a machine in MJCF: mapping file that says which columns of the data are what",
    )
    parser.add_argument(
        "--describe",
        action="store_true",
        help="write a commented mapping file for one's own data (mapping.toml in --out):"
        " columns guessed by name, unit and range, and what is missing",
    )
    parser.add_argument(
        "--tolerances",
        metavar="FILE",
        help="sizes of tolerances and noise of a System, where they are not the usual ones",
    )
    parser.add_argument(
        "--model", metavar="FILE", help="with --describe: the robot in URDF or MJCF"
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
        "--band", metavar="HZ", type=float, help="compare up to (default 12, or the mapping's)"
    )
    parser.add_argument(
        "--most",
        metavar="N",
        type=int,
        help="effects to name at most (default: as many as the evidence bears)",
    )
    parser.add_argument(
        "--no-free-run", action="store_true", help="skip the simulation of the whole loop"
    )
    parser.add_argument(
        "--as-logged",
        action="store_true",
        help="ask no questions about units, signs and exchanged channels",
    )
    parser.add_argument(
        "--no-experiment",
        action="store_true",
        help="design no motion that decides between rivals, or shows what was too weak",
    )
    parser.add_argument("--no-figures", action="store_true", help="skip the HTML report")


def run(args: argparse.Namespace) -> int:
    """Diagnose, print the verdict, write the better description and the report."""
    from ves_gym._util.version import __version__
    from ves_gym.diagnosis import diagnose as d
    from ves_gym.diagnosis.data.sanity_checks import require_as_logged, suspected_mistake
    from ves_gym.diagnosis.inference.cache import AnswerCache
    from ves_gym.diagnosis.inference.model_selection import Thresholds

    if args.describe:
        return _describe(args)
    if args.model is not None:
        raise ParameterError("--model goes with --describe; else the mapping file names it")
    inputs = _inputs(args)
    if args.most is not None and args.most < 1:
        raise ParameterError(f"--most must be 1 and more, got {args.most}")
    if not args.as_logged:
        require_as_logged(inputs.machine, inputs.runs, inputs.mistakes)
    folder = out_dir(args, "out/diagnose")
    cache = AnswerCache(folder, [inputs.described, inputs.digests])
    if cache.n_restored:
        print(f"going on: {cache.n_restored} answers are known from before", file=sys.stderr)
    try:
        with progress() as on_progress:
            diagnosis = d.diagnose(
                inputs.machine,
                inputs.runs,
                inputs.final,
                candidates=inputs.candidates,
                limits=Thresholds(most=args.most),
                progress=lambda done, what: on_progress("diagnose", done),
                seed=args.seed,
                cache=cache,
            )
    except KeyboardInterrupt:
        print("ves-gym: what is done is kept: run the command again", file=sys.stderr)
        raise
    late = () if args.as_logged else inputs.final
    doubts = [suspected_mistake(inputs.machine, run, inputs.mistakes) for run in late]
    written = inputs.write(d.added(diagnosis), folder, not args.no_free_run)
    designed = None if args.no_experiment else _next_motion(args, diagnosis, folder)
    result = {
        "schema": SCHEMA,
        **d.plain(diagnosis),
        "next_motion": designed,
        "logs": inputs.digests,
        "held_back": [run.name for run in inputs.final],
        "machine": inputs.machine.name,
        "described": inputs.described,
        "better": written.digest,
        **written.plain,
        "files": [path.name for path in written.files],
        "notes": [*inputs.notes, *written.notes],
        "doubts": [question.sentence for question in doubts if question is not None],
        "replay_difference": written.difference,
        "free": written.free,
        "seed": args.seed,
        "version": __version__,
        "command": shlex.join(["ves-gym", *sys.argv[1:]]),
    }
    write_json(args.json, result)
    write_json(str(folder / "diagnosis.json"), result)
    write_text(folder / "verdict.txt", diagnosis.sentence + "\n")
    paths = [*written.files, *map(Path, designed["files"] if designed else ())]
    if not args.no_figures:
        paths += _report({**result, "diff": written.diff}, diagnosis, folder / "diagnosis.html")
    cache.done()
    _print(diagnosis, result)
    for path in paths:
        print(path)
    return 1 if diagnosis.verdict in (d.UNKNOWN, d.MORE, d.WEAK) else 0


def _next_motion(
    args: argparse.Namespace, diagnosis: Diagnosis, folder: Path
) -> dict[str, Any] | None:
    """Design the motion that decides what is open, and write it to be run."""
    from ves_gym.diagnosis.machines.system import SystemMachine
    from ves_gym.diagnosis.next_motion import next_motion

    if not isinstance(diagnosis.residuals.machine, SystemMachine):
        return None
    try:
        with progress() as on_progress:
            designed = next_motion(
                diagnosis,
                seed=args.seed,
                progress=lambda done: on_progress("next experiment", done),
            )
    except ParameterError as error:  # the verdict stands without
        print(f"no experiment designed: {error}")
        return None
    if designed is None:
        return None
    motion, table = folder / "experiment.toml", folder / "experiment.csv"
    designed.motion.save(motion)
    write_text(table, designed.table(diagnosis.residuals.machine.system.control_dt))
    log = folder / "experiment.parquet"
    return {
        **designed.to_dict(),
        "files": [str(motion), str(table)],
        "simulate": shlex.join(
            [
                *(
                    "ves-gym",
                    "simulate",
                    "--system",
                    args.system or str(folder / "system.toml"),
                ),
                *("--motion", str(motion), "--settle", "0", "--log", str(log)),
                *_gains(diagnosis.residuals.runs[0]),
            ]
        ),
        "diagnose": shlex.join(["ves-gym", "diagnose", str(log), *args.logs]),
    }


def _gains(run: Run) -> list[str]:
    """Options of `ves-gym simulate` for the controller that a log names."""
    if "controller" not in run:
        return []
    gains = run.meta["controller"]
    text = "/".join(",".join(f"{x:.12g}" for x in gains[k]) for k in ("kp", "kd"))
    return ["--gains", text] + ([] if gains.get("feedforward", False) else ["--no-feedforward"])


def _describe(args: argparse.Namespace) -> int:
    """Write a mapping file to be corrected."""
    from ves_gym._util.recordings import read_columns
    from ves_gym.diagnosis.data.describe import describe

    if len(args.logs) != 1 or args.machine or args.system:
        raise ParameterError("--describe takes one data file or folder, and no description")
    folder = out_dir(args, "out/diagnose")
    path = folder / "mapping.toml"
    if path.exists():
        raise ParameterError(f"{path} is there already: take another --out, or remove it")
    if args.model is not None:
        near = Path(os.path.relpath(Path(args.model).resolve(), folder.resolve()))
        text = describe(read_columns(args.logs[0]), args.logs[0], Path(args.model), near)
    else:
        text = describe(read_columns(args.logs[0]), args.logs[0])
    write_text(path, text)
    for row in text.splitlines():
        if row.startswith("#   - "):
            print(f"missing: {row[6:]}")
    print(path)
    return 0


def _inputs(args: argparse.Namespace) -> DiagnosisInputs:
    from ves_gym.diagnosis.inputs import mjcf_inputs, system_inputs
    from ves_gym.diagnosis.machines.tolerances import StatedErrors

    how: dict[str, Any] = {"final": args.final, "leave_out": args.without, "band": args.band}
    effects = [parse_effect(text) for text in args.effect]
    if args.machine is None:
        system = get_system(args.system) if args.system else None
        arm = None if args.arm is None else get_arm(args.arm)
        stated = None
        if args.tolerances is not None:
            stated = from_plain(StatedErrors, read_table(args.tolerances), args.tolerances)
        return system_inputs(args.logs, system, arm=arm, effects=effects, stated=stated, **how)
    if args.tolerances is not None:
        raise ParameterError("--tolerances is of a System; a mapping file has its own")
    if effects:
        raise ParameterError(
            f"--effect {effects[0].kind} belongs to a described System: leave it out, or"
            " --machine"
        )
    for name in ("system", "arm"):
        if getattr(args, name) is not None:
            raise ParameterError(
                f"--{name} and --machine describe two machines: give one of them"
            )
    return mjcf_inputs(args.logs, args.machine, **how)


def _report(result: dict[str, Any], diagnosis: Any, path: Path) -> list[Path]:
    """Write the HTML report; a machine without the extra gets everything else."""
    if sentence := lacking("its figures", "matplotlib"):
        print(f"no HTML report: {sentence}")
        return []
    from ves_gym.report.diagnosis import write_page
    from ves_gym.report.diagnosis_overlays import overlays

    write_page({**result, "overlays": overlays(diagnosis.selection, diagnosis.residuals)}, path)
    return [path]


def _print(diagnosis: Any, result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    from ves_gym.diagnosis.diagnose import ONE_OF, UNKNOWN, WIDE

    console = Console(width=None if sys.stdout.isatty() else 110, markup=False)
    console.print(diagnosis.sentence, style="bold")
    console.print(result["null"]["sentence"])
    shown = [f"{k} {p:.2f}" for k, p in result["hypotheses"].items() if p >= _SEEN]
    console.print(f"Probabilities: {', '.join(shown)}.")
    for experiment in result["experiments"] if diagnosis.verdict == ONE_OF else ():
        console.print(f"next experiment: {experiment['sentence']}")
    if designed := result["next_motion"]:
        console.print(f"designed: {designed['sentence']}")
        console.print(f"  the motion, at every control period: {designed['files'][1]}")
        console.print(f"  in simulation: {designed['simulate']}", soft_wrap=True)
        console.print(f"  afterwards: {designed['diagnose']}", soft_wrap=True)
    if diagnosis.verdict == UNKNOWN and diagnosis.explanations:
        console.print("the best that the library can do, not a name:")
    for f in diagnosis.explanations:
        numbers = ", ".join(
            f"{name} = {value:.4g} +- {WIDE * std:.2g} {unit}"
            for name, value, std, unit in zip(
                f.candidate.names, f.values, f.std, f.candidate.units, strict=True
            )
        )
        console.print(f"  {f.candidate.name}: {numbers} (90 %), p = {f.probability:.2f}")
    for f in diagnosis.withheld:
        console.print(
            f"  withheld: {f.candidate.name}; of names with such evidence"
            f" {100 * f.reliability:.0f} % are right"
        )
    gaps = diagnosis.final or diagnosis.gaps
    table = Table(
        title="gap in standard deviations of noise, "
        + (
            f"held back: {', '.join(result['held_back'])}"
            if diagnosis.final
            else "the runs fitted"
        )
    )
    for name in ("port", "channel", "before", "95 %", "after", "95 %"):
        table.add_column(name, justify="left" if name in ("port", "channel") else "right")
    for gap in sorted(gaps, key=lambda g: -g.before)[:_SHOWN]:
        sure = [f"{a:.2f} to {b:.2f}" for a, b in (gap.before_interval, gap.after_interval)]
        table.add_row(
            gap.port, gap.channel, f"{gap.before:.2f}", sure[0], f"{gap.after:.2f}", sure[1]
        )
    console.print(table)
    if result["worse"]:
        console.print(f"worse by more than 2 %: {', '.join(result['worse'])}")
    for question in result["doubts"]:
        console.print(f"held back, so opened last: {question}")
    for note in result["notes"]:
        console.print(note, style="dim")
    for port, lacks in result["untestable"].items():
        console.print(f"not tested: {port}, the logs lack {', '.join(lacks)}", style="dim")
