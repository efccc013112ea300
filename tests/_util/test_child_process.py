"""A process that answers: when it crashes, hangs, never starts or is interrupted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from ves_gym._util import child_process
from ves_gym._util.child_process import Child, ChildDied

ECHO = """
import os, time
from ves_gym._util.child_process import serve
def answer(request):
    if request == b"crash":
        os.kill(os.getpid(), 11)
    if request == b"hang":
        time.sleep(60)
    print("a library's chatter")
    return request + str(os.getpid()).encode()
serve(answer)
"""


def test_a_child_answers_and_is_asked_again():
    child = Child(ECHO)
    first, large = child.ask(b"a", 10.0), b"x" * 5_000_000
    assert first.startswith(b"a") and child.ask(b"a", 10.0) == first  # the same process
    assert child.ask(large, 10.0)[: len(large)] == large
    child.end()
    assert child.ask(b"a", 10.0) != first


@pytest.mark.parametrize(
    ("request_", "said"),
    [(b"crash", "crashed: SIGSEGV"), (b"hang", "did not answer within 0.3 s and was killed")],
)
def test_a_child_that_fails_says_how_and_the_next_one_answers(request_, said):
    """Claim: a crash or a hang costs one request."""
    child = Child(ECHO)
    child.ask(b"a", 10.0)
    with pytest.raises(ChildDied, match=said):
        child.ask(request_, 0.3 if request_ == b"hang" else 10.0)
    assert child.ask(b"b", 10.0).startswith(b"b")


def test_a_child_that_never_comes_up_is_reported(monkeypatch):
    with pytest.raises(ChildDied, match="crashed: exit status 1"):
        Child("raise SystemExit('no such thing')").ask(b"a", 10.0)
    monkeypatch.setattr(child_process, "_START", 0.3)
    with pytest.raises(ChildDied, match="did not answer"):
        Child("import time; time.sleep(60)").ask(b"a", 10.0)


def test_an_interrupted_request_leaves_no_answer_behind(monkeypatch):
    """The next request gets its own answer, not the one nobody waited for."""
    child = Child(ECHO)
    child.ask(b"a", 10.0)

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(child_process.select, "select", interrupt)
        child.ask(b"b", 10.0)
    assert child.ask(b"c", 10.0).startswith(b"c")


def test_a_child_that_nobody_kills_ends_by_itself():
    """Its parent gone while it works, it is stopped by an alarm; idle, by the end of input."""
    for request, ends in ((b"hang", -signal.SIGALRM), (b"", 0)):
        child = subprocess.Popen(
            [sys.executable, "-c", ECHO],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        if request:
            child.stdin.write((1).to_bytes(8, "big") + len(request).to_bytes(8, "big"))
            child.stdin.write(request)
            child.stdin.flush()
        begin = time.monotonic()
        child.communicate(timeout=60) if not request else child.wait(timeout=60)
        assert child.returncode == ends
        assert time.monotonic() - begin < 30
        child.stdin.close()
