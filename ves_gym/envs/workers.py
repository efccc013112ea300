"""Gymnasium's worker processes, with an end to those that die.

`VesVectorEnv` needs no workers. Where an environment must have a process of its own
(wrappers in Python, another library beside it), Gymnasium's `AsyncVectorEnv` answers a killed
worker with a bare `EOFError` or `BrokenPipeError`, from `close` too, and leaves the others
running. This one names the worker and ends them all.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from multiprocessing.connection import wait
from typing import Any

import gymnasium as gym


class EnvWorkerDied(RuntimeError):
    """A worker process ended by itself; the others have been ended."""


def _guarded(name: str) -> Callable[..., Any]:
    method = getattr(gym.vector.AsyncVectorEnv, name)

    @functools.wraps(method)
    def call(self: AsyncVectorEnv, *args: Any, **kwargs: Any) -> Any:
        try:
            return method(self, *args, **kwargs)
        except (EOFError, ConnectionError) as error:
            raise EnvWorkerDied(self.end()) from error

    return call


class AsyncVectorEnv(gym.vector.AsyncVectorEnv):
    """`gymnasium.vector.AsyncVectorEnv` whose workers' deaths are told; same arguments."""

    reset_async, reset_wait = _guarded("reset_async"), _guarded("reset_wait")
    step_async, step_wait = _guarded("step_async"), _guarded("step_wait")
    call_async, call_wait = _guarded("call_async"), _guarded("call_wait")
    set_attr = _guarded("set_attr")

    def end(self) -> str:
        """End every worker; what became of those that had ended by themselves."""
        ended = wait([process.sentinel for process in self.processes], 1.0)
        gone = []
        for i, process in enumerate(self.processes):
            if process.sentinel in ended:
                process.join()
                gone.append(f"worker {i} (process {process.pid}) ended with {process.exitcode}")
        for process, pipe in zip(self.processes, self.parent_pipes, strict=True):
            process.kill()
            process.join()
            pipe.close()
        self.closed = True
        return (
            f"{'; '.join(gone)}. The other workers have been ended: make a new vector"
            " environment (a negative number is a signal: -9 killed, -11 a crash)"
        )
