"""Pebble's pool of processes as an `Executor`: one thread each, and none is left behind.

A worker that dies takes one job along, whose future raises `pebble.ProcessExpired`; a job that
takes too long is ended with its worker, and its future raises `TimeoutError`. Processes are
spawned, never forked: libraries with threads do not survive a fork.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from types import TracebackType
from typing import Any

from pebble import ProcessPool
from threadpoolctl import threadpool_limits

from ves_gym._util.own import CALLED, IMPORTED, import_own
from ves_gym._util.params import ParameterError
from ves_gym._util.threads import ONE_THREAD


class Workers(Executor):
    """So many processes that run functions of modules; leaving the `with` block waits for them.

    Left by an exception (Ctrl-C among them), what runs is killed and what waits is dropped. A
    job may take so many seconds, None for any time.
    """

    def __init__(self, count: int, *, seconds: float | None = None) -> None:
        if count < 1:
            raise ParameterError(f"workers must be >= 1, got {count}")
        self.seconds = seconds
        context = multiprocessing.get_context("spawn")
        self._pool: Any = ProcessPool(
            count,
            initializer=_begin,
            initargs=[tuple(IMPORTED), tuple(CALLED)],
            context=context,
        )

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run `function(*args, **kwargs)` in a worker."""
        call = function, args, kwargs
        job: Future[Any] = self._pool.schedule(_run, call, timeout=self.seconds)
        return job

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for the jobs, or end them now."""
        if cancel_futures:
            self._pool.stop()
        else:
            self._pool.close()
        if wait:
            self._pool.join()

    def __exit__(
        self, kind: type[BaseException] | None, error: object, where: TracebackType | None
    ) -> None:
        try:
            self.shutdown(cancel_futures=kind is not None)
        except BaseException:  # Ctrl-C while waiting
            self.shutdown(cancel_futures=True)
            raise


# ------------------------------------------------------------------------- in a worker


def _begin(
    modules: tuple[str, ...], calls: tuple[tuple[Callable[[str], Any], str], ...]
) -> None:
    os.environ.update(ONE_THREAD)
    threadpool_limits(1)  # of the libraries that are loaded already
    end_with_parent()
    for module in modules:
        import_own(module)
    for function, word in calls:
        function(word)


def end_with_parent() -> None:
    """Let this process of `multiprocessing` end when its parent is killed: no orphan stays."""
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _run(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    try:
        return function(*args, **kwargs)
    except BaseException as error:
        raise _portable(error) from None


def _portable(error: BaseException) -> Exception:
    """An exception that can be sent to another process: one that can't ends the whole pool."""
    where = "".join(traceback.format_exception(error))
    sent: Exception = RuntimeError(f"{type(error).__name__}: {error}")
    try:
        copy = pickle.loads(pickle.dumps(error.with_traceback(None)))
    except Exception:
        copy = None
    if isinstance(copy, Exception):  # `sys.exit` in a job is a failure like another
        sent = copy
    sent.add_note(f"in a worker process:\n{where}")
    return sent
