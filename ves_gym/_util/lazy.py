"""Names of a package that are imported when they are first asked for (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazily(
    package: str, homes: Mapping[str, str], modules: tuple[str, ...] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package that imports its names on first use.

    Args:
        package: its `__name__`.
        homes: name -> "module" below the package, or "module:name" where it is called
            otherwise there.
        modules: modules of the package that are attributes themselves.

    Returns:
        The two functions; a name once resolved is an ordinary attribute of the package.
    """

    def resolve(name: str) -> Any:
        if name in homes:
            module, _, there = homes[name].partition(":")
            value = getattr(import_module(f"{package}.{module}"), there or name)
        elif name in modules:
            value = import_module(f"{package}.{name}")
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes, *modules})

    return resolve, names
