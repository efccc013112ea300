"""Compile LLVM text for this processor, and keep the machine code on disk."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ves_gym._util.params import write_bytes

_SIGNATURES = {
    "advance": ctypes.CFUNCTYPE(
        None,
        *[ctypes.c_void_p] * 5,
        *[ctypes.c_int64] * 5,
        ctypes.c_double,
        ctypes.c_int64,
    ),
    "before": ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 2, *[ctypes.c_int64] * 2),
    "after": ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 2, *[ctypes.c_int64] * 2),
    "map": ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3, *[ctypes.c_int64] * 2),
    "program": ctypes.CFUNCTYPE(None, ctypes.c_void_p, *[ctypes.c_int64] * 2),
}
_MARK = b"ves-kernel/1\n"


class Library:
    """Machine code of one module; its functions may be called from several threads at once."""

    advance: Any  # see `emit.emit_module`
    map: Any  # see `emit.emit_map`
    program: Any  # see `pieces.Program`
    before: Any  # see `emit.emit_driver`
    after: Any

    def __init__(self, *codes: bytes) -> None:
        import llvmlite.binding as llvm

        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
        for code in codes:
            self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        for name, signature in _SIGNATURES.items():
            address = self._engine.get_function_address(name)
            if address:
                setattr(self, name, signature(address))

    def address(self, name: str) -> int:
        """Address of a function, as long as the library lives."""
        return int(self._engine.get_function_address(name))


def cache_folder() -> Path:
    """Return the folder of compiled kernels: VES_GYM_CACHE, or the user's cache folder."""
    folder = os.environ.get("VES_GYM_CACHE")
    if folder:
        return Path(folder)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "ves_gym"
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "ves_gym"


def machine() -> str:
    """Describe the processor, on which machine code depends besides its source."""
    import llvmlite
    import llvmlite.binding as llvm

    features = llvm.get_host_cpu_features().flatten()
    return f"{llvmlite.__version__} {llvm.get_host_cpu_name()} {features}"


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


def compile_text(text: str) -> bytes:
    """Object code of a module."""
    import llvmlite.binding as llvm

    target = _target()
    module = llvm.parse_assembly(text)
    module.triple = llvm.get_default_triple()
    module.data_layout = str(target.target_data)
    module.verify()
    code: bytes = target.emit_object(module)
    return code


def cached(key: str, make: Any) -> Library:
    """Return a library from disk, or make it.

    Args:
        key: names everything the code depends on but the processor.
        make: () -> text of the code.
    """
    return Library(_object(key, make))


def linked(driver: str, makers: Mapping[str, Any]) -> Library:
    """Return a library of functions stored one by one and a driver that calls them.

    Args:
        driver: text of the code that calls them.
        makers: name of a function, which names all that it depends on -> () -> its text.
    """
    parts = [_object(name, make) for name, make in makers.items()]
    return Library(_object(driver, lambda: driver), *parts)


def _object(key: str, make: Any) -> bytes:
    """Return machine code from disk, or make it.

    A file that is damaged is made anew. Writing is atomic, so that processes that start
    together at worst compile the same thing twice.

    Args:
        key, make: see `cached`.
    """
    name = hashlib.sha256(f"{key}\0{machine()}".encode()).hexdigest()[:32]
    path = cache_folder() / f"kernel-{name}.o"
    code = _read(path)
    if code is None:
        code = compile_text(make())
        with contextlib.suppress(OSError):  # nowhere to keep it: compiled again next time
            write_bytes(path, _MARK + hashlib.sha256(code).digest() + code)
    return code


def _read(path: Path) -> bytes | None:
    try:
        data = path.read_bytes()
    except OSError:
        return None
    head = len(_MARK) + 32
    code = data[head:]
    complete = data[: len(_MARK)] == _MARK
    return (
        code if complete and hashlib.sha256(code).digest() == data[len(_MARK) : head] else None
    )
