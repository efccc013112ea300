"""Files of a bundle, from a folder or a .zip, without trusting either.

Nothing is unpacked: members are read into memory, those on the list alone, each and all
together up to a size. Names are names, never paths.
"""

from __future__ import annotations

import io
import os
import re
import stat
import zipfile
import zlib
from pathlib import Path

from ves_gym._util.params import ParameterError, write_bytes
from ves_gym.leaderboard.errors import BundleError, Code

MANIFEST = "manifest.json"
SIGNATURE = "manifest.json.sig"  # of the manifest's bytes (signature.py)
_MIB = 2**20
# what a bundle may hold, and the most bytes of it
LIMITS = {
    MANIFEST: 16 * _MIB,
    SIGNATURE: 2**12,
    "actions.npy": 128 * _MIB,
    "motions.npy": 32 * _MIB,
    "gains.npy": 4 * _MIB,
    "answers.json": 16 * _MIB,
}
POLICY = re.compile(r"policy(-[1-9]|-1[0-5])?\.(json|safetensors)")
_POLICY_LIMIT = {"json": _MIB, "safetensors": 64 * _MIB}
TOTAL = 256 * _MIB
_MOST = 64  # members
_LISTED = 512  # bytes of a member in the archive's list, its name included

# what zipfile and zlib raise on archives made to break them
_BROKEN = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    IndexError,
    MemoryError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
)


def limit(name: str) -> int | None:
    """Most bytes of a member, None for a name that no bundle has."""
    match = POLICY.fullmatch(name)
    return _POLICY_LIMIT[match[2]] if match else LIMITS.get(name)


def read_members(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """Every file of a bundle by name.

    Raises:
        ParameterError: there is no such file or folder.
        BundleError: UNSAFE_ARCHIVE.
    """
    path = Path(path)
    if path.is_dir():
        return _from_folder(path)
    if not path.is_file():
        raise ParameterError(f"{path}: expected a bundle, a folder or a .zip file")
    return _from_zip(path)


def _unsafe(why: str) -> BundleError:
    return BundleError(Code.UNSAFE_ARCHIVE, why)


def _require(name: str, size: int) -> None:
    most = limit(name)
    if most is None:
        raise _unsafe(
            f"{name[:100]!r} is no file of a bundle, which has {MANIFEST} and what it names"
        )
    if size > most:
        raise _unsafe(f"{name} has {size} bytes, at most {most} are read")


def _from_folder(folder: Path) -> dict[str, bytes]:
    out: dict[str, bytes] = {}
    with os.scandir(folder) as entries:
        for item in entries:
            _require(item.name, 0)
            out[item.name] = _read_file(folder / item.name, item.name)
            if sum(map(len, out.values())) > TOTAL:
                raise _unsafe(f"more than {TOTAL} bytes in all")
    return out


def _read_file(path: Path, name: str) -> bytes:
    """A regular file, never what a link or a pipe leads to."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        handle = os.open(path, flags | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise _unsafe(f"{name} cannot be opened as a file: {error.strerror}") from None
    if not stat.S_ISREG(os.fstat(handle).st_mode) or path.is_symlink():
        os.close(handle)
        raise _unsafe(f"{name} is no regular file")
    with os.fdopen(handle, "rb") as file:
        data = file.read((limit(name) or 0) + 1)
    _require(name, len(data))
    return data


def _from_zip(path: Path) -> dict[str, bytes]:
    if path.stat().st_size > TOTAL:
        raise _unsafe(f"the archive has more than {TOTAL} bytes")
    with path.open("rb") as file:
        begins = file.read(2)
    if begins != b"PK":
        raise _unsafe(f"{path.name!a} is no .zip file: it begins with {begins!r}, not b'PK'")
    try:
        _require_short_list(path)
        with zipfile.ZipFile(path) as archive:
            return _members(archive)
    except _BROKEN as error:
        raise _unsafe(
            f"{path.name!a} is damaged or cut short: {type(error).__name__}: {error}"
        ) from None


def _require_short_list(path: Path) -> None:
    """Read how many members an archive lists, before zipfile reads the list."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 2**16 - 64))
        tail = file.read()
    at = tail.rfind(b"PK\x05\x06")  # the record at the end of the list
    if at < 0 or len(tail) < at + 22:
        raise zipfile.BadZipFile("no list of members at its end")
    count = int.from_bytes(tail[at + 10 : at + 12], "little")
    listed = int.from_bytes(tail[at + 12 : at + 16], "little")
    if tail[max(0, at - 20) : at].startswith(b"PK\x06\x07"):
        raise _unsafe("a list of members for more than 4 GiB")
    if count > _MOST or listed > _MOST * _LISTED:
        raise _unsafe(f"{count} members in a list of {listed} bytes, at most {_MOST} are read")


def _members(archive: zipfile.ZipFile) -> dict[str, bytes]:
    listed = archive.infolist()
    if len(listed) > _MOST:
        raise _unsafe(f"{len(listed)} members, at most {_MOST} are read")
    out: dict[str, bytes] = {}
    for info in listed:
        name = info.filename
        _require(name, info.file_size)
        if info.orig_filename != name:
            raise _unsafe(f"{name} is called {info.orig_filename[:100]!r} as well")
        if name in out:
            raise _unsafe(f"{name} is in the archive twice")
        mode = info.external_attr >> 16
        if mode and not stat.S_ISREG(mode) and stat.S_IFMT(mode):
            raise _unsafe(f"{name} is no regular file")
        if info.flag_bits & 1 or info.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise _unsafe(f"{name} is encrypted, or compressed in an unusual way")
        with archive.open(info) as file:
            data = file.read(info.file_size + 1)
        if len(data) != info.file_size:
            raise _unsafe(f"{name} has not the size that the archive says")
        out[name] = data
        if sum(map(len, out.values())) > TOTAL:
            raise _unsafe(f"more than {TOTAL} bytes in all")
    return out


def write_members(path: str | os.PathLike[str], members: dict[str, bytes]) -> Path:
    """Write a bundle: a .zip by its suffix, else a folder, its manifest last.

    The bytes of a .zip depend on the members alone.
    """
    path = Path(path)
    if path.suffix != ".zip":
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise ParameterError(f"{path}: must be a new or empty folder for the bundle")
        for name in sorted(members, key=lambda k: (k == MANIFEST, k)):
            write_bytes(path / name, members[name])
        return path
    write_bytes(path, _zipped(members))
    return path


def add_member(
    path: str | os.PathLike[str], members: dict[str, bytes], name: str, data: bytes
) -> None:
    """Add a file to a bundle, or replace it.

    Args:
        path: folder or .zip file.
        members: what it holds.
        name: of the file.
        data: its bytes.
    """
    path = Path(path)
    _require(name, len(data))
    if path.is_dir():
        write_bytes(path / name, data)
    else:
        write_bytes(path, _zipped({**members, name: data}))


def _zipped(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(members):
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.external_attr = (stat.S_IFREG | 0o644) << 16
            archive.writestr(info, members[name], zipfile.ZIP_DEFLATED)
    return buffer.getvalue()
