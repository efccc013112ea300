"""Worker processes that survive their jobs: one thread each, and every death has a name.

A worker runs one job at a time over a pipe of its own, so that when it dies it is known which
job was lost. That job alone is tried again, on a new worker; after `deaths` deaths it is given
up and its future raises `WorkerDied`. Processes are spawned, never forked: libraries with
threads do not survive a fork.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import TracebackType
from typing import Any

from ves_gym._util.params import ParameterError

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
_START = 120.0  # s for a process to come up
_STARTS = 5  # processes in a row that may fail to, before that counts as a death
_PAUSE = 0.2  # s longer before each of them
_END = 5.0  # s that an idle process may take to end by itself
# One start at a time, since the environment is the whole process's, and no two threads that
# ask at once how a process ended: only one of them is told.
_BUSY = threading.Lock()

_parent: Connection | None = None  # in a worker: the way back to whoever submitted


class WorkerDied(ChildProcessError):
    """A job was lost with its worker as often as was allowed; `seconds` is its last try's."""

    def __init__(self, message: str, seconds: float = 0.0) -> None:
        super().__init__(message)
        self.seconds = seconds


class JobTimeout(TimeoutError):
    """A job took longer than it may; its worker was killed."""


def note(*words: Any) -> None:
    """Tell whoever submitted the job that runs here something, as in `Workers.submit`.

    Outside a worker it does nothing.
    """
    if _parent is not None:
        _parent.send_bytes(pickle.dumps(("note", words)))


class Workers:
    """Processes that run jobs: `submit` gives a future, leaving the `with` block waits.

    Left by an exception (Ctrl-C among them), running jobs are killed and waiting ones
    cancelled. Functions and arguments are pickled, so the functions are those of a module.

    Args:
        count: processes; each starts with its first job.
        deaths: of its worker after which a job is given up.
        seconds: that a job may take, None for any time; it is killed and not tried again.
        nested: jobs may start `Workers` of their own, which end with theirs.
    """

    def __init__(
        self,
        count: int,
        *,
        deaths: int = 3,
        seconds: float | None = None,
        nested: bool = False,
    ) -> None:
        for name, value in (("workers", count), ("deaths", deaths)):
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise ParameterError(f"{name} must be a whole number >= 1, got {value!r}")
        if seconds is not None and not seconds > 0:
            raise ParameterError(f"seconds per job must be > 0, got {seconds!r}")
        self.deaths, self.seconds, self.nested = deaths, seconds, nested
        self._jobs: deque[_Job] = deque()
        self._change = threading.Condition()
        self.killed = self._over = False
        self._telling = threading.Lock()
        self._posts = [_Post(self) for _ in range(count)]

    def submit(
        self,
        function: Callable[..., Any],
        *args: Any,
        on_note: Callable[..., None] | None = None,
    ) -> Future[Any]:
        """Run `function(*args)` in a worker.

        Args:
            told: called here with the arguments of every `note` that the job sends; never
                for two jobs at once.

        Returns:
            A future with the result, or the job's exception, `WorkerDied` or `JobTimeout`.
        """
        job = _Job(pickle.dumps((function, args)), on_note)
        with self._change:
            if self._over:
                raise RuntimeError("the workers are closed")
            self._jobs.append(job)
            self._change.notify()
        return job.future

    @property
    def pids(self) -> list[int]:
        """Of the processes that are up."""
        processes = [post.process for post in self._posts]
        return [p.pid for p in processes if p is not None and p.pid is not None]

    def close(self, *, kill: bool = False) -> None:
        """Wait for the jobs and end the processes, or end both now."""
        with self._change:
            self._over = True
            self.killed |= kill
            if kill:
                for job in self._jobs:
                    job.future.cancel()
                self._jobs.clear()
            self._change.notify_all()
        if kill:
            for post in self._posts:
                post.kill()
        for post in self._posts:
            post.thread.join()

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, where: TracebackType | None
    ) -> None:
        try:
            self.close(kill=kind is not None)
        except BaseException:  # Ctrl-C while waiting
            self.close(kill=True)
            raise

    # ------------------------------------------------------------- of the posts

    def take(self) -> _Job | None:
        """The next job that nobody cancelled; None when there will be no more."""
        with self._change:
            while True:
                while self._jobs:
                    job = self._jobs.popleft()
                    if job.future.running() or job.future.set_running_or_notify_cancel():
                        return job
                if self._over:
                    return None
                self._change.wait()

    def lost(self, job: _Job, how: str, seconds: float) -> None:
        """Queue a job whose worker died once more, or give it up.

        Args:
            job: what ran, or was to run beside it.
            how: the end of the worker, in words.
            seconds: that the job had run.
        """
        job.deaths += 1
        if self.killed:
            job.future.set_exception(WorkerDied("the workers were stopped", seconds))
        elif job.deaths >= self.deaths:
            times = "once" if job.deaths == 1 else f"{job.deaths} times"
            text = f"its worker died {times} ({how}): given up"
            job.future.set_exception(WorkerDied(text, seconds))
        else:
            with self._change:
                self._jobs.appendleft(job)
                self._change.notify()

    def notify(self, job: _Job, words: tuple[Any, ...]) -> None:
        """Hand a job's note to its listener.

        Args:
            job: that sent the note.
            words: positional arguments of the listener.
        """
        if job.on_note is not None:
            with self._telling:
                job.on_note(*words)


class _NoStart(Exception):
    """No process comes up; the message says how the last one ended."""


