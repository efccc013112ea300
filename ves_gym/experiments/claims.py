"""Claims on units: two sweeps in one folder share its units, and none is done twice.

A claim is a lock on a file that the operating system lets go when its holder dies.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def _file(folder: Path, id: str) -> Path:
    return folder / "work" / f"{id}.claim"


@contextmanager
def claimed(folder: Path, id: str) -> Iterator[bool]:
    """Claim a unit while the block runs; False where another process has it.

    Args:
        folder: of the sweep.
        id: of the unit.
    """
    path = _file(folder, id)
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if not _locked(handle):
                yield False
                return
            if not _is(handle, path):  # its holder removed it between opening and locking
                continue
            try:
                yield True
            finally:
                path.unlink(missing_ok=True)
            return
        finally:
            os.close(handle)


def is_claimed(folder: Path, id: str) -> bool:
    """Return True while another process does a unit.

    Args:
        folder: of the sweep.
        id: of the unit.
    """
    try:
        handle = os.open(_file(folder, id), os.O_RDWR)
    except FileNotFoundError:
        return False
    try:
        return not _locked(handle)
    finally:
        os.close(handle)


def _locked(handle: int) -> bool:
    """Lock a file, unless another has."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is(handle: int, path: Path) -> bool:
    try:
        return os.fstat(handle).st_ino == os.stat(path).st_ino
    except FileNotFoundError:
        return False
