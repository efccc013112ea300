"""Honest bundles on other instruction sets: `python -m benchmarks.honest [--folder DIR]`.

Bundles of four quick problems are made by this processor as it is, without AVX-512, and without
AVX2 and FMA (as by `python -m tests.processors`); each is verified, its method run again, under
all three. Printed of each of the 36: if it is accepted, how many rows are equal to the last
bit, and the largest relative difference of a score between maker and verifier. Status 1 where
one is refused.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.processors import SETS, switches_of_this_machine
from ves_gym.baselines.policy import released
from ves_gym.leaderboard.errors import BundleError
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.verify import verify

AS_IT_IS = "as-it-is"
ALL = (AS_IT_IS, *SETS)
METHODS = (
    ("policies", "ves/PumaReach-v0-quick", "ppo"),
    ("damping", "ves/PumaDamp-v0-quick", "pped"),
    ("damping", "pped-bent-quick", "strain"),
    ("paths", "reach100-1s-quick", "direct"),
)


def _file(folder: Path, of: str, k: int) -> Path:
    return folder / f"{of}-{k}.zip"


def make(folder: Path, of: str) -> None:
    """Write the bundles of one instruction set."""
    for k, (track, problem, name) in enumerate(METHODS):
        files = released(problem.removesuffix("-quick")) if problem.startswith("ves/") else {}
        method = [files[name]] if name in files else name
        make_bundle(_file(folder, of, k), track, problem, method, author="benchmarks.honest")


def check(folder: Path, here: str) -> int:
    """Verify the bundles of every set; how many are refused."""
    refused = 0
    for of in ALL:
        for k, (_, problem, name) in enumerate(METHODS):
            words = f"| {of} | {here} | {problem} {name} |"
            try:
                entry = verify(_file(folder, of, k), level="reproduced")
            except BundleError as error:
                refused += 1
                print(f"{words} refused: {error} | | |", flush=True)
                continue
            r = entry.about["reproduction"]
            print(
                f"{words} yes | {r['equal']} of {r['rows']} | {r['largest']:.1g} |", flush=True
            )
    return refused


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--set", choices=ALL, dest="name")
    parser.add_argument("--do", choices=("make", "check"))
    args = parser.parse_args(words)
    if args.do is not None:
        if args.do == "make":
            make(args.folder, args.name)
            return 0
        return int(check(args.folder, args.name) > 0)
    status = 0
    with TemporaryDirectory() as temporary:
        folder = args.folder or Path(temporary)
        print("| made | verified | problem | accepted | rows equal | largest difference |")
        print("|---|---|---|---|---|---|", flush=True)
        for do in ("make", "check"):
            for name in ALL:
                changed = {} if name == AS_IT_IS else switches_of_this_machine(name)
                command = [sys.executable, "-m", "benchmarks.honest", "--do", do]
                command += ["--set", name, "--folder", str(folder)]
                status |= subprocess.run(command, env={**os.environ, **changed}).returncode
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
