"""The door for files that others wrote: how large they may be, and who reads them.

XML is parsed here, with bounds on its size and depth; entities are expat's own, which bounds
what they grow to. What is read by a library in C (SciPy, MuJoCo, HDF5, SQLite), or may ask for
more memory than the file has bytes, is read in a process of its own with bounds on memory and
time: its death is one sentence. Answers come back as plain arrays; nothing is unpickled.
"""

from __future__ import annotations

import importlib
import io
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np

from ves_gym._util.child_process import Child, ChildDied, serve
from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import why_unread

MOST = 1 << 28  # bytes of a file that is read whole, 256 MiB
DEEPEST = 200  # levels of an XML file
MEMORY = 1 << 30  # bytes that reading a file may take beside what the file has, 1 GiB
SECONDS, RATE = 8.0, 5e5  # s of computing, and bytes a second beyond: DMIG in Python
_BUSY = 30.0  # times as long as on a machine that does nothing else
_OF_FILE = 20  # times the file that its numbers may take: DMIG as tuples


@contextmanager
def named(file: object, kind: type[ValueError] = ParameterError) -> Iterator[None]:
    """Put a file's name before whatever is wrong with it: errors of one kind."""
    try:
        yield
    except kind as error:
        raise kind(f"{file}: {error}") from None


def read_bytes(path: str | os.PathLike[str], most: int = MOST) -> bytes:
    """Return a file's bytes, refused if it is not there or has more than `most`."""
    try:
        size = os.stat(path).st_size
        if size > most:
            raise ParameterError(f"must have at most {most >> 20} MiB, got {size >> 20} MiB")
        return Path(path).read_bytes()
    except OSError as error:
        raise ParameterError(f"cannot be read: {why_unread(path, error)}") from None


def read_xml(path: str | os.PathLike[str]) -> Element:
    """Return the top element of an XML file, refused beyond `DEEPEST` levels."""
    data = read_bytes(path).lstrip(b" \t\r\n")
    try:
        top = _parsed(data)
    except (expat.ExpatError, LookupError, ValueError, MemoryError) as error:
        raise ParameterError(f"cannot be read as XML: {error}") from None
    level, depth = [top], 0
    while level:
        depth += 1
        if depth > DEEPEST:
            raise ParameterError(f"must have at most {DEEPEST} levels, got more")
        level = [child for element in level for child in element]
    return top


def _refuse_entity(name: str, _: bool) -> None:
    raise ValueError(f"undefined entity &{name};")


def _parsed(data: bytes) -> Element:
    """The top element; names with a prefix stay as they are written, bound or not."""
    encoding = None
    if b"encoding" not in data[:200] and data[:2] not in (b"\xff\xfe", b"\xfe\xff"):
        try:
            data.decode()
        except UnicodeDecodeError:  # it declares nothing: as other readers take it
            encoding = "iso-8859-1"
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate(encoding)
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.ExternalEntityRefHandler = lambda *_: 0  # an error: files are not let in
    parser.SkippedEntityHandler = _refuse_entity
    parser.Parse(data, True)
    return builder.close()


def read_apart(reader: str, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return arrays by name that a reader, "module:function" of this package, makes of a file
    or of a folder, in a process of its own.

    Refused where the reader crashed, or took too much memory or time.
    """
    try:
        inside = Path(path).iterdir() if os.path.isdir(path) else [path]
        size = sum(os.stat(file).st_size for file in inside)
    except OSError as error:
        raise ParameterError(f"cannot be read: {why_unread(path, error)}") from None
    memory, seconds = MEMORY + _OF_FILE * size, SECONDS + size / RATE
    allowed = {"memory": memory, "seconds": seconds}
    request = json.dumps({"reader": reader, "path": os.path.abspath(path), **allowed})
    try:
        answer = _CHILD.ask(request.encode(), _BUSY * seconds)
    except ChildDied as died:
        how = str(died)
        if "SIGXCPU" in how:
            how = f"did not answer within {seconds:g} s of computing and was killed"
        raise ParameterError(f"cannot be read: its reader {how}") from None
    if answer[:1] == _ARRAYS:
        with np.load(io.BytesIO(answer[1:]), allow_pickle=False) as arrays:
            return dict(arrays)
    if answer[:1] == _MEMORY:  # a library that got none may be left locked
        _CHILD.end()
        raise ParameterError(f"cannot be read within {memory >> 20} MiB of memory")
    raise ParameterError(answer[1:].decode())


# ------------------------------------------------------------------------- in the child


_LONGEST = 500  # characters of a sentence
_ARRAYS, _SENTENCE, _MEMORY = b"\0", b"\1", b"\2"


def _answer(request: bytes) -> bytes:
    """Arrays of a file, or a sentence that says why there are none."""
    order = json.loads(request)
    module, _, name = order["reader"].partition(":")
    reader = getattr(importlib.import_module(module), name)
    _allow(order["memory"], order["seconds"])
    try:
        buffer = io.BytesIO()
        with warnings.catch_warnings(action="ignore"):
            np.savez(buffer, **reader(Path(order["path"])))
        return _ARRAYS + buffer.getvalue()
    except MemoryError:
        return _MEMORY
    except ParameterError as error:
        text = str(error)
    except Exception as error:  # a damaged file makes a decoder raise nearly anything
        text = f"cannot be read: {error}" if str(error) else f"{type(error).__name__}"
    finally:
        _allow(None)
    return _SENTENCE + " ".join(text.split())[:_LONGEST].encode()


def _allow(memory: int | None, seconds: float = 0.0) -> None:
    """Bound memory and computing that this process may take beyond what it has; None: no
    bound."""
    if not sys.platform.startswith("linux"):
        return
    import resource

    for kind, used in ((resource.RLIMIT_AS, _bytes), (resource.RLIMIT_CPU, time.process_time)):
        _, hard = resource.getrlimit(kind)
        limit = memory if kind == resource.RLIMIT_AS else seconds
        soft = hard if memory is None or limit is None else math.ceil(used() + limit)
        resource.setrlimit(kind, (soft, hard))


def _bytes() -> int:
    """Memory that this process has."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * os.sysconf("SC_PAGE_SIZE")


def main() -> None:
    """Read files until standard input ends."""
    serve(_answer)


_CHILD = Child("from ves_gym._util.reading import main; main()")
