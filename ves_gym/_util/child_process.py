"""A process of its own that answers requests: what crashes or hangs there takes nothing along.

Requests and answers are bytes, each behind its length. The child is started when it is first
asked, and anew after it has died; it ends when its standard input does, so that none is left
behind. A forked process starts its own.
"""

from __future__ import annotations

import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable

from ves_gym._util.threads import ONE_THREAD

_START = 120.0  # s for a child to come up, on a busy machine
_ORPHAN = 60.0  # s beyond its time after which a child whose parent is gone ends by itself
_LENGTH = 8  # bytes


class ChildDied(Exception):
    """A child gave no answer; the message says how it ended."""


class Child:
    """A process that runs the Python text of a program that calls `serve`."""

    def __init__(self, program: str) -> None:
        self.program = program
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0  # process that started it
        self._lock = threading.Lock()

    def ask(self, request: bytes, seconds: float) -> bytes:
        """Return the child's answer; it has `seconds` for it, its start not counted.

        Raises:
            ChildDied: it crashed, or did not answer in time and was killed.
        """
        with self._lock:
            process, answer = self._process, None
            try:
                if process is None or self._owner != os.getpid():
                    process = self._start()
                    _read(process, 1, _START)  # it is up
                answer = _exchange(process, request, seconds)
            except TimeoutError:
                raise ChildDied(f"did not answer within {seconds:g} s and was killed") from None
            except (EOFError, OSError):
                raise ChildDied(f"crashed: {self.end()}") from None
            finally:
                if answer is None:  # or the next request would get this one's answer
                    self.end()
            return answer

    def _start(self) -> subprocess.Popen[bytes]:
        """A new child; what it complains of is read where this process complains."""
        paths = os.pathsep.join(p or os.getcwd() for p in sys.path)
        process = subprocess.Popen(
            [sys.executable, "-c", self.program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": paths, **ONE_THREAD},
        )
        self._stop = weakref.finalize(self, _stop, process)
        self._process, self._owner = process, os.getpid()
        return process

    def end(self) -> str:
        """End the child, if there is one, and say how it had ended."""
        process, self._process = self._process, None
        if process is None:
            return "not started"
        try:  # one that crashed is still about to end
            code = process.wait(timeout=1.0)
            how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        except subprocess.TimeoutExpired:
            how = "killed"
        self._stop()
        return how


def _exchange(process: subprocess.Popen[bytes], request: bytes, seconds: float) -> bytes:
    assert process.stdin is not None
    end = time.monotonic() + seconds
    alarm = math.ceil(min(seconds + _ORPHAN, 1e9)).to_bytes(_LENGTH, "big")
    process.stdin.write(alarm + len(request).to_bytes(_LENGTH, "big") + request)
    process.stdin.flush()
    size = int.from_bytes(_read(process, _LENGTH, seconds), "big")
    return _read(process, size, end - time.monotonic())


def _read(process: subprocess.Popen[bytes], count: int, seconds: float) -> bytes:
    """Return so many bytes of what a child says, TimeoutError where they do not come."""
    assert process.stdout is not None
    end, file, parts = time.monotonic() + seconds, process.stdout.fileno(), []
    while count:
        if not select.select([file], [], [], max(0.0, end - time.monotonic()))[0]:
            raise TimeoutError
        part = os.read(file, min(count, 1 << 20))
        if not part:
            raise EOFError
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.communicate()


def serve(answer: Callable[[bytes], bytes]) -> None:
    """Answer requests until standard input ends: the program of a child."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is not an answer
    answers.write(b"\n")
    answers.flush()
    while head := requests.read(2 * _LENGTH):
        alarm, size = (int.from_bytes(k, "big") for k in (head[:_LENGTH], head[_LENGTH:]))
        signal.alarm(alarm)
        out = answer(requests.read(size))
        signal.alarm(0)
        answers.write(len(out).to_bytes(_LENGTH, "big") + out)
        answers.flush()
