"""`ves-gym diagnose-benchmark`: the blind benchmark of `diagnose`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json, read_table, write_text
from ves_gym._util.version import __version__
from ves_gym.cli.common import out_dir, progress, write_json

SCHEMA = "ves-diagnose-benchmark/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--set", metavar="NAME", default="development", help="development (default) or sealed"
    )
    parser.add_argument("--salt", metavar="FILE", help="the sealed set's secret")
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--cases",
        metavar="N",
        help="N cases in the proportions of the whole, or A:B, those from A to B - 1"
        " (default: all 600)",
    )
    group.add_argument("--quick", action="store_true", help="30 cases")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes (1)")
    parser.add_argument(
        "--docs",
        metavar="FILE",
        help="write the scores as Markdown, and beside it all that they rest on as .json",
    )


def run(args: argparse.Namespace) -> int:
    """Make cases, diagnose them, score the answers; go on where it was interrupted."""
    from ves_gym.diagnosis.benchmark import run as t
    from ves_gym.diagnosis.benchmark.score import score
    from ves_gym.diagnosis.inference.model_selection import Thresholds
    from ves_gym.report.benchmark_page import markdown

    if args.workers < 1:
        raise ParameterError(f"--workers must be >= 1, got {args.workers}")
    cases = t.QUICK if args.quick else _cases(args.cases)
    salt = Path(args.salt) if args.salt else None
    folder = Path(args.out or f"out/diagnose-benchmark-{args.set}")
    benchmark = t.benchmark_run(folder, args.set, salt, cases)
    out_dir(args, str(folder))
    with progress() as on_progress:
        t.run_benchmark(benchmark, args.workers, on_progress)
    truth, answers = (
        t.read_truth(benchmark),
        [t.scored_part(a) for a in t.read_answers(benchmark)],
    )
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "set": args.set,
        "cases": list(benchmark.cases),
        "command": _command(args),
        "version": __version__,
        "thresholds": t.thresholds_hash(Thresholds()),
        "seal": None,
        "score": score(truth, answers),
    }
    if benchmark.sealed:
        digest = read_table(folder / "seal.json")["digest"]
        nonce = read_table(benchmark.labels / "nonce.json")["nonce"]
        result["seal"] = {"digest": digest, "nonce": nonce}
    page = markdown(result)
    print(page, end="")
    for path in (folder / "scores.md", *([Path(args.docs)] if args.docs else [])):
        write_text(path, page)
    if args.docs:  # all that the page is computed from
        about = {k: v for k, v in result.items() if k != "score"}
        record = {**about, "labels": truth, "answers": answers}
        write_text(Path(args.docs).with_suffix(".json"), canonical_json(record) + "\n")
    write_json(str(folder / "scores.json"), result)
    write_json(args.json, result)
    return 0


def _command(args: argparse.Namespace) -> str:
    """Return the command that makes this result again, without folders or the secret."""
    words = ["ves-gym", "diagnose-benchmark", "--set", args.set]
    words += ["--salt", "SALT"] if args.salt else []
    words += ["--quick"] if args.quick else []
    words += ["--cases", args.cases] if args.cases else []
    return " ".join(words)


def _cases(text: str | None) -> range | int | None:
    if text is None:
        return None
    parts = text.split(":")
    try:
        numbers = [int(p) for p in parts]
    except ValueError:
        numbers = []
    if len(numbers) == 1:
        return numbers[0]
    if len(numbers) == 2 and 0 <= numbers[0] < numbers[1]:
        return range(*numbers)
    raise ParameterError(f"--cases must be N or A:B with 0 <= A < B, got {text!r}")
