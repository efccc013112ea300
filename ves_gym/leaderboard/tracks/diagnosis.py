"""Track *discrepancy*: naming what is hidden in the machines of the blind benchmark.

The truth is made from the set's seed, never read from a bundle: labels come with the logs, in
a folder of their own that is kept from one verification to the next.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json
from ves_gym._util.suggest import did_you_mean
from ves_gym.diagnosis.benchmark import run as blind_benchmark
from ves_gym.diagnosis.benchmark.score import OWN, ScoredCase, is_correct
from ves_gym.diagnosis.diagnose import MORE, NAMED, NOTHING, ONE_OF, UNKNOWN, WEAK
from ves_gym.leaderboard.entry import number, text
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.evaluators import identity
from ves_gym.leaderboard.protocol import PLANNED_SHARE, Problem, Seeds
from ves_gym.leaderboard.tracks.base import (
    Answers,
    Case,
    Method,
    Progress,
    Row,
    no_progress,
    row,
)
from ves_gym.leaderboard.tracks.selectors import SELECTORS, SILENT, answer_of, silent
from ves_gym.system.system import System

VERDICTS = (NOTHING, NAMED, ONE_OF, MORE, UNKNOWN, WEAK, blind_benchmark.FAILED)
_SPEAK = (NAMED, ONE_OF, MORE)
_MOST = 20  # effects named in an answer
_FOLDER = Path("out/leaderboard/blind")


class DiagnosisTrack:
    """Selectors on the cases of a set. Score: 0 for an answer as wanted, 1 for any other.

    Args:
        folder: where logs, labels and answers are kept; default out/leaderboard/blind.
        workers: processes that make and diagnose cases.
        progress: called with the stage and the fraction done where cases are made to verify.
    """

    def __init__(
        self,
        folder: Path | None = None,
        workers: int = 1,
        progress: Progress = no_progress,
    ) -> None:
        self.folder, self.workers, self.progress = folder or _FOLDER, workers, progress

    def payload(self, problem: Problem) -> str:
        """See `LeaderboardTrack`."""
        return "answers.json"

    def system(self, problem: Problem) -> System:
        """See `LeaderboardTrack`."""
        from ves_gym.diagnosis.benchmark.blind.machine import nominal

        return nominal()

    def benchmark(self, problem: Problem, seeds: Seeds) -> blind_benchmark.BenchmarkRun:
        """Return the cases, in a folder that belongs to them and to this evaluator alone.

        Logs and labels are the evaluator's and last as long as its version; answers are the
        method's, and those of other sources are never taken for its own.

        Args:
            problem: which cases.
            seeds: where they come from.
        """
        from ves_gym.diagnosis.benchmark.blind.cases import mix
        from ves_gym.diagnosis.inference.cache import source_digest

        name = hashlib.sha256(f"{seeds.root} {identity(problem)}".encode()).hexdigest()[:16]
        answers = f"answers-{source_digest()[:16]}"
        size = len(mix())
        cases = (
            range(size)
            if problem.count == size
            else blind_benchmark.stratified(problem.count, seeds.root)
        )
        sealed = seeds.which == "official"
        indices = tuple(sorted(cases))
        return blind_benchmark.BenchmarkRun(
            self.folder / name, seeds.root, sealed, indices, answers
        )

    def seed_list(self, problem: Problem, seeds: Seeds) -> list[int]:
        """See `LeaderboardTrack`."""
        return list(self.benchmark(problem, seeds).cases)

    def cases(self, problem: Problem, seeds: Seeds, method: Method, group: int) -> list[Case]:
        """See `LeaderboardTrack`."""
        return [Case(f"case-{i:03d}", i) for i in self.seed_list(problem, seeds)]

    def run(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        on_progress: Progress = no_progress,
    ) -> Answers:
        """Make the cases and diagnose them; go on where it was interrupted."""
        if method.name not in SELECTORS:
            raise ParameterError(
                f"selector must be one of {', '.join(SELECTORS)}, got {method.name!r:.80}"
                f"{did_you_mean(method.name, SELECTORS)}"
            )
        benchmark = self.benchmark(problem, seeds)
        answers, seconds = self._answers(benchmark, method, on_progress)
        data = (canonical_json({"answers": answers}) + "\n").encode()
        rows = _timed(self._rows(problem, seeds, method, answers), seconds)
        return Answers(rows, data, method)

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Row]:
        """See `LeaderboardTrack`. What is told of the time is taken over as it is."""
        if any(r["length"] != 1 for r in rows):
            raise BundleError(Code.EPISODE_LENGTH, "a case has one answer")
        answers = _read(data, self.seed_list(problem, seeds))
        out = self._rows(problem, seeds, method, answers)
        for result, claimed in zip(out, rows, strict=True):
            result["seconds"] = claimed["seconds"]
        return out

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """See `LeaderboardTrack`. There is no energy, and the best score is 0."""
        for result in rows:
            if result["score"] is not None and result["score"] < 0:
                raise BundleError(Code.BELOW_FLOOR, f"{result['id']}: a score below 0")

    def reproduce(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        members: Mapping[str, bytes],
        rows: Sequence[Row],
    ) -> list[Row]:
        """See `LeaderboardTrack`. 95 % of the answers must be those submitted."""
        if method.name not in SELECTORS:
            raise BundleError(Code.NOT_REPRODUCIBLE, f"no selector {method.name!r:.80}")
        benchmark = self.benchmark(problem, seeds)
        # answers of runs that verify, never those that a bundle was made from
        again = replace(benchmark, answers=f"again-{benchmark.answers}")
        mine, seconds = self._answers(again, method, self.progress)
        its = _read(members[self.payload(problem)], list(benchmark.cases))
        agree = [_verdict_of(a) == _verdict_of(b) for a, b in zip(mine, its, strict=True)]
        if sum(agree) < PLANNED_SHARE * len(agree):
            first = benchmark.cases[agree.index(False)]
            raise BundleError(Code.NOT_REPRODUCED, f"case {first}: another answer is found")
        return _timed(self._rows(problem, seeds, method, mine), seconds)

    def _answers(
        self,
        benchmark: blind_benchmark.BenchmarkRun,
        method: Method,
        on_progress: Progress = no_progress,
    ) -> tuple[list[dict[str, Any]], list[float | None]]:
        """Diagnose what is not diagnosed yet; answers to all cases, and the seconds of each.

        One diagnosis has the answers of every selector: only the package's own is timed by it.
        """
        if method.name == SILENT:
            return [silent(i) for i in benchmark.cases], [None] * len(benchmark.cases)
        blind_benchmark.run_benchmark(benchmark, self.workers, on_progress)
        found = blind_benchmark.read_answers(benchmark)
        own = method.name == OWN
        seconds = [float(a["seconds"]["total"]) if own else None for a in found]
        return [answer_of(a, method.name) for a in found], seconds

    def _rows(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        answers: Sequence[dict[str, Any]],
    ) -> list[Row]:
        benchmark = self.benchmark(problem, seeds)
        for k, i in enumerate(benchmark.cases):
            if not (benchmark.labels / f"case-{i:03d}.json").exists():
                self.progress("making logs", k / len(benchmark.cases))
                blind_benchmark.make_case(str(benchmark.folder), benchmark.root, i)
        out = []
        cases = self.cases(problem, seeds, method, 0)
        for case, label, answer in zip(
            cases, blind_benchmark.read_truth(benchmark), answers, strict=True
        ):
            failed = answer["verdict"] == blind_benchmark.FAILED
            effects = answer["effects"] if answer["verdict"] in _SPEAK else []
            correct = not failed and is_correct(
                ScoredCase(label, answer["verdict"], effects, answer)
            )
            out.append(
                row(
                    case,
                    0,
                    score=None if failed else float(not correct),
                    success=correct,
                    failed=failed,
                    energies={},
                    length=1,
                )
            )
        return out


def _timed(rows: Sequence[Row], seconds: Sequence[float | None]) -> list[Row]:
    return [{**row, "seconds": s} for row, s in zip(rows, seconds, strict=True)]


def _verdict_of(answer: Mapping[str, Any]) -> tuple[str, list[tuple[str, str]]]:
    return answer["verdict"], sorted((e["kind"], e["slot"]) for e in answer["effects"])


def _read(data: bytes, indices: Sequence[int]) -> list[dict[str, Any]]:
    """The answers of a bundle, checked."""
    try:
        table = json.loads(data.decode("utf-8"), parse_constant=_no_number)
        if not isinstance(table, dict) or set(table) != {"answers"}:
            raise ParameterError("answers.json must be {answers: [...]}")
        answers = table["answers"]
        if not isinstance(answers, list) or len(answers) > 10_000:
            raise ParameterError("answers must be a list")
        out = [_answer(a, f"answers[{k}]") for k, a in enumerate(answers)]
    except (ValueError, RecursionError, OverflowError) as error:
        raise BundleError(Code.BAD_ACTION, f"answers.json: {str(error)[:200]}") from None
    if [a["index"] for a in out] != list(indices):
        raise BundleError(Code.EPISODE_LENGTH, "the answers are not those to the cases asked")
    return out


def _answer(plain: Any, where: str) -> dict[str, Any]:
    if not isinstance(plain, dict) or set(plain) != {"index", "verdict", "effects"}:
        raise ParameterError(f"{where} must have index, verdict and effects")
    index = plain["index"]
    if isinstance(index, bool) or not isinstance(index, int):
        raise ParameterError(f"{where}.index must be a whole number")
    if plain["verdict"] not in VERDICTS:
        raise ParameterError(f"{where}.verdict must be one of {', '.join(VERDICTS)}")
    effects = plain["effects"]
    if not isinstance(effects, list) or len(effects) > _MOST:
        raise ParameterError(f"{where}.effects must be a list of at most {_MOST}")
    for e in effects:
        if not isinstance(e, dict) or set(e) != {"kind", "slot", "value"}:
            raise ParameterError(f"{where}: an effect has kind, slot and value")
        text(e["kind"], f"{where}.kind")
        text(e["slot"], f"{where}.slot", empty=True)
        if not isinstance(e["value"], dict) or not e["value"]:
            raise ParameterError(f"{where}.value must be a table of numbers")
        for name, value in e["value"].items():
            text(name, f"{where}.value")
            number(value, f"{where}.value.{name}")
    return plain


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")
