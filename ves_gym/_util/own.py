"""What a user adds: modules imported before names are looked up, objects, registered names."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import traceback
from collections.abc import Callable, Collection, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean

IMPORTED: list[str] = []  # that processes begun later, and commands said to be next, need too
CALLED: list[tuple[Callable[[str], Any], str]] = []  # functions that those processes call


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


def own_object(text: str, names: Collection[str] = (), group: str = "") -> Any:
    """Return the object that a word of the command line names, or the word where it is one.

    The word of a file never comes here: nothing that is read is run.

    Args:
        text: `module:Name`, the module as `import_own` takes it; a class is made into an
            object. Any other word is returned as it is.
        names: that mean something already, before a colon, too.
        group: entry points `ves_gym.GROUP` of installed packages, whose names are taken, too.

    Raises:
        ParameterError: no such module or name, or a class that needs arguments.
    """
    if text.partition(":")[0] in names:
        return text
    entries = {k.name: k.value for k in installed(group)} if group and ":" not in text else {}
    module, _, name = entries.get(text, text).rpartition(":")
    if not (module and name.isidentifier()):
        return text
    objects = vars(import_own(module))
    if name not in objects:
        raise ParameterError(f"{module} has nothing called {name}{did_you_mean(name, objects)}")
    if not isinstance(objects[name], type):
        return objects[name]
    try:
        return objects[name]()
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise ParameterError(f"{text} cannot be made without arguments: {why}") from error


def installed(group: str) -> Collection[Any]:
    """Return the entry points that installed packages have in `ves_gym.GROUP`."""
    return entry_points(group=f"ves_gym.{group}")


def require_interface(
    what: str, thing: object, texts: Sequence[str], **methods: Sequence[str]
) -> None:
    """Refuse an object without these texts as attributes, or methods of these arguments."""
    if isinstance(thing, type):
        raise ParameterError(f"a {what} is an object, got a class: write {thing.__name__}()")

    def has(part: str) -> bool:
        value = getattr(thing, part, None)
        if part in texts:
            return isinstance(value, str)
        try:
            return callable(value) and bool(inspect.signature(value).bind(*methods[part]))
        except TypeError:
            return False

    needed = {k: k for k in texts} | {k: f"{k}({', '.join(v)})" for k, v in methods.items()}
    for part, form in needed.items():
        if not has(part):
            *first, last = needed.values()
            raise ParameterError(
                f"a {what} needs {', '.join(first)} and {last}, got"
                f" {type(thing).__name__} without {form}"
            )


def require_free(name: str, what: str, new: type, old: type | None) -> None:
    """Refuse to file a new class under a name that another has; `what` says as what, such as
    "planner".

    A script's or notebook's own class may be defined again, as when a cell is run twice.
    """
    rerun = old is not None and new.__module__ == "__main__" == old.__module__
    if old is not None and not (rerun and new.__qualname__ == old.__qualname__):
        raise ParameterError(f"{what} {name!r} is already registered by {old.__name__}")
