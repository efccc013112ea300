"""The compiler of this package's loops: numba, results kept on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit  # type: ignore[import-not-found,import-untyped,unused-ignore]

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile for the argument types it is called with; errors divide as NumPy's do."""
    return cast("F", njit(cache=True, error_model="numpy")(function))
