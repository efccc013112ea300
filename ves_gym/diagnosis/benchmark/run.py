"""The blind benchmark's run: make cases, seal their labels, diagnose, one file per case.

    folder/logs/case-NNN/run-K.parquet   what the diagnosis sees
    folder/labels/case-NNN.json          what is really there; with nonce.json, of the seal
    folder/seal.json                     digest of the labels, written before any diagnosis
    folder/answers/case-NNN.json         what the diagnosis says

What is finished is not done again.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    canonical_json,
    content_hash,
    read_table,
    write_text,
)
from ves_gym._util.process_pool import Workers
from ves_gym._util.suggest import did_you_mean
from ves_gym.diagnosis.diagnose import Diagnosis, diagnose
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.model_selection import Thresholds
from ves_gym.diagnosis.inputs import system_inputs

FAILED = "failed"
QUICK = 30
_SCORED = ("index", "thresholds", "verdict", "why", "effects", "final", "baselines")
SETS = ("development", "sealed")
_GOLDEN = (math.sqrt(5) - 1) / 2

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class BenchmarkRun:
    """Some cases of a set, and the folder where they live."""

    folder: Path
    root: int  # the set's seed
    sealed: bool
    cases: tuple[int, ...]
    answers: str = "answers"  # folder in it, of one version of the method

    @property
    def labels(self) -> Path:
        """Folder of the truth."""
        return self.folder / "labels"

    def answer_file(self, index: int) -> Path:
        """File of a case's answer."""
        return self.folder / self.answers / f"case-{index:03d}.json"


def benchmark_run(
    folder: Path, which: str, salt: Path | None = None, cases: Sequence[int] | int | None = None
) -> BenchmarkRun:
    """Return a run of the benchmark on a set.

    Args:
        folder: of logs, labels and answers.
        which: "development" or "sealed".
        salt: file with the sealed set's secret.
        cases: indices, or how many in the proportions of the whole; None for all.

    Raises:
        ParameterError: a sealed set without its salt, a case that there is not.
    """
    from ves_gym.diagnosis.benchmark.blind.cases import mix, root_seed

    if which not in SETS:
        raise ParameterError(
            f"set must be one of {', '.join(SETS)}, got {which!r}{did_you_mean(which, SETS)}"
        )
    sealed = which == "sealed"
    if sealed and salt is None:
        raise ParameterError("the sealed set needs a salt: give the file that holds it")
    if not sealed and salt is not None:
        raise ParameterError("the development set is public and takes no salt")
    try:
        secret = "" if salt is None else salt.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{salt}: cannot be read: {error}") from None
    root = root_seed(which, secret)
    total = len(mix())
    if isinstance(cases, int):
        chosen: Sequence[int] = stratified(cases, root)
    else:
        chosen = range(total) if cases is None else cases
    wrong = [i for i in chosen if not 0 <= i < total]
    if wrong or not chosen:
        raise ParameterError(
            f"cases must be of 0 to {total - 1}, got {wrong[0] if wrong else 'none'}"
        )
    return BenchmarkRun(folder, root, sealed, tuple(sorted(set(chosen))))


def stratified(count: int, root: int) -> list[int]:
    """Return indices of cases in the proportions of the whole set, the same every time.

    Args:
        count: of cases.
        root: seed of the set.

    Raises:
        ParameterError: a count that the set does not have.
    """
    from ves_gym.diagnosis.benchmark.blind.cases import mix, order_of

    plans = mix()
    if not 1 <= count <= len(plans):
        raise ParameterError(f"cases must be 1 to {len(plans)} in number, got {count}")
    places: dict[str, list[int]] = {}
    for k, plan in enumerate(plans):
        places.setdefault(plan.category, []).append(k)
    exact = {name: count * len(members) / len(plans) for name, members in places.items()}
    share = {name: int(x) for name, x in exact.items()}
    by_rest = sorted(exact, key=lambda name: share[name] - exact[name])
    for name in by_rest[: count - sum(share.values())]:
        share[name] += 1
    chosen = set()
    for name, members in places.items():
        step = len(members) / max(share[name], 1)  # one of every stretch, not at a fixed beat
        chosen |= {members[int((i + (i * _GOLDEN) % 1.0) * step)] for i in range(share[name])}
    return [i for i, k in enumerate(order_of(root)) if k in chosen]


