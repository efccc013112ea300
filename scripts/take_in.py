"""Take in the bundles of a proposed merge: `python scripts/take_in.py BASE HEAD`.

A contributor proposes files docs/leaderboard/submitted/NAME.zip and nothing else. The code that
runs is that of this checkout, of BASE; of HEAD only those files are read, out of git. Each is
verified in a process without network, and what holds is put on the board with the rows found
here, its bundle beside it. Then the page is written and the board is checked. Exit status 1:
something was refused, and what was refused is not on the board.

    --level L       reproduced (default), or replayed for methods that are not built in
    --seconds S     that each bundle may take (3600)
    --board DIR     another folder of entries
    --open          with network, where `unshare` cannot make a process without
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ves_gym._util.one_line import on_one_line
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.audit import stale_ranked
from ves_gym.leaderboard.board import make_board
from ves_gym.leaderboard.journal import read
from ves_gym.leaderboard.page import write_page
from ves_gym.leaderboard.published import MOST

ROOT = Path(__file__).parents[1]
PLACE = "docs/leaderboard/submitted/"
_MANY = 20  # bundles of one proposal
# a process with a network of its own, in which there is nothing
ALONE = ("unshare", "--user", "--map-root-user", "--net", "--")


def proposed(repository: Path, base: str, head: str) -> dict[str, bytes]:
    """Return the bundles that a merge would add, by file name; nothing is checked out.

    Args:
        repository: with both commits.
        base: commit of the board.
        head: commit proposed.

    Raises:
        ParameterError: it changes anything else, or adds files too many or too large.
    """
    commits = [_commit(repository, name) for name in (base, head)]
    words = _git(repository, "diff", "--no-renames", "--name-status", "-z", "...".join(commits))
    fields = words.decode("utf-8", "surrogateescape").split("\0")[:-1]
    changes = list(zip(fields[::2], fields[1::2], strict=True))
    for how, name in changes:
        file = name.removeprefix(PLACE)
        if how != "A" or file == name or "/" in file or not file.endswith(".zip"):
            raise ParameterError(
                f"a proposal adds bundles {PLACE}NAME.zip and changes nothing else, got"
                f" {how} {name!a:.200}"
            )
    if not 1 <= len(changes) <= _MANY:
        raise ParameterError(f"a proposal has 1 to {_MANY} bundles, got {len(changes)}")
    out = {}
    for _, name in changes:
        blob = f"{commits[1]}:{name}"
        mode = _git(repository, "ls-tree", commits[1], "--", name)[:6].decode()
        size = int(_git(repository, "cat-file", "-s", blob))
        if mode not in ("100644", "100755") or size > MOST:
            raise ParameterError(
                f"{name!a:.200}: mode {mode}, {size} bytes; a plain file of at most {MOST}"
            )
        out[name.removeprefix(PLACE)] = _git(repository, "cat-file", "blob", blob)
    return out


def take_in(
    bundles: dict[str, bytes], board: Path, level: str, seconds: float, alone: bool = True
) -> list[str]:
    """Verify bundles and enter those that hold; the words of refusal of the others.

    Args:
        bundles: by file name.
        board: folder of the entries.
        level: of verification.
        seconds: that each may take.
        alone: without network.
    """
    if alone and (
        shutil.which(ALONE[0]) is None or subprocess.run([*ALONE, "true"]).returncode
    ):
        raise ParameterError("there is no `unshare` here that makes a process without network")
    refused = []
    with tempfile.TemporaryDirectory() as folder:
        for k, (name, data) in enumerate(sorted(bundles.items())):
            file = Path(folder) / f"{k}.zip"
            file.write_bytes(data)
            words = [
                *(sys.executable, "-m", "ves_gym.cli.main", "leaderboard", "verify", str(file)),
                *("--level", level, "--seconds", f"{seconds:g}"),
                *("--board", str(board), "--publish"),
            ]
            done = subprocess.run(
                [*(ALONE if alone else ()), *words],
                cwd=ROOT, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            )  # fmt: skip
            print(f"{name!a}: {on_one_line(done.stdout + done.stderr)}", flush=True)
            if done.returncode:
                refused.append(f"{name!a}: {on_one_line(done.stderr)}")
    return refused


def _commit(repository: Path, name: str) -> str:
    words = ("rev-parse", "--verify", "--end-of-options", f"{name}^{{commit}}")
    return _git(repository, *words).decode().strip()


def _git(repository: Path, *words: str) -> bytes:
    done = subprocess.run(
        ["git", "-C", str(repository), *words], capture_output=True, stdin=subprocess.DEVNULL
    )
    if done.returncode:
        raise ParameterError(
            f"git {words[0]}: {on_one_line(done.stderr.decode('utf-8', 'replace'))}"
        )
    return done.stdout


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("base")
    parser.add_argument("head")
    parser.add_argument("--level", default="reproduced")
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--board", type=Path, default=ROOT / "docs/leaderboard/entries")
    parser.add_argument("--repository", type=Path, default=ROOT)
    parser.add_argument("--open", action="store_true")
    args = parser.parse_args(words)
    board = args.board.absolute()
    try:
        bundles = proposed(args.repository, args.base, args.head)
        refused = take_in(bundles, board, args.level, args.seconds, not args.open)
    except ParameterError as error:
        print(f"refused: {on_one_line(str(error))}", file=sys.stderr)
        return 1
    journal = read(board)
    page = make_board(journal)
    faults = stale_ranked(page, journal)
    write_page(page, board.with_name("index.html"))
    print(f"{len(bundles) - len(refused)} of {len(bundles)} taken in, {len(faults)} faults")
    return int(bool(refused or faults))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
