"""Modules that a room needs on first use and that lie above it in the import picture.

The front door (`ves_gym/__init__.py`) says what to load under which name; the room asks for
the name. So the library of effects, and the drawing of results, is loaded by whoever uses it,
and `import ves_gym` stays light.
"""

from __future__ import annotations

from collections.abc import Callable

LOADERS: dict[str, Callable[[], object]] = {}


def load(name: str) -> None:
    """Run the loader filed under a name, once; nothing where there is none."""
    loader = LOADERS.pop(name, None)
    if loader is not None:
        loader()