class _Job:
    def __init__(self, call: bytes, on_note: Callable[..., None] | None) -> None:
        self.call, self.on_note = call, on_note
        self.future: Future[Any] = Future()
        self.deaths = 0


class _Post:
    """A place for one worker, and the thread that keeps it."""

    def __init__(self, workers: Workers) -> None:
        self.workers = workers
        self.process: SpawnProcess | None = None
        self.pipe: Connection | None = None
        self.thread = threading.Thread(target=self._supervise, daemon=True)
        self.thread.start()

    def kill(self) -> None:
        """End the process now; the thread will notice."""
        process = self.process
        if process is not None:
            with contextlib.suppress(ValueError, AttributeError):  # closed, not yet started
                process.kill()

    def _supervise(self) -> None:
        try:
            while (job := self.workers.take()) is not None:
                try:
                    self._run(job)
                except BaseException as error:  # also of `told`: the job's, not the pool's
                    job.future.set_exception(error)
                    self._end(kill=True)
        finally:
            self._end()

    def _run(self, job: _Job) -> None:
        try:
            pipe, process = self._up()
        except _NoStart as error:
            self.workers.lost(job, str(error), 0.0)
            return
        begin = time.monotonic()
        limit = self.workers.seconds
        allowed = _START  # s until the job's function is loaded, then the limit
        try:
            pipe.send_bytes(job.call)
        except OSError:
            self.workers.lost(job, self._end(), 0.0)
            return
        while True:
            remaining = None if limit is None else max(0.0, begin + allowed - time.monotonic())
            if not wait([pipe, process.sentinel], remaining):
                self._end(kill=True)
                text = f"took longer than {allowed:g} s and was killed"
                job.future.set_exception(JobTimeout(text))
                return
            try:  # what was said before a death counts
                message = pipe.recv_bytes() if pipe.poll() else b""
            except (EOFError, OSError):
                message = b""
            if not message:
                self.workers.lost(job, self._end(), time.monotonic() - begin)
                return
            kind, what = pickle.loads(message)
            if kind == "begun":
                begin, allowed = time.monotonic(), limit or 0.0
            elif kind == "note":
                self.workers.notify(job, what)
            elif kind == "result":
                job.future.set_result(what)
                return
            else:
                job.future.set_exception(what)
                return

    def _up(self) -> tuple[Connection, SpawnProcess]:
        """The running worker, begun anew if there is none."""
        if self.process is not None and self.pipe is not None:
            with _BUSY:
                up = self.process.is_alive()
            if up:
                return self.pipe, self.process
        how = self._end()
        for count in range(_STARTS):
            time.sleep(count * _PAUSE)
            try:
                pipe, process = self._start()
            except OSError as error:  # no memory, too many files
                how = str(error)
                continue
            if self.workers.killed:  # before there was a process to kill
                raise _NoStart(self._end(kill=True))
            if wait([pipe, process.sentinel], _START) and pipe.poll():
                with contextlib.suppress(EOFError, OSError):
                    pipe.recv_bytes()
                    return pipe, process
            how = self._end(kill=True)
        raise _NoStart(f"it does not start, {how}")

    def _start(self) -> tuple[Connection, SpawnProcess]:
        context = multiprocessing.get_context("spawn")
        pipe, there = context.Pipe()
        # daemons, which may have no children: none is left behind should this process end
        # without `close`; nor of the others (`_end_with_parent`), but Python waits for those
        process = context.Process(target=_serve, args=(there,), daemon=not self.workers.nested)
        try:
            with _BUSY, one_thread():
                process.start()
        except BaseException:
            pipe.close()
            raise
        finally:
            there.close()
        self.pipe, self.process = pipe, process
        return pipe, process

    def _end(self, kill: bool = False) -> str:
        """Let the process go, if there is one; how it ended."""
        process, pipe = self.process, self.pipe
        if process is None or pipe is None:
            return ""
        if kill:
            self.kill()
        pipe.close()  # a worker ends when it would read the next job
        wait([process.sentinel], _END)
        with _BUSY:
            if process.is_alive():
                process.kill()
            process.join()
            code = process.exitcode or 0
            self.process = self.pipe = None
            process.close()
        return f"signal {-code}" if code < 0 else f"exit status {code}"


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Processes begun inside use one thread each for linear algebra."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


# ------------------------------------------------------------------------- in a worker


def _serve(pipe: Connection) -> None:
    """Run jobs until there are no more."""
    global _parent
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is the parent's
    threading.Thread(target=_end_with_parent, daemon=True).start()
    pipe.send_bytes(b"")
    _parent = pipe
    while True:
        try:
            call = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            function, args = pickle.loads(call)
            pipe.send_bytes(pickle.dumps(("begun", None)))
            answer = pickle.dumps(("result", function(*args)))
        except BaseException as error:  # `sys.exit` in a job is a failure like another
            answer = pickle.dumps(("error", portable(error)))
        try:
            pipe.send_bytes(answer)
        except OSError:  # nobody is there to hear it
            return


def _end_with_parent() -> None:
    """Leave no orphan that computes for an hour when the parent is killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def portable(error: BaseException) -> BaseException:
    """An exception that can be sent to another process, with where it was raised as a note."""
    trace = "".join(traceback.format_exception(error))
    error = error.with_traceback(None)
    error.__cause__ = error.__context__ = None
    try:
        if not isinstance(pickle.loads(pickle.dumps(error)), Exception):
            raise TypeError
    except Exception:  # of a class that is not made to be pickled, or no `Exception`
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(f"in a worker process:\n{trace}")
    return error