# ----------------------------------------------------------------------------- running


def run_benchmark(
    benchmark: BenchmarkRun, workers: int = 1, progress: Progress = lambda what, done: None
) -> None:
    """Make the cases missing, seal them, diagnose those without an answer.

    Args:
        benchmark: cases and folder.
        workers: processes.
        progress: called with the stage and the fraction done.

    Raises:
        ParameterError: answers or a seal in the folder are of another benchmark.
        ChildProcessError: a worker was killed.
    """
    mark = thresholds_hash(Thresholds())
    todo = [i for i in benchmark.cases if not _finished(benchmark, i, mark)]
    unmade = [
        i for i in benchmark.cases if not (benchmark.labels / f"case-{i:03d}.json").exists()
    ]
    _in_processes(
        [(make_case, str(benchmark.folder), benchmark.root, i) for i in unmade],
        workers,
        lambda done: progress("making logs", done),
    )
    if benchmark.sealed:
        seal_labels(benchmark)
    _in_processes(
        [
            (answer_case, str(benchmark.folder / "logs"), i, str(benchmark.answer_file(i)))
            for i in todo
        ],
        workers,
        lambda done: progress("diagnosing", done),
    )


def make_case(folder: str, root: int, index: int) -> None:
    """Write one case's logs and label.

    Args:
        folder: of the benchmark.
        root: seed of the set.
        index: of the case.
    """
    from ves_gym.diagnosis.benchmark.blind.machine import controller
    from ves_gym.diagnosis.benchmark.blind.write import write_set

    write_set(
        Path(folder) / "logs", Path(folder) / "labels", root, [index], _runner(), controller()
    )


@cache
def _runner() -> Any:
    from ves_gym.diagnosis.benchmark.blind.cases import Runner
    from ves_gym.diagnosis.benchmark.blind.machine import controller, nominal

    return Runner(nominal().to_dict(), controller())


def seal_labels(benchmark: BenchmarkRun) -> str:
    """Return the digest of the labels, written to `seal.json` unless it is there already.

    Raises:
        ParameterError: the seal there is of other cases or other labels.
    """
    from ves_gym.diagnosis.benchmark.blind.write import seal

    labels = read_truth(benchmark)
    file, secret = benchmark.folder / "seal.json", benchmark.labels / "nonce.json"
    if file.exists():
        sealed = read_table(file)
        if sealed["cases"] != list(benchmark.cases):
            raise ParameterError(f"{file}: seals other cases; take another folder")
        if seal(labels, read_table(secret)["nonce"])[0] != sealed["digest"]:
            raise ParameterError(f"{file}: the labels are not those that were sealed")
        return str(sealed["digest"])
    if any(benchmark.answer_file(i).exists() for i in benchmark.cases):
        raise ParameterError(f"{file}: is gone, and there are answers already")
    digest, nonce = seal(labels)
    write_text(secret, canonical_json({"nonce": nonce}) + "\n")
    write_text(file, canonical_json({"cases": list(benchmark.cases), "digest": digest}) + "\n")
    return digest


def read_truth(benchmark: BenchmarkRun) -> list[dict[str, Any]]:
    """Return the labels of the cases, in order."""
    return [read_table(benchmark.labels / f"case-{i:03d}.json") for i in benchmark.cases]


def read_answers(benchmark: BenchmarkRun) -> list[dict[str, Any]]:
    """Return the answers to the cases, in order."""
    return [read_table(benchmark.answer_file(i)) for i in benchmark.cases]


