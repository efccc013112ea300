"""Linear algebra on one thread: a sum split among several ends in other bits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module

from threadpoolctl import ThreadpoolController


@contextmanager
def on_one_thread(scipy: bool = True) -> Iterator[None]:
    """Run what is inside, or a function so decorated, on one thread of linear algebra.

    Args:
        scipy: SciPy's too; False where NumPy's is all there is, which spares an import.
    """
    if scipy:  # it has a BLAS of its own, which is limited only once it is there
        import_module("scipy.linalg")
    with _threads(scipy).limit(limits=1, user_api="blas"):
        yield


@cache
def _threads(scipy: bool) -> ThreadpoolController:
    return ThreadpoolController()
