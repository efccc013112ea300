"""Worker processes: a job that dies or hangs costs itself, and no process is left behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pebble import ProcessExpired

from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import Workers
from ves_gym._util.threads import ONE_THREAD

ROOT = Path(__file__).parents[2]


def square(x):
    return x * x


def settings(names):
    import numpy  # noqa: F401
    from threadpoolctl import threadpool_info

    threads = {library["num_threads"] for library in threadpool_info()}
    return os.getpid(), [os.environ.get(name) for name in names], threads


def touch(folder, name, seconds=0.0):
    """Leave a trace of every run of a job."""
    with open(Path(folder) / f"{name}", "a") as file:
        file.write(f"{os.getpid()}\n")
    time.sleep(seconds)
    return name


def die(folder, name):
    touch(folder, name)
    os.kill(os.getpid(), signal.SIGKILL)


def hang():
    time.sleep(600)


def nest(x):
    with Workers(1) as workers:
        return workers.submit(square, x).result()


class Odd(Exception):
    """Cannot be unpickled: its arguments are not those of its constructor."""

    def __init__(self, a, b):
        super().__init__(f"{a} and {b}")


def fail(how):
    if how == "odd":
        raise Odd(1, 2)
    if how == "exit":
        sys.exit(3)
    if how == "open":
        return open(os.devnull)
    raise ParameterError("no good")


def test_jobs_run_in_processes_with_one_thread_each():
    before = dict(os.environ)
    with Workers(2) as workers:
        assert list(workers.map(square, range(5))) == [0, 1, 4, 9, 16]
        pid, found, threads = workers.submit(settings, list(ONE_THREAD)).result()
        assert pid != os.getpid() and set(found) == {"1"} and threads == {1}
    assert dict(os.environ) == before
    with pytest.raises(RuntimeError, match="not active"):
        workers.submit(square, 1)


def test_a_job_that_kills_its_worker_costs_itself(tmp_path):
    with Workers(2) as workers:
        first = [workers.submit(touch, tmp_path, f"first-{i}") for i in range(10)]
        bad = workers.submit(die, tmp_path, "bad")
        more = [workers.submit(touch, tmp_path, f"more-{i}") for i in range(10)]
        with pytest.raises(ProcessExpired) as caught:
            bad.result()
        assert caught.value.exitcode == -signal.SIGKILL
        names = [job.result() for job in first + more]
    assert len(names) == 20
    assert all(len((tmp_path / n).read_text().splitlines()) == 1 for n in (*names, "bad"))


def test_a_job_that_takes_too_long_is_killed():
    begin = time.monotonic()
    with Workers(1, seconds=0.5) as workers:
        slow, quick = workers.submit(hang), workers.submit(square, 3)
        with pytest.raises(TimeoutError):
            slow.result()
        assert quick.result() == 9
    assert time.monotonic() - begin < 20


@pytest.mark.parametrize(
    ("how", "kind", "message"),
    [
        ("parameter", ParameterError, "no good"),
        ("odd", RuntimeError, "Odd: 1 and 2"),
        ("exit", RuntimeError, "SystemExit: 3"),
        ("open", TypeError, "pickle"),
    ],
)
def test_an_exception_comes_back_with_where_it_was_raised(how, kind, message):
    with Workers(1) as workers:
        with pytest.raises(kind, match=message) as caught:
            workers.submit(fail, how).result()
        if how != "open":
            assert "in a worker process" in caught.value.__notes__[0]
        assert workers.submit(square, 2).result() == 4


def test_a_job_may_have_workers_of_its_own():
    with Workers(1) as workers:
        assert workers.submit(nest, 3).result() == 9


def test_leaving_by_an_exception_ends_everything(tmp_path):
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Workers(1) as workers:
        workers.submit(touch, tmp_path, "running", 600.0)
        workers.submit(touch, tmp_path, "waiting")
        while not (tmp_path / "running").exists():
            time.sleep(0.01)
        raise KeyboardInterrupt
    assert time.monotonic() - begin < 20
    assert not (tmp_path / "waiting").exists()


PROGRAM = """
import signal, sys, time
# a shell that starts tests in the background has them ignore Ctrl-C
signal.signal(signal.SIGINT, signal.default_int_handler)
from tests._util.test_process_pool import touch
from ves_gym._util.process_pool import Workers
if __name__ == "__main__":
    with Workers(2) as workers:
        for i in range(2):
            workers.submit(touch, sys.argv[1], f"job-{i}", 600.0)
        print("ready", flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    "kill", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_workers_end_with_their_parent(tmp_path, kill):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    parent = subprocess.Popen(
        [sys.executable, str(program), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    jobs = [tmp_path / "job-0", tmp_path / "job-1"]
    deadline = time.monotonic() + 60
    while not all(job.exists() and job.read_text() for job in jobs):
        assert time.monotonic() < deadline and parent.poll() is None
        time.sleep(0.02)
    pids = [int(job.read_text().split()[0]) for job in jobs]
    parent.send_signal(kill)
    parent.communicate(timeout=30)
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_no_worker_at_all_is_refused():
    with pytest.raises(ParameterError, match="workers must be >= 1"):
        Workers(0)
