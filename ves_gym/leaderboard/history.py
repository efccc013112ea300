"""Git as the chain of the board: files of entries are added, never changed or removed.

A commit's hash stands for the content of every file and for all commits before it. So what was
once on the board can be read there, and a change shows in every later commit.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from ves_gym._util.params import ParameterError


def history_faults(
    folder: str | os.PathLike[str], *, since: str | None = None, most: int = 20
) -> list[str]:
    """Name the commits that changed or removed a file of the board, `most` at most.

    Merges are compared with each of their parents. What is not committed yet is looked at too.

    Args:
        folder: of the entries, in a git repository.
        since: a commit that is known to be good, such as origin/main of a proposed merge;
            default the whole history that is there (a shallow clone has less).
        most: faults to name.

    Raises:
        ParameterError: git is not installed, the folder is in no repository, or there is no
            such commit.
    """
    commits = "HEAD" if since is None else f"{_commit(folder, since)}..HEAD"
    log = _git(
        folder, "log", "-m", "--no-renames", "--diff-filter=a", "--name-status",
        "--format=commit %H", commits, "--", ".",
    )  # fmt: skip
    out: list[str] = []
    commit = ""
    for row in log.splitlines():
        if row.startswith("commit "):
            commit = row.removeprefix("commit ")
        elif row:
            out.append(f"{_changed(row)} by commit {commit[:12]}")
    uncommitted = _git(
        folder, "diff", "--no-renames", "--diff-filter=a", "--name-status", "HEAD", "--", "."
    )
    out += [f"{_changed(row)}, not committed" for row in uncommitted.splitlines() if row]
    return list(dict.fromkeys(out))[:most]  # a merge tells the same of two parents


def _changed(row: str) -> str:
    """A line of --name-status in words."""
    how, _, name = row.partition("\t")
    return f"{Path(name).name} was {'removed' if how == 'D' else 'changed'}"


def _commit(folder: str | os.PathLike[str], name: str) -> str:
    """The hash of a commit; a name that looks like an option is none."""
    return _git(
        folder, "rev-parse", "--verify", "--end-of-options", f"{name}^{{commit}}"
    ).strip()


def _git(folder: str | os.PathLike[str], *words: str) -> str:
    program = shutil.which("git")
    if program is None:
        raise ParameterError("the program git is not installed: it is the chain of the board")
    done = subprocess.run(
        [program, "-c", "core.quotepath=off", "-C", os.fspath(folder), *words],
        capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no reason told"])[0]
        raise ParameterError(f"{folder}: git says: {said[:200]}")
    return done.stdout
