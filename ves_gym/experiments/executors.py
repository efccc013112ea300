"""Where units run: one surface, `submit -> Future`, over processes, Slurm, Dask and Ray.

A future ends with the job's result, its exception, `WorkerDied` where the job was lost as often
as was allowed, or `JobTimeout`.
"""

from __future__ import annotations

import faulthandler
import logging
import math
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

from ves_gym._util.optional import require
from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import JobTimeout, WorkerDied, Workers, one_thread, portable
from ves_gym._util.suggest import did_you_mean

EXECUTORS = ("local", "slurm", "submitit-local", "dask", "ray")
_POLL = 0.2  # s between looks at submitit's jobs
_FOREVER = 60 * 24 * 365  # minutes
_ASK = 1.0  # s between questions how many threads a Dask cluster has
_SLACK = 10.0  # s after a job's limit at which submitit ends it, if it has not ended itself


class Executor(Protocol):
    """Runs jobs."""

    shares_files: bool  # whether jobs can write into this machine's folders

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        """Run `function(*args)` somewhere."""


def open_executor(
    name: str,
    *,
    workers: int,
    folder: Path,
    seconds: float | None = None,
    deaths: int = 3,
    address: str | None = None,
    slurm: dict[str, Any] | None = None,
) -> AbstractContextManager[Executor]:
    """An executor by name, to be used in a `with` block.

    Args:
        workers: processes or jobs at once; of a running cluster, its own number counts.
        folder: for the files of submitit.
        seconds: that a job may take.
        deaths: after which a job is given up.
        address: of a Dask scheduler (tcp://...) or a Ray cluster; default one started here.
        slurm: parameters of submitit's Slurm executor, such as `slurm_partition`.
    """
    if name not in EXECUTORS:
        raise ParameterError(
            f"executor must be one of {', '.join(EXECUTORS)}, got {name!r}"
            f"{did_you_mean(name, EXECUTORS)}"
        )
    if workers < 1:
        raise ParameterError(f"workers must be >= 1, got {workers}")
    if address is not None and name not in ("dask", "ray"):
        raise ParameterError(f"an address belongs to dask and ray, got {name} and {address}")
    if slurm and name != "slurm":
        raise ParameterError(f"parameters of Slurm belong to slurm, got {name}")
    if name == "local":
        return _local(workers, seconds, deaths)
    if name == "dask":
        return _dask(workers, seconds, deaths, address)
    if name == "ray":
        return _ray(workers, seconds, deaths, address)
    return _submitit(name, workers, folder, seconds, deaths, slurm or {})


def answer(
    seconds: float | None, function: Callable[..., Any], args: tuple[Any, ...]
) -> tuple[Any, BaseException | None]:
    """A job's result or its exception, run where nobody else ends it when it takes too long.

    A thread that needs no interpreter lock then ends the process.
    """
    if seconds is not None:
        assert sys.__stderr__ is not None
        faulthandler.dump_traceback_later(seconds, exit=True, file=sys.__stderr__)
    try:
        return function(*args), None
    except Exception as error:
        return None, portable(error)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _settle(future: Future[Any], outcome: tuple[Any, BaseException | None]) -> None:
    """End a future as `answer` says."""
    result, error = outcome
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)


class _Pool:
    """Processes of this machine."""

    shares_files = True

    def __init__(self, workers: Workers) -> None:
        self.submit = workers.submit


@contextmanager
def _local(workers: int, seconds: float | None, deaths: int) -> Iterator[Executor]:
    with Workers(workers, seconds=seconds, deaths=deaths) as pool:
        yield _Pool(pool)


# ----------------------------------------------------------------------------- submitit


@contextmanager
def _submitit(
    name: str,
    workers: int,
    folder: Path,
    seconds: float | None,
    deaths: int,
    slurm: dict[str, Any],
) -> Iterator[Executor]:
    require(f"executor {name}", "submitit")
    import submitit

    jobs = folder / "jobs"
    if name == "slurm":
        if submitit.SlurmExecutor.affinity() < 0:
            raise ParameterError("executor slurm needs srun, which is not on this machine")
        inner: Any = submitit.AutoExecutor(folder=jobs, cluster="slurm")
        inner.update_parameters(cpus_per_task=1, tasks_per_node=1, nodes=1)
        inner.update_parameters(**slurm)
    else:
        inner = submitit.LocalExecutor(folder=jobs)
    if seconds is not None:
        inner.update_parameters(timeout_min=math.ceil((seconds + _SLACK) / 60))
    elif name != "slurm":
        inner.update_parameters(timeout_min=_FOREVER)
    elif "timeout_min" not in slurm:
        raise ParameterError(
            "executor slurm needs a time for its jobs: `seconds` in the sweep's file, or"
            " timeout_min among the parameters of Slurm"
        )
    queue = _Jobs(inner, workers, seconds, deaths, local=name != "slurm")
    try:
        yield queue
        queue.finish()
    finally:
        queue.stop()


