"""Inputs of `ves-gym diagnose`: runs of one machine, its description and library, and how its
better description is written. For run logs of a `System` and for data of any machine in MJCF.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.diagnosis.data.drive_gains import with_drive_gains
from ves_gym.diagnosis.data.measured_run import BAND, Run, run_of
from ves_gym.diagnosis.data.sanity_checks import require_plausible
from ves_gym.diagnosis.inference.cache import digest_of
from ves_gym.diagnosis.inference.candidates import Candidate, library, without
from ves_gym.diagnosis.machines.base import Machine
from ves_gym.diagnosis.machines.clocks import with_jitter
from ves_gym.diagnosis.machines.mapping import read_machine
from ves_gym.diagnosis.machines.mjcf import MjcfMachine
from ves_gym.diagnosis.machines.residual import ResidualMachine
from ves_gym.diagnosis.machines.system import SystemMachine
from ves_gym.diagnosis.machines.tolerances import StatedErrors
from ves_gym.diagnosis.output.common import DescriptionFiles
from ves_gym.diagnosis.output.mapping_file import write_parameters
from ves_gym.diagnosis.output.mjcf_file import described, write_machine
from ves_gym.diagnosis.output.system_file import write_system
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.link import Inertial
from ves_gym.system.effect import Effect
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

_MASSES = (  # masses described, or all forces logged: no log tells which; the masses' factor
    (
        "are masses and inertias described in g, not kg, or torques logged in kN m, not N m",
        1e-3,
    ),
    ("are masses and inertias described in t, not kg, or torques logged in N mm, not N m", 1e3),
)


@dataclass(frozen=True, eq=False)
class DiagnosisInputs:
    """Runs of one machine, those held back beside them, and its library of candidates."""

    machine: Machine
    runs: tuple[Run, ...]
    final: tuple[Run, ...]
    candidates: tuple[Candidate, ...]
    digests: dict[str, str]  # of the logs, SHA-256
    described: str  # SHA-256 of the description
    write: Callable[
        [Sequence[Any], Path, bool], DescriptionFiles
    ]  # effects, folder, free runs too
    mistakes: tuple[tuple[str, Machine], ...] = ()  # usual ones in a description
    notes: tuple[str, ...] = ()  # what was done to the data before


Source = RunLog | str | os.PathLike[str]  # a log, its file, or a folder of files


def system_inputs(
    sources: Sequence[Source],
    system: System | None = None,
    *,
    arm: Arm | None = None,
    effects: Sequence[Effect] = (),
    final: int | None = None,
    leave_out: Sequence[str] = (),
    band: float | None = None,
    stated: StatedErrors | None = None,
) -> DiagnosisInputs:
    """Read run logs of a system, and folders of them.

    Args:
        sources: logs, their files, or folders of those.
        system: the machine as described; without one, what the logs name.
        arm: the arm as described, in place of the system's.
        effects: that are described beside those of the system.
        final: how many of the last logs to hold back; without a number those that say
            `held_back`, else the last third.
        leave_out: kinds of effects.
        band: compare up to [Hz].
        stated: tolerances and noise, where they are not the usual ones.

    Raises:
        ParameterError: logs that cannot be of one machine as it stands.
    """
    paths, logs = _logs(sources)
    _require_one_system(logs, paths)
    described = system or _system_of(logs, paths)
    if arm is not None:
        described = described.replace(arm=arm)
    if effects:
        described = described.replace(effects=(*described.effects, *effects))
    machine = SystemMachine(described, stated)
    _ = machine.nuisances  # a name that no tolerance has is refused before logs are looked at
    for log, path in zip(logs, paths, strict=True):
        require_plausible(log, machine.system, path.name)
    marked = [i for i, log in enumerate(logs) if log.meta.get("held_back")]
    fitted, held_back = _split(len(logs), marked, final)
    jitter = stated.clocks.jitter if stated else 0.0
    runs = [
        with_jitter(
            run_of(_with_noise(log, stated), path.name, BAND if band is None else band),
            jitter,
            machine.system.mode == "emulated",
        )
        for log, path in zip(logs, paths, strict=True)
    ]
    nominal, ports = machine.system, [p.name for p in machine.ports]
    fitted_runs, final_runs = ([runs[i] for i in k] for k in (fitted, held_back))
    candidates = library(
        nominal.arm.n,
        ports,
        nominal.mode,
        [r.name for r in fitted_runs],
        machine.stretch(fitted_runs),
        nominal,
        machine.travel(fitted_runs),
    )

    def write(effects: Sequence[Any], folder: Path, free: bool) -> DescriptionFiles:
        better = machine.model(effects).system
        return write_system(nominal, better, folder, fitted_runs, final_runs, free)

    return DiagnosisInputs(
        machine=machine,
        runs=tuple(fitted_runs),
        final=tuple(final_runs),
        candidates=tuple(without(candidates, leave_out)),
        digests={p.name: log.digest for p, log in zip(paths, logs, strict=True)},
        described=nominal.hash,
        write=write,
        mistakes=tuple(
            (text, SystemMachine(nominal.replace(arm=_heavier(nominal.arm, factor))))
            for text, factor in _MASSES
        ),
    )


def mjcf_inputs(
    sources: Sequence[str],
    mapping: str,
    *,
    final: int | None = None,
    leave_out: Sequence[str] = (),
    band: float | None = None,
) -> DiagnosisInputs:
    """Data of a machine with a mapping file: each a file, or a folder whose files belong
    together.

    Raises:
        ParameterError: as the mapping file's `read_machine`.
    """
    machine, load = read_machine(mapping, band)
    paths = [Path(text) for text in sources]
    _require_distinct(paths)
    logged = [load(path) for path in paths]
    inputs = machine_inputs(machine, logged, final=final, leave_out=leave_out)
    runs = (*inputs.runs, *inputs.final)

    def write(effects: Sequence[Any], folder: Path, free: bool) -> DescriptionFiles:
        writer = write_parameters if isinstance(machine, ResidualMachine) else write_machine
        return writer(Path(mapping), machine, effects, folder, runs)

    notes = (*(note for run in runs for note in run.meta.get("notes", ())), *inputs.notes)
    return replace(inputs, described=described(Path(mapping)), write=write, notes=notes)


def _logs(sources: Sequence[Source]) -> tuple[list[Path], list[RunLog]]:
    """Names and logs; a log that is no file is called by its number."""
    paths: list[Path] = []
    in_memory: dict[Path, RunLog] = {}
    for source in sources:
        if isinstance(source, RunLog):
            paths.append(Path(f"log {len(paths) + 1}"))
            in_memory[paths[-1]] = source
            continue
        path = Path(source)
        if path.is_dir():
            inside = sorted([*path.glob("*.parquet"), *path.glob("*.csv")])
            if not inside:
                raise ParameterError(f"{path}: no run log (.parquet, .csv) in this folder")
            paths += inside
        else:
            paths.append(path)
    _require_distinct(paths)
    logs = [in_memory[p] if p in in_memory else RunLog.load(p) for p in paths]
    seen: dict[str, Path] = {}
    for path, log in zip(paths, logs, strict=True):
        if seen.setdefault(log.digest, path) != path:
            raise ParameterError(f"{path}: is {seen[log.digest]} again; is it another run's?")
    return paths, logs


def machine_inputs(
    machine: Machine,
    runs: Sequence[Run],
    *,
    final: int | None = None,
    leave_out: Sequence[str] = (),
) -> DiagnosisInputs:
    """Take runs of a machine that says itself which `candidates()` it has.

    The last `final` are held back, default the last third.

    Raises:
        ParameterError: no candidates, or no run is left to fit.
    """
    offered = getattr(machine, "candidates", None)
    if offered is None:
        raise ParameterError(f"{machine.name} has no candidates()")
    fitted, held_back = _split(len(runs), (), final)
    notes: list[str] = []
    mistakes: tuple[tuple[str, Machine], ...] = ()
    if isinstance(machine, MjcfMachine):
        runs, notes = with_drive_gains(machine, runs, fitted)
        mistakes = tuple((text, machine.heavier(factor)) for text, factor in _MASSES)
    return DiagnosisInputs(
        machine=machine,
        runs=tuple(runs[i] for i in fitted),
        final=tuple(runs[i] for i in held_back),
        candidates=tuple(without(offered(), leave_out)),
        notes=tuple(notes),
        mistakes=mistakes,
        digests={run.name: digest_of(run) for run in runs},
        described=machine.name,
        write=_unwritten,
    )


def _with_noise(log: RunLog, stated: StatedErrors | None) -> RunLog:
    """The log with the noise that is stated in place of its own."""
    if stated is None or not stated.noise:
        return log
    noise = {**log.meta.get("noise_std", {}), **stated.noise}
    return replace(log, meta={**log.meta, "noise_std": noise})


def _unwritten(effects: Sequence[Any], folder: Path, free: bool) -> DescriptionFiles:
    raise ParameterError("a machine that was read from no file has no description to write")


def _require_distinct(paths: Sequence[Path]) -> None:
    names = [p.name for p in paths]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ParameterError(f"{twice[0]} is given more than once")


def _system_of(logs: Sequence[RunLog], paths: Sequence[Path]) -> System:
    """Return the one system that all logs name."""
    for log, path in zip(logs, paths, strict=True):
        if "system" not in log.meta:
            raise ParameterError(f"{path}: names no system; give --system FILE")
    return System.from_dict(logs[0].meta["system"], str(paths[0]))


def _require_one_system(logs: Sequence[RunLog], paths: Sequence[Path]) -> None:
    """Refuse logs that name different systems, whatever they are to be compared with."""
    named = [
        (path, System.from_dict(log.meta["system"], str(path)).hash)
        for log, path in zip(logs, paths, strict=True)
        if "system" in log.meta
    ]
    for path, digest in named:
        if digest != named[0][1]:
            raise ParameterError(
                f"{path}: is of another system than {named[0][0]} ({digest[:12]},"
                f" {named[0][1][:12]}): one machine at a time"
            )


def _heavier(arm: Arm, factor: float) -> Arm:
    """The arm with all masses and inertias by a factor."""

    def scaled(body: Inertial) -> Inertial:
        moments = tuple(tuple(factor * x for x in row) for row in body.inertia)
        return replace(body, mass=factor * body.mass, inertia=moments)

    links = tuple(replace(link, inertial=scaled(link.inertial)) for link in arm.links)
    return replace(arm, links=links, base=scaled(arm.base))


def _split(count: int, marked: Sequence[int], final: int | None) -> tuple[list[int], list[int]]:
    """Return indices of the runs to fit and of those to hold back."""
    every = list(range(count))
    if final is None:
        held_back = list(marked) or every[count - count // 3 :]
    else:
        if not 0 <= final < count:
            raise ParameterError(
                f"--final must leave a log to fit: 0 to {count - 1}, got {final}"
            )
        held_back = every[count - final :]
    fitted = [i for i in every if i not in held_back]
    if not fitted:
        raise ParameterError("every log is held back: none is left to fit")
    return fitted, held_back
