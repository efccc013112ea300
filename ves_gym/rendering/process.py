"""A drawing process: a module of this package under a given OpenGL, watched.

A broken OpenGL may hang or abort, so nothing is ever drawn in the user's own process.
"""

from __future__ import annotations

import queue
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import IO, Any

from ves_gym.rendering.opengl import RenderError, environment, exit_reason


class DrawingProcess:
    """`python -m MODULE WORDS` with what it writes in a queue.

    It ends with its standard input: no process outlives the one that asked for pictures.

    Args:
        read: takes the next piece from its standard output, None at the end.
    """

    def __init__(
        self, backend: str, module: str, *words: str, read: Callable[[IO[bytes]], Any]
    ) -> None:
        self.backend = backend
        self.errors = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, "-m", module, *words],
            env=environment(backend),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            start_new_session=True,  # an interrupt from the keyboard is for its owner
        )
        self.pieces: queue.SimpleQueue[Any] = queue.SimpleQueue()
        reader = threading.Thread(
            target=_queue_output, args=(self.process.stdout, read, self.pieces), daemon=True
        )
        reader.start()
        self.close = weakref.finalize(self, _stop, self.process, reader, self.errors)

    def send(self, data: bytes) -> None:
        """Write to it. Where it has ended, `get` says why."""
        assert self.process.stdin is not None
        with suppress(OSError):
            self.process.stdin.write(data)
            self.process.stdin.flush()

    def ready(self) -> bool:
        """True if `get` would not wait."""
        return not self.pieces.empty()

    def get(self, patience: float | None) -> Any:
        """The next piece, None when it has ended well; a RenderError where there is none.

        Args:
            patience: s to wait, None: for ever.
        """
        try:
            piece = self.pieces.get(timeout=patience)
        except queue.Empty:
            self.close()
            raise RenderError(
                f"drawing with {self.backend} hung: no frame for {patience:g} s"
            ) from None
        if piece is None and (status := self.process.wait()) != 0:
            self.errors.seek(0)
            words = exit_reason(status, self.errors.read())
            self.close()
            raise RenderError(f"drawing with {self.backend} failed: {words}")
        return piece


def _queue_output(
    pipe: IO[bytes], read: Callable[[IO[bytes]], Any], pieces: queue.SimpleQueue[Any]
) -> None:
    """Queue what a process writes, and None when it has ended."""
    with pipe:
        while (piece := read(pipe)) is not None:
            pieces.put(piece)
    pieces.put(None)


def _stop(process: subprocess.Popen[bytes], reader: threading.Thread, errors: IO[str]) -> None:
    process.kill()  # does nothing to one that has ended
    process.wait()
    reader.join()
    assert process.stdin is not None
    with suppress(OSError):  # it had not read everything
        process.stdin.close()
    errors.close()
