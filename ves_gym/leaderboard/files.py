"""Files of an entry: a folder as `run` writes it, or `entry.json` alone. None is trusted.

    entry.json                                  what is claimed, and by which method
    recording.safetensors                       answers of a method that only its author has
    policy-0.json, policy-0.safetensors, ...    policies, of a closed list of architectures

Arrays are read as safetensors, which holds numbers alone: no pickle is ever read.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import safetensors.numpy

from ves_gym._util.params import Array, ParameterError, write_bytes
from ves_gym.leaderboard.entry import LARGEST, MOST_GROUPS, Code, Refused, refusing

ENTRY = "entry.json"
RECORDING = "recording.safetensors"
_MIB = 2**20
_LIMITS = {ENTRY: LARGEST, RECORDING: 128 * _MIB}  # bytes
_POLICY = re.compile(r"policy-(\d|1[0-5])\.(json|safetensors)")
_POLICY_LIMITS = {"json": _MIB, "safetensors": 16 * _MIB}

# of each group and episode: actions, control points, gains
Recording = Sequence[Sequence[Array]]


def policy_names(group: int) -> tuple[str, str]:
    """Files that hold the policy of a group."""
    assert group < MOST_GROUPS
    return f"policy-{group}.json", f"policy-{group}.safetensors"


def read_files(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """The files of an entry by name; a single file is its `entry.json`.

    Raises:
        ParameterError: there is no such file or folder.
        Refused: UNSAFE_FILE.
    """
    path = Path(path)
    if path.is_dir():
        with os.scandir(path) as items:
            files = {item.name: path / item.name for item in items}
        if ENTRY not in files:
            raise ParameterError(f"{path}: has no {ENTRY}")
    elif path.is_file():
        files = {ENTRY: path}
    else:
        raise ParameterError(f"{path}: expected an entry, a folder with {ENTRY} or the file")
    for name in files:
        if _limit(name) is None:
            raise Refused(Code.UNSAFE_FILE, f"{name[:100]!r} is no file of an entry")
    return {name: _read(file, _limit(name) or 0) for name, file in files.items()}


def unfinished(folder: Path) -> list[Path]:
    """Return what a run that was killed has left in the folder of an entry.

    Raises:
        ParameterError: the folder holds an entry, or files of something else.
    """
    present = list(folder.iterdir()) if folder.is_dir() else []
    names = [p.name[1:].rpartition(".")[0] if p.name[0] == "." else p.name for p in present]
    if folder.is_file() or (folder / ENTRY).exists() or None in map(_limit, names):
        raise ParameterError(f"{folder}: must be a new or empty folder for the entry")
    return present


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write an entry's folder, `entry.json` last; one that is in use is left alone."""
    for path in unfinished(folder):
        path.unlink()
    for name in sorted(files, key=lambda k: (k == ENTRY, k)):
        write_bytes(folder / name, files[name])


def pack(recording: Recording) -> bytes:
    """A recording as a file."""
    tensors = {
        f"{g}.{k}": np.ascontiguousarray(answer, dtype=np.float64)
        for g, group in enumerate(recording)
        for k, answer in enumerate(group)
    }
    return bytes(safetensors.numpy.save(tensors))


def unpack(data: bytes, groups: int, count: int, shape: tuple[int, ...]) -> Recording:
    """A recording from its file.

    Args:
        data: of the file.
        groups, count: of groups, and of episodes in each.
        shape: of an answer but for its first axis.

    Raises:
        Refused: BAD_RECORDING, WRONG_LENGTH.
    """
    with refusing(Code.BAD_RECORDING, Exception):  # the parser's own, whatever it raises
        tensors = safetensors.numpy.load(data)
    names = [[f"{g}.{k}" for k in range(count)] for g in range(groups)]
    if set(tensors) != {name for group in names for name in group}:
        raise Refused(
            Code.WRONG_LENGTH,
            f"{RECORDING}: expected arrays 0.0, 0.1, ... of {groups} groups of {count}, got"
            f" {len(tensors)}",
        )
    for name, answer in tensors.items():
        if answer.dtype != np.float64 or answer.ndim < 1 or answer.shape[1:] != shape:
            raise _bad(f"{name} must be float64 of shape (any, {shape}), got {answer.shape}")
        if not np.isfinite(answer).all():
            raise _bad(f"{name} is not finite")
    return [[tensors[name] for name in group] for group in names]


def _bad(why: str) -> Refused:
    return Refused(Code.BAD_RECORDING, f"{RECORDING}: {why}")


def _limit(name: str) -> int | None:
    """Most bytes of a file, None for a name that no entry has."""
    match = _POLICY.fullmatch(name)
    return _POLICY_LIMITS[match[2]] if match else _LIMITS.get(name)


def _read(path: Path, most: int) -> bytes:
    """A regular file, never what a link or a pipe leads to."""
    if path.is_symlink() or not path.is_file():
        raise Refused(Code.UNSAFE_FILE, f"{path.name} is no regular file")
    with refusing(Code.UNSAFE_FILE, OSError), path.open("rb") as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise Refused(Code.UNSAFE_FILE, f"{path.name} has more than {most} bytes")
    return data
