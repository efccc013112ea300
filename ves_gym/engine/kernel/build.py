"""Machine code of LLVM text for this processor, once a process and once on disk.

Every function that the package compiles (`compiled_function`) comes through `code`: one cache
in the process, one folder of files, one key. The key is a digest of the package's text that
code is made from, of what the caller says of the function, and of the processor.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ves_gym._util.params import write_bytes

# rooms and files whose text is traced into graphs, or turns graphs into code; a change of any
# of them compiles everything anew
_SOURCES = (
    "diagnosis/machines/recursions.py",
    "effects",
    "engine/kernel",
    "envs",
    "hardware",
    "mechanics",
    "planners/metric.py",
    "planners/momentum.py",
    "simulation/blocks",
    "system",
)
LANES = 8  # simulations side by side in a vector of compiled code
_MARK = b"ves-code/2\n"
# what compiling raises where it is not possible
NOT_HERE = (ImportError, RuntimeError, OSError)
_RUN = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
# by key: `MachineCode`, or the error where none can be; a GPU's kernel
_functions: dict[str, Any] = {}


@dataclass(frozen=True)
class MachineCode:
    """A compiled `void run(i64 *table, i64 lo, i64 hi)`; threads may call it side by side."""

    run: Callable[[int, int, int], None]
    address: int
    inputs: tuple[int, ...]  # numbers in each argument
    outputs: tuple[int, ...]  # and in each result
    engine: Any  # as long as it lives, so does the code


def once(key: str, make: Callable[[], Any]) -> Any:
    """Return what was made under a key in this process, or make it."""
    if key not in _functions:
        _functions[key] = make()
    return _functions[key]


def digest(description: str) -> str:
    """Return the key of a function: of its description and of the text it comes from."""
    return hashlib.sha256(f"{_source()}\0{description}".encode()).hexdigest()[:32]


def code(key: str, text: Callable[[], str], sizes: Callable[[], Any]) -> MachineCode:
    """Return a function from this process or from disk, or compile it.

    A file that is damaged, or not the user's own, is made anew. Writing is atomic, so that
    processes that start together at worst compile the same thing twice.

    Args:
        key: a `digest`.
        text: () -> LLVM text that defines `run`.
        sizes: () -> numbers in each argument, and in each result.

    Raises:
        ImportError, RuntimeError, OSError: nothing compiles here.
    """
    result: MachineCode | Exception = once(key, lambda: _built(key, text, sizes))
    if isinstance(result, Exception):
        raise result
    return result


def _built(
    key: str, text: Callable[[], str], sizes: Callable[[], Any]
) -> MachineCode | Exception:
    try:
        name = hashlib.sha256(f"{key} {machine()}".encode()).hexdigest()[:32]
        folder = _own_folder()
        stored = None if folder is None else _read(folder / f"{name}.code")
        if stored is not None:
            return _loaded(stored)
    except NOT_HERE as error:
        return error
    head, traced = json.dumps(sizes()).encode(), text()  # a fault of the text itself is raised
    try:
        stored = head + b"\n" + compile_text(traced)
        if folder is not None:
            with contextlib.suppress(OSError):  # no room to keep it: compiled again next time
                write_bytes(folder / f"{name}.code", _mark(name, stored) + stored, private=True)
        return _loaded(stored)
    except NOT_HERE as error:
        return error


def cache_folder() -> Path:
    """Return the folder of compiled functions: VES_GYM_CACHE, or the user's cache folder.

    Raises:
        RuntimeError: the user has no home.
    """
    folder = os.environ.get("VES_GYM_CACHE")
    if folder:
        return Path(folder)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "ves_gym"
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "ves_gym"


def _own_folder() -> Path | None:
    """The cache folder, made if need be; None where others could put code into it.

    What lies there is run. So folder and files must be the user's own, and no one else may be
    able to write to them.
    """
    try:
        folder = cache_folder()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if _is_private(folder.stat()):
            return folder
    except (OSError, RuntimeError):
        return None
    _warn_of(folder)
    return None


def _is_private(about: os.stat_result) -> bool:
    """True if a file or folder is this user's, and others can't write to it."""
    if not hasattr(os, "getuid"):  # Windows: a profile's folders are
        return True
    return about.st_uid == os.getuid() and not about.st_mode & 0o022


@lru_cache(maxsize=1)
def _warn_of(folder: Path) -> None:
    warnings.warn(
        f"compiled code is not stored: {folder} belongs to another user, or others can write to"
        f" it; `chmod 700 {folder}`, or set VES_GYM_CACHE to a folder of your own",
        RuntimeWarning,
        stacklevel=2,
    )


@lru_cache(maxsize=1)
def machine() -> str:
    """Describe the processor, on which machine code depends besides its source."""
    import llvmlite
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features().flatten()
    return f"{llvmlite.__version__} {llvm.get_host_cpu_name()} {features}"


def compile_text(text: str) -> bytes:
    """Object code of a module."""
    import llvmlite.binding as llvm

    target = _target()
    module = llvm.parse_assembly(text)
    module.triple = llvm.get_default_triple()
    module.data_layout = str(target.target_data)
    module.verify()
    object_code: bytes = target.emit_object(module)
    return object_code


@lru_cache(maxsize=1)
def _source() -> str:
    """Digest of the text that functions come from."""
    root = Path(__file__).parents[2]
    total = hashlib.sha256()
    for name in _SOURCES:
        at = root / name
        for path in sorted(at.rglob("*.py")) if at.is_dir() else [at]:
            total.update(path.read_bytes())
    return total.hexdigest()


def _loaded(stored: bytes) -> MachineCode:
    import llvmlite.binding as llvm

    head, _, object_code = stored.partition(b"\n")
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
    engine.add_object_file(llvm.ObjectFileRef.from_data(object_code))
    engine.finalize_object()
    address = engine.get_function_address("run")
    inputs, outputs = map(tuple, json.loads(head))
    return MachineCode(_RUN(address), address, inputs, outputs, engine)


def _target() -> Any:
    import llvmlite.binding as llvm

    with contextlib.suppress(RuntimeError):  # newer llvmlite does it itself and refuses
        llvm.initialize()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=2,
        jit=True,
    )


def _mark(name: str, stored: bytes) -> bytes:
    """Return a file's first bytes: they show damage, and a file made for another name."""
    return _MARK + hashlib.sha256(name.encode() + stored).digest()


def _read(path: Path) -> bytes | None:
    """Return the content of an intact file of this user, None of any other."""
    try:
        with path.open("rb") as file:
            if not _is_private(os.fstat(file.fileno())):
                return None
            data = file.read()
    except OSError:
        return None
    stored = data[len(_MARK) + 32 :]
    return stored if data.startswith(_mark(path.stem, stored)) else None
