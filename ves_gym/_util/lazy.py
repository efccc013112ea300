"""Names of a package that are imported on first use (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any


def lazily(package: str, homes: Mapping[str, str], modules: tuple[str, ...] = ()) -> None:
    """Let a package import its names on first use; then they are ordinary attributes of it.

    The functions are set here, not named in the package: a type checker that saw its
    `__getattr__` would take every misspelt name for one of the package's.

    A name's home is "module" below the package, or "module:name" where it is called otherwise
    there; `modules` are attributes themselves.
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

    vars(sys.modules[package]).update(__getattr__=resolve, __dir__=names)
