"""`ves-gym diagnose`: where logs and description disagree, and what is missing."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ves_gym._util.optional import lacking
from ves_gym._util.params import (
    ParameterError,
    from_plain,
    read_table,
    write_result,
    write_text,
)
from ves_gym.cli.flags import (
    Answer,
    Context,
    Flag,
    integer,
    log_file,
    names,
    number,
    path,
    read,
    say,
    text,
)
from ves_gym.cli.machine import EFFECT, arm_flags
from ves_gym.planners.case import Case
from ves_gym.system.system import System
from ves_gym.system.system_library import get_system

if TYPE_CHECKING:
    from ves_gym.diagnosis.diagnose import Diagnosis
    from ves_gym.diagnosis.inputs import DiagnosisInputs


def _inputs(
    log: Sequence[str], mapping: str | None, machine: dict[str, Any], **how: Any
) -> DiagnosisInputs:
    """Runs, machine and library, of a System or of a mapping file."""
    from ves_gym.diagnosis.inputs import mjcf_inputs, system_inputs
    from ves_gym.diagnosis.machines.tolerances import StatedErrors

    file = machine.pop("tolerances", None)
    if mapping is None:
        stated = None if file is None else from_plain(StatedErrors, read_table(file), file)
        effects = machine.pop("effect", ())
        tables = [Path(k) for k in log if k.endswith(".csv") and Path(k).exists()]
        foreign = [k for k in tables if not k.with_suffix(".json").exists()]
        if foreign:
            raise ParameterError(
                f"{foreign[0]}: no run log, for there is no .json with its metadata beside it;"
                " data of your own need a mapping file: ves-gym diagnose --describe FILE writes"
                " one, --machine takes it"
            )
        return system_inputs(log, **machine, effects=effects, stated=stated, **how)
    if file is not None:
        raise ParameterError("--tolerances is of a System; a mapping file has its own")
    for effect in machine.pop("effect", ()):
        raise ParameterError(
            f"--effect {effect.kind} belongs to a described System: leave it out, or --machine"
        )
    for option in machine:
        raise ParameterError(
            f"--{option} and --machine describe two machines: give one of them"
        )
    return mjcf_inputs(log, mapping, **how)


def diagnose(
    at: Context,
    log: tuple[str, ...],
    *,
    mapping: str | None = None,
    describe: bool = False,
    model: Path | None = None,
    columns: Sequence[str] = (),
    topic: str = "",
    final: int | None = None,
    without: tuple[str, ...] = (),
    band: float | None = None,
    most: int | None = None,
    no_free_run: bool = False,
    as_logged: bool = False,
    no_experiment: bool = False,
    **machine: Any,
) -> Answer:
    """Diagnose; the verdict, the better description and the report."""
    from ves_gym._util.version import __version__
    from ves_gym.diagnosis import diagnose as d
    from ves_gym.diagnosis.data.sanity_checks import require_as_logged, suspected_mistake
    from ves_gym.diagnosis.inference.cache import AnswerCache
    from ves_gym.report.diagnosis import diagnosis_text, write_page
    from ves_gym.report.diagnosis_figures import overlays

    folder, system = at.folder("out/diagnose"), machine.get("system")
    if describe:
        if len(log) != 1:
            raise ParameterError(
                f"--describe takes one data file or folder, got {len(log)}: describe one of"
                " them, its mapping file serves all"
            )
        if mapping or system:
            raise ParameterError(
                "--describe writes a description: leave out --machine, --system"
            )
        return _describe(log[0], model, folder, columns, topic)
    if model is not None or columns or topic:
        option = "--model" if model is not None else "--columns" if columns else "--topic"
        raise ParameterError(f"{option} goes with --describe; else the mapping file names it")
    inputs = _inputs(log, mapping, machine, final=final, leave_out=without, band=band)
    if not as_logged:
        require_as_logged(inputs.machine, inputs.runs, inputs.mistakes)
    folder.mkdir(parents=True, exist_ok=True)
    cache = AnswerCache(folder, [inputs.described, inputs.digests])
    if cache.n_restored:
        say(f"going on: {cache.n_restored} answers are known from before")
    try:
        diagnosis = d.diagnose(
            inputs.machine, inputs.runs, inputs.final, candidates=inputs.candidates,
            most=most, progress=at.progress, seed=at.seed, cache=cache,
        )  # fmt: skip
    except KeyboardInterrupt:
        say("what is done is kept: run the command again")
        raise
    late = () if as_logged else inputs.final
    doubts = [suspected_mistake(inputs.machine, run, inputs.mistakes) for run in late]
    written = inputs.write(diagnosis.effects, folder, not no_free_run)
    designed = None
    if not no_experiment:
        designed = _next_motion(at, diagnosis, system, log, folder)
    result = {
        "schema": "ves-diagnose/1",
        **diagnosis.to_dict(),
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
        "seed": at.seed,
        "version": __version__,
        "command": shlex.join(["ves-gym", *sys.argv[1:]]),
    }
    write_result(folder / "diagnosis.json", result)
    write_text(folder / "verdict.txt", diagnosis.sentence + "\n")
    lines = [diagnosis_text(diagnosis, result), *map(str, written.files)]
    lines += designed["files"] if designed else ()
    if at.pictures and (sentence := lacking("its figures", "matplotlib")):
        lines.append(f"no HTML report: {sentence}")
    elif at.pictures:
        drawn = overlays(diagnosis.selection, diagnosis.residuals)
        page = folder / "diagnosis.html"
        write_page({**result, "diff": written.diff, "overlays": drawn}, page)
        lines.append(str(page))
    cache.done()
    return Answer(
        text="\n".join(lines),
        plain=result,
        negative=diagnosis.verdict in (d.UNKNOWN, d.MORE, d.WEAK),
    )


def _next_motion(
    at: Context, diagnosis: Diagnosis, system: System | None, logs: Sequence[str], folder: Path
) -> dict[str, Any] | None:
    """Design the motion that decides what is open, and write the case of it."""
    from ves_gym.diagnosis.machines.system import SystemMachine
    from ves_gym.diagnosis.next_motion import next_motion

    if not isinstance(diagnosis.residuals.machine, SystemMachine):
        return None
    try:
        designed = next_motion(
            diagnosis, seed=at.seed, progress=lambda done: at.progress("next experiment", done)
        )
    except ParameterError as error:  # the verdict stands without
        say(f"no experiment designed: {error}")
        return None
    if designed is None:
        return None
    file, table = folder / "experiment.case.toml", folder / "experiment.csv"
    log = str(folder / "experiment.parquet")
    case = Case(
        system=system or diagnosis.system, motion=designed.motion, seed=at.seed, log=log
    )
    run = diagnosis.residuals.runs[0]
    if run.servo is not None:
        case = replace(case, servo=run.servo)
    case.save(file)
    write_text(table, designed.table(diagnosis.residuals.machine.system.control_dt))
    words = ["ves-gym", "simulate", "--case", str(file), "--settle", "0"]
    return {
        **designed.to_dict(),
        "files": [str(file), str(table)],
        "simulate": shlex.join(words),
        "diagnose": shlex.join(["ves-gym", "diagnose", log, *logs]),
    }


def _describe(
    data: str, model: Path | None, folder: Path, called: Sequence[str], topic: str
) -> Answer:
    """Write a mapping file to be corrected."""
    from ves_gym._util.recordings import read_recording
    from ves_gym.diagnosis.data.describe import describe

    file = folder / "mapping.toml"
    if file.exists():
        raise ParameterError(f"{file} is there already: take another --out, or remove it")
    near = None
    if model is not None:
        near = Path(os.path.relpath(model.resolve(), folder.resolve()))
    recording = read_recording(data, f"{topic}:t" if topic else "")
    text = describe(recording, data, model, near, called)
    write_text(file, text)
    sections = {"#   - ": "missing", "#   * ": "understood"}
    lines = [f"{sections[k[:6]]}: {k[6:]}" for k in text.splitlines() if k[:6] in sections]
    then: list[list[str | Path]] = [["diagnose", data, "--machine", file]]
    return Answer(text="\n".join([*lines, str(file)]), then=then)


TABLE = {
    "diagnose": (diagnose, (
        Flag("LOG", "", lambda name, place: str(log_file(name, place)), many=True,
             help="run logs of one machine, cases that name one, or folders of logs; with"
             " --machine data files (.mat, .csv, .mcap, ...), or folders of one run (.csv,"
             " rosbag2)"),
        Flag("--system", "FILE", read(get_system),
             "the machine as described (default: that of the logs)"),
        *arm_flags("that of the system or the logs"),
        EFFECT,
        Flag("--machine", "FILE", text,
             "mapping file of a machine in MJCF or URDF, or of your own machine: the meaning"
             " of every column of the data",
             to="mapping"),
        Flag("--describe",
             help="write a commented mapping file for your data (mapping.toml in --out):"
             " columns guessed by name, unit and range, and what is missing"),
        Flag("--tolerances", "FILE", text,
             "sizes of tolerances and noise of a System, where they are not the usual ones"),
        Flag("--model", "FILE", path, "with --describe: the robot in URDF or MJCF"),
        Flag("--columns", "NAMES", names, "with --describe: names of the columns, in order,"
             " like t,q_1,v_1,tau_1, where the file has none"),
        Flag("--topic", "NAME", text, "with --describe: topic of a ROS log, where several"
             " have the same joints"),
        Flag("--final", "N", integer(),
             "logs to hold back and open once, at the end: the last N (default: those that say"
             " `held_back`, else the last third)"),
        Flag("--without", "KIND", text, "kind of effect to leave out", many=True),
        Flag("--band", "HZ", number("Hz"), "compare up to (default 12, or the mapping's)"),
        Flag("--most", "N", integer(1),
             "largest number of effects to name (default: as many as the evidence supports)"),
        Flag("--no-free-run", help="skip the simulation of the whole loop"),
        Flag("--as-logged", help="ask no questions about units, signs and exchanged channels"),
        Flag("--no-experiment",
             help="design no motion that decides between rivals, or shows what was too weak"),
        Flag("--no-figures", help="skip the HTML report"),
    )),
}  # fmt: skip
