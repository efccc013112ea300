"""Worker processes: what is lost with one is tried again, and nothing else is."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError
from multiprocessing import resource_tracker
from pathlib import Path

import pytest

from ves_gym._util.params import ParameterError
from ves_gym._util.process_pool import ONE_THREAD, JobTimeout, WorkerDied, Workers, note

ROOT = Path(__file__).parents[2]


def square(x):
    return x * x


def settings(names):
    return os.getpid(), [os.environ.get(name) for name in names]


def touch(folder, name, seconds=0.0):
    """Leave a trace of every run of a job."""
    with open(Path(folder) / f"{name}", "a") as file:
        file.write(f"{os.getpid()}\n")
    time.sleep(seconds)
    return name


def die_first(folder, name, times):
    """Kill the worker in the first runs of a job."""
    touch(folder, name)
    if len((Path(folder) / name).read_text().splitlines()) <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return name


def hang():
    time.sleep(600)


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
        return threading.Lock()
    raise ParameterError("no good")


def report(count):
    for i in range(count):
        note("at", i)
    return count


def runs(folder, name):
    return len((Path(folder) / name).read_text().splitlines())


def test_jobs_run_in_processes_with_one_thread_each():
    before = dict(os.environ)
    with Workers(2) as workers:
        assert [workers.submit(square, i).result() for i in range(5)] == [0, 1, 4, 9, 16]
        pid, found = workers.submit(settings, list(ONE_THREAD)).result()
        assert pid != os.getpid() and set(found) == {"1"}
    assert dict(os.environ) == before
    assert workers.pids == []
    with pytest.raises(RuntimeError, match="closed"):
        workers.submit(square, 1)


def test_leaving_waits_for_every_job():
    with Workers(2) as workers:
        futures = [workers.submit(square, i) for i in range(20)]
    assert [f.result() for f in futures] == [i * i for i in range(20)]


def test_only_the_lost_job_is_tried_again(tmp_path):
    with Workers(2) as workers:
        good = [workers.submit(touch, tmp_path, f"good-{i}") for i in range(10)]
        lost = workers.submit(die_first, tmp_path, "lost", 2)
        more = [workers.submit(touch, tmp_path, f"more-{i}") for i in range(10)]
        assert lost.result() == "lost"
        names = [f.result() for f in good + more]
    assert runs(tmp_path, "lost") == 3
    assert {runs(tmp_path, name) for name in names} == {1}


def test_a_job_that_kills_its_worker_is_given_up(tmp_path):
    with Workers(2, deaths=2) as workers:
        bad = workers.submit(die_first, tmp_path, "bad", 99)
        good = [workers.submit(touch, tmp_path, f"good-{i}") for i in range(10)]
        with pytest.raises(WorkerDied, match=r"died 2 times \(signal 9\): given up"):
            bad.result()
        assert len([f.result() for f in good]) == 10
    assert runs(tmp_path, "bad") == 2


def test_an_idle_worker_that_died_is_replaced():
    with Workers(1) as workers:
        first, _ = workers.submit(settings, []).result()
        os.kill(first, signal.SIGKILL)
        second, _ = workers.submit(settings, []).result()
    assert first != second


def test_a_job_that_takes_too_long_is_killed(tmp_path):
    begin = time.monotonic()
    with Workers(1, seconds=0.5) as workers:
        slow = workers.submit(hang)
        quick = workers.submit(square, 3)
        with pytest.raises(JobTimeout, match=r"longer than 0\.5 s"):
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
        assert "in a worker process" in caught.value.__notes__[0]
        assert workers.submit(square, 2).result() == 4


def test_notes_come_back_in_order():
    note("to nobody")
    told = []
    with Workers(2) as workers:
        jobs = [
            workers.submit(report, 30, on_note=lambda *words, k=k: told.append((k, *words)))
            for k in range(2)
        ]
        assert [job.result() for job in jobs] == [30, 30]
    for k in range(2):
        assert [i for j, _, i in told if j == k] == list(range(30))


def test_a_listener_that_fails_fails_its_job_alone():
    def listen(*words):
        raise KeyError("listener")

    with Workers(1) as workers:
        with pytest.raises(KeyError, match="listener"):
            workers.submit(report, 3, on_note=listen).result()
        assert workers.submit(square, 2).result() == 4


def test_leaving_by_an_exception_ends_everything(tmp_path):
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Workers(1) as workers:
        running, waiting = workers.submit(hang), workers.submit(square, 1)
        while not workers.pids:
            time.sleep(0.01)
        raise KeyboardInterrupt
    assert time.monotonic() - begin < 20 and workers.pids == []
    assert isinstance(running.exception(), WorkerDied)
    with pytest.raises(CancelledError):
        waiting.result()


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
@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGKILL])
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


@pytest.mark.parametrize("options", [{"count": 0}, {"count": 1, "deaths": 0}])
def test_bad_numbers_are_refused(options):
    with pytest.raises(ParameterError, match="must be a whole number >= 1"):
        Workers(**options)


def test_no_time_at_all_is_refused():
    with pytest.raises(ParameterError, match="must be > 0"):
        Workers(1, seconds=0.0)


def test_workers_that_do_not_start_are_reported(monkeypatch):
    """Not tried for ever: here every process ends before it is up."""
    resource_tracker.ensure_running()  # a process of Python's own that has to start
    monkeypatch.setattr("multiprocessing.spawn.get_executable", lambda: b"/bin/false")
    monkeypatch.setattr("ves_gym._util.process_pool._PAUSE", 0.0)
    with Workers(1, deaths=2) as workers:
        lost = workers.submit(square, 1)
        with pytest.raises(WorkerDied, match=r"2 times \(it does not start, exit status 1\)"):
            lost.result()
