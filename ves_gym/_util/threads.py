"""Linear algebra on one thread: a sum split among several ends in other bits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module

from threadpoolctl import ThreadpoolController

# Numerical libraries read these when they are loaded; torch takes the first.
ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
    ),
    "1",
)


@contextmanager
def on_one_thread(scipy: bool = True) -> Iterator[None]:
    """Run what is inside, or a function so decorated, on one thread of linear algebra; SciPy's
    too, unless NumPy's is all there is, which spares an import."""
    if scipy:  # it has a BLAS of its own, which is limited only once it is there
        import_module("scipy.linalg")
    with _threads(scipy).limit(limits=1, user_api="blas"):
        yield


@cache
def _threads(scipy: bool) -> ThreadpoolController:
    return ThreadpoolController()
