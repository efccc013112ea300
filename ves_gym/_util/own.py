"""What a user adds: modules imported before names are looked up, and registered names."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType

from ves_gym._util.params import ParameterError

IMPORTED: list[str] = []  # that processes begun later, and commands said to be next, need too


def import_own(name: str) -> ModuleType:
    """Import a module, package.module as `python -m` finds it or a .py file, so that what it
    registers goes by its name from here on."""
    file = Path(name).absolute()
    is_file = file.suffix == ".py"
    # last: a file here called like a module of Python's is not in its way
    sys.path.append(str(file.parent if is_file else Path.cwd()))
    module = file.stem if is_file else name
    try:
        loaded = importlib.import_module(module)
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        where = f"{Path(frames[-1].filename).name}, line {frames[-1].lineno}"
        inside = "importlib" not in frames[-1].filename
        raise ParameterError(
            f"cannot import {name}: {type(error).__name__}: {error}"
            f"{f' ({where})' if inside else ''}"
        ) from error
    there = loaded.__file__ or os.devnull
    if is_file and not os.path.samefile(there, file):
        raise ParameterError(f"cannot import {name}: {module} is {there}; rename the file")
    return loaded


def require_free(name: str, what: str, new: type, old: type | None) -> None:
    """Refuse to file a new class under a name that another has; `what` says as what, such as
    "planner".

    A script's or notebook's own class may be defined again, as when a cell is run twice.
    """
    rerun = old is not None and new.__module__ == "__main__" == old.__module__
    if old is not None and not (rerun and new.__qualname__ == old.__qualname__):
        raise ParameterError(f"{what} {name!r} is already registered by {old.__name__}")