def scored_part(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the part of an answer that is scored, numbers to six digits."""
    scored = {k: answer[k] for k in _SCORED if k in answer}
    scored["seconds"] = {"total": answer["seconds"]["total"]}
    out: dict[str, Any] = _rounded(scored)
    return out


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    return [_rounded(v) for v in value] if isinstance(value, list) else value


def thresholds_hash(limits: Thresholds) -> str:
    """Return the digest that separates answers under other thresholds."""
    return content_hash(dataclasses.asdict(limits))


def _finished(benchmark: BenchmarkRun, index: int, mark: str) -> bool:
    path = benchmark.answer_file(index)
    if not path.exists():
        return False
    record = read_table(path)
    if record["thresholds"] != mark:
        raise ParameterError(f"{path}: was found with other thresholds; take another folder")
    return bool(record["verdict"] != FAILED)


def _in_processes(
    calls: Sequence[tuple[Any, ...]], workers: int, progress: Callable[[float], None]
) -> None:
    """Call functions in processes with one thread each."""
    if not calls:
        return
    with Workers(min(workers, len(calls))) as pool:
        running: list[Future[None]] = [pool.submit(f, *arguments) for f, *arguments in calls]
        for k, future in enumerate(as_completed(running)):
            future.result()
            progress((k + 1) / len(calls))


# --------------------------------------------------------------------------- diagnosing


def answer_case(logs: str, index: int, path: str) -> None:
    """Diagnose one case from its logs alone and write the answer.

    A diagnosis that fails is an answer, too, and a wrong one.

    Args:
        logs: folder of all cases.
        index: of the case.
        path: of the answer.
    """
    limits = Thresholds()
    begin = time.perf_counter()
    out: dict[str, Any] = {"index": index, "thresholds": thresholds_hash(limits)}
    try:
        out |= diagnose_case(Path(logs) / f"case-{index:03d}", limits)
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        out |= {"verdict": FAILED, "why": why, "effects": [], "final": [], "baselines": {}}
        out |= {"seconds": {"total": time.perf_counter() - begin}}
    write_text(path, canonical_json(out) + "\n")


def diagnose_case(folder: Path, limits: Thresholds) -> dict[str, Any]:
    """Return the answer to the logs of a folder, with those of the baselines.

    Args:
        folder: of the case's logs.
        limits: thresholds.

    Returns:
        Plain data.
    """
    from ves_gym.diagnosis.benchmark.baselines import Baselines

    begin = time.perf_counter()
    inputs = system_inputs([str(folder)])
    diagnosis = diagnose(
        inputs.machine, inputs.runs, inputs.final, candidates=inputs.candidates, limits=limits
    )
    seconds = {**diagnosis.seconds, "total": time.perf_counter() - begin}
    plain = Baselines(diagnosis.residuals, diagnosis.signatures)
    tolerant = Baselines(diagnosis.residuals, diagnosis.signatures, tolerances=True)
    others = {
        "stepwise": plain.stepwise(),
        "stepwise, tolerances": tolerant.stepwise(),
        "smallest error": plain.smallest_error(),
    }
    return {
        "verdict": diagnosis.verdict,
        "sentence": diagnosis.sentence,
        "effects": [_effect(diagnosis, i) for i in range(len(diagnosis.explanations))],
        "remaining": diagnosis.remaining,
        "weak": list(diagnosis.weak),
        "steps": list(diagnosis.selection.steps),
        "final": [[g.port, g.channel, g.before, g.after] for g in diagnosis.final],
        "gaps": [[g.port, g.channel, g.before, g.after] for g in diagnosis.gaps],
        "seconds": seconds,
        "baselines": {
            name: [_named(n.candidate, n.values) for n in effects]
            for name, effects in others.items()
        },
    }


def _effect(diagnosis: Diagnosis, i: int) -> dict[str, Any]:
    """Return an effect named, with all its rivals; those of its class are `near`."""
    f, rivals = diagnosis.explanations[i], diagnosis.selection.rivals[i]
    return {
        **_named(f.candidate, f.values),
        "std": {
            name: s if np.isfinite(s) else None
            for name, s in zip(f.candidate.names, f.std.tolist(), strict=True)
        },
        "probability": float(f.probability),
        "rivals": [
            {
                **_named(r.candidate, r.values),
                "probability": float(r.probability),
                "near": k < len(f.rivals),
            }
            for k, r in enumerate(rivals)
        ],
    }


def _named(candidate: Candidate, values: Array) -> dict[str, Any]:
    return {
        "kind": candidate.kind,
        "slot": candidate.slot,
        "value": dict(zip(candidate.names, np.asarray(values).tolist(), strict=True)),
    }
