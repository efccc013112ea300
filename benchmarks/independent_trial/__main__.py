"""`python -m benchmarks.independent_trial write DIR --half first --seed 1 [--only NAME]`,
then `answer DIR` and `score DIR`: by the package, and against the truth.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from benchmarks import store
from benchmarks.independent_trial import answers, cases, compare, write


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.independent_trial")
    commands = parser.add_subparsers(dest="command", required=True)
    for name, text in (("write", "make cases"), ("count", "count cases of each kind")):
        command = commands.add_parser(name, help=text)
        command.add_argument("--half", choices=("first", "second"), required=True)
        command.add_argument("--seed", type=int, required=True)
        if name == "write":
            command.add_argument("folder", type=Path, metavar="DIR")
            command.add_argument("--only", metavar="NAME", help="one case, as first-017")
    command = commands.add_parser("compare", help="stated machines against the package's runs")
    command.add_argument("folder", type=Path, metavar="EXAMPLES")
    for name, text in (("answer", "diagnose cases"), ("score", "compare with the truth")):
        command = commands.add_parser(name, help=text)
        command.add_argument("folder", type=Path, metavar="DIR")
        if name == "score":
            command.add_argument("--json", type=Path, help="write the counts to this file")
    options = parser.parse_args(arguments)
    if options.command == "answer":
        answer(options.folder)
        return 0
    if options.command == "score":
        score(options.folder, options.json)
        return 0
    if options.command == "compare":
        compare.table(options.folder)
        return 0
    plan = cases.plan(options.half, options.seed)
    named = {f"{options.half}-{k + 1:03d}": case for k, case in enumerate(plan)}
    if options.command == "count":
        kinds = [case.kind for case in plan]
        print({kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}, len(plan))
        return 0
    if options.only is not None and options.only not in named:
        parser.error(f"no case {options.only!r}; there are {min(named)} to {max(named)}")
    chosen = named if options.only is None else {options.only: named[options.only]}
    write.write(options.folder, chosen)
    return 0


def answer(folder: Path) -> None:
    """DIR/answers/NAME.json of every case that has none yet."""
    (folder / "answers").mkdir(exist_ok=True)
    for case in sorted((folder / "cases").iterdir()):
        path = folder / "answers" / f"{case.name}.json"
        if not path.exists():
            given = answers.answer(case, folder / "diagnoses" / case.name)
            path.write_text(json.dumps(given, indent=1) + "\n")
            print(f"{case.name}  {given['verdict']}", flush=True)


def score(folder: Path, file: Path | None = None) -> None:
    """Print a line for each answer, and the table; store its counts."""
    judged = []
    for path in sorted((folder / "answers").glob("*.json")):
        truth = json.loads((folder / "truth" / path.name).read_text())
        judged.append((truth, json.loads(path.read_text())))
        hidden = ", ".join(f"{e['name']} {e['place']}" for e in truth["effects"]) or "nothing"
        told = ", ".join(f"{n['kind']} {n['slot']}" for n in judged[-1][1]["names"])
        print(f"{path.stem}  {answers.judge(*judged[-1])}: {hidden}; said: {told}")
    print(answers.table(judged))
    if file is not None:
        store(file, ["case", *answers.MARKS], answers.counts(judged))


if __name__ == "__main__":
    sys.exit(main())