class _Ticket:
    def __init__(self, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
        self.function, self.args = function, args
        self.future: Future[Any] = Future()
        self.deaths = 0
        self.begin = 0.0


class _Jobs:
    """Jobs of submitit, so many at once, watched by a thread; lost ones are tried again."""

    shares_files = True

    def __init__(
        self, inner: Any, count: int, seconds: float | None, deaths: int, local: bool
    ) -> None:
        self.inner, self.count, self.seconds, self.deaths = inner, count, seconds, deaths
        self.local = local
        self.waiting: deque[_Ticket] = deque()
        self.running: list[tuple[_Ticket, Any]] = []
        self.change = threading.Condition()
        self.over = self.stopped = False
        self.thread = threading.Thread(target=self._watch, daemon=True)
        self.thread.start()

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        """See `Executor`."""
        ticket = _Ticket(function, args)
        with self.change:
            self.waiting.append(ticket)
            self.change.notify()
        return ticket.future

    def finish(self) -> None:
        """Wait for every job."""
        with self.change:
            self.over = True
            self.change.notify()
        self.thread.join()

    def stop(self) -> None:
        """End every job that is left."""
        self.stopped = True
        self.finish()
        for ticket in self.waiting:
            ticket.future.cancel()
        for _, job in self.running:
            job.cancel(check=False)

    def _watch(self) -> None:
        while not self.stopped:
            with self.change:
                while not (self.waiting or self.running or self.over):
                    self.change.wait()
                if self.over and not (self.waiting or self.running):
                    return
                while self.waiting and len(self.running) < self.count:
                    self._begin(self.waiting.popleft())
            time.sleep(_POLL)
            done = [pair for pair in self.running if pair[1].done()]
            self.running = [pair for pair in self.running if pair not in done]
            for ticket, job in done:
                self._end(ticket, job)

    def _begin(self, ticket: _Ticket) -> None:
        if not (ticket.future.running() or ticket.future.set_running_or_notify_cancel()):
            return
        ticket.begin = time.monotonic()
        try:
            with one_thread():
                job = self.inner.submit(answer, self.seconds, ticket.function, ticket.args)
        except BaseException as error:
            ticket.future.set_exception(error)
        else:
            self.running.append((ticket, job))

    def _end(self, ticket: _Ticket, job: Any) -> None:
        from submitit.core.utils import UncompletedJobError

        took = time.monotonic() - ticket.begin
        try:
            if self.local and not job.paths.result_pickle.exists():
                raise UncompletedJobError("left no result")  # `result` waits for one for 15 s
            _settle(ticket.future, job.result())
        except UncompletedJobError:
            if self.seconds is not None and took > self.seconds:
                text = f"took longer than {self.seconds:g} s and was killed"
                ticket.future.set_exception(JobTimeout(text))
                return
            ticket.deaths += 1
            if ticket.deaths < self.deaths:
                with self.change:
                    self.waiting.appendleft(ticket)
                return
            text = f"its job died {ticket.deaths} times: given up"
            ticket.future.set_exception(WorkerDied(text, took))
        except Exception as error:
            ticket.future.set_exception(error)


# --------------------------------------------------------------------------------- dask


class _Dask:
    """As many jobs at a time as the cluster has threads.

    When a worker dies, the scheduler blames every job it had sent there: so none waits there,
    and on a cluster of our own a lost job comes back to us before it is sent anywhere else.
    """

    shares_files = False  # workers may be on any machine

    def __init__(self, client: Any, seconds: float | None, deaths: int) -> None:
        self.client, self.seconds, self.deaths = client, seconds, deaths
        self.waiting: deque[_Ticket] = deque()
        self.running = self.threads = 0
        self.last_asked = -math.inf  # when the number of threads was
        self.change = threading.Lock()
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._watch, daemon=True)
        self.thread.start()

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        """See `Executor`."""
        ticket = _Ticket(function, args)
        self.waiting.append(ticket)
        self._fill()
        return ticket.future

    def stop(self) -> None:
        """Send no more jobs."""
        self.over.set()
        self.thread.join()
        for ticket in self.waiting:
            ticket.future.cancel()

    def _watch(self) -> None:
        while not self.over.wait(_ASK):  # for workers that have come, or come back
            if self.waiting:
                self._fill()

    def _fill(self) -> None:
        with self.change:
            if time.monotonic() - self.last_asked > _ASK:
                self.threads = sum(self.client.nthreads().values())
                self.last_asked = time.monotonic()
            while self.waiting and self.running < max(1, self.threads):
                ticket = self.waiting.popleft()
                if ticket.future.running() or ticket.future.set_running_or_notify_cancel():
                    call = answer, self.seconds, ticket.function, ticket.args
                    inner = self.client.submit(*call, pure=False)
                    self.running += 1
                    inner.add_done_callback(lambda done, entry=ticket: self._end(entry, done))

    def _end(self, ticket: _Ticket, done: Any) -> None:
        from distributed import KilledWorker

        with self.change:
            self.running -= 1
        try:
            error = done.exception()
            if error is None:
                _settle(ticket.future, done.result())
            elif isinstance(error, KilledWorker):
                self.last_asked = -math.inf
                ticket.deaths += 1
                if ticket.deaths < self.deaths:
                    self.waiting.appendleft(ticket)
                else:
                    ticket.future.set_exception(_lost(self.seconds))
            else:
                ticket.future.set_exception(error)
            self._fill()
        except BaseException as lost:  # the scheduler is gone, or the job was cancelled
            text = f"the cluster lost it: {lost or type(lost).__name__}"
            for affected in (ticket, *self.waiting):
                if not affected.future.done():
                    affected.future.set_exception(WorkerDied(text))


