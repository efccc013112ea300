"""`python -m benchmarks.independent_trial write DIR --half first --seed 1 [--only NAME]`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.independent_trial import cases, compare, write


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
    options = parser.parse_args(arguments)
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


if __name__ == "__main__":
    sys.exit(main())