def _lost(seconds: float | None) -> WorkerDied:
    """Of a cluster that tells only that a job ended its workers, not how."""
    limit = "" if seconds is None else f", or it took longer than {seconds:g} s"
    return WorkerDied(f"its worker died as often as allowed{limit}: given up")


@contextmanager
def _dask(
    workers: int, seconds: float | None, deaths: int, address: str | None
) -> Iterator[Executor]:
    require("executor dask", "distributed")
    import dask
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        if address is None:
            # a death is told at once; a running cluster tells it after some tries of its own
            stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 0}))
            place: Any = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",  # any free port
                    silence_logs=logging.CRITICAL,  # a death is told by its job
                )
            )
        else:
            place, deaths = address, 1
        try:
            client = stack.enter_context(Client(place, timeout=30))
        except (OSError, ValueError) as error:
            raise ParameterError(f"no Dask scheduler at {address}: {error}") from None
        pool = _Dask(client, seconds, deaths)
        stack.callback(pool.stop)
        yield pool


# ---------------------------------------------------------------------------------- ray


class _Ray:
    shares_files = False

    def __init__(self, ray: Any, seconds: float | None, deaths: int) -> None:
        self.ray = ray
        variables = {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        with one_thread():
            variables |= {k: v for k, v in os.environ.items() if k.endswith("_NUM_THREADS")}
        self.remote = ray.remote(answer).options(
            max_retries=deaths - 1, num_cpus=1, runtime_env={"env_vars": variables}
        )
        self.seconds = seconds

    def submit(self, function: Callable[..., Any], *args: Any) -> Future[Any]:
        """See `Executor`."""
        inner = self.remote.remote(self.seconds, function, args).future()
        out: Future[Any] = Future()
        out.set_running_or_notify_cancel()
        inner.add_done_callback(lambda done: self._end(out, done))
        return out

    def _end(self, out: Future[Any], done: Future[Any]) -> None:
        errors, error = self.ray.exceptions, done.exception()
        if error is None:
            _settle(out, done.result())
        elif isinstance(error, errors.WorkerCrashedError | errors.NodeDiedError):
            out.set_exception(_lost(self.seconds))
        else:
            out.set_exception(error)


@contextmanager
def _ray(
    workers: int, seconds: float | None, deaths: int, address: str | None
) -> Iterator[Executor]:
    require("executor ray", "ray")
    import ray

    local = {} if address is not None else {"num_cpus": workers, "include_dashboard": False}
    ray.init(address=address, log_to_driver=False, **local)
    try:
        yield _Ray(ray, seconds, deaths)
    finally:
        ray.shutdown()
