"""A picture that follows a simulation: pixels on request, or a window.

Drawing happens in a child process (`screen`), which alone loads MuJoCo with its OpenGL.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ves_gym.rendering.opengl import DrawingProcess, choose_backend, require_display
from ves_gym.system.system import System

_STALL = 60.0  # s without an answer after which drawing has hung
_HEAD = 8  # bytes that say how long an answer is

Key = tuple[str, bool]  # its name, and whether it went down


@dataclass(frozen=True, kw_only=True)
class LiveSettings:
    """System, size and energy strip of a live picture."""

    system: System
    window: bool = False
    width: int = 640  # px
    height: int = 480
    span: float = 10.0  # s of the energy strip
    rolling: bool = False  # the strip follows the clock instead of ending with the span
    lines: int = 0  # of text
    title: str = "ves_gym"  # of a window
    magnify: float = 0.0  # of the base's motion; 0: in the picture of the whole, as it suits

    def to_line(self) -> bytes:
        """As a line of JSON."""
        plain = {k.name: getattr(self, k.name) for k in dataclasses.fields(self)}
        return json.dumps({**plain, "system": self.system.to_dict()}).encode() + b"\n"

    @staticmethod
    def from_line(text: str) -> LiveSettings:
        """The reverse of `to_line`."""
        plain = json.loads(text)
        return LiveSettings(**{**plain, "system": System.from_dict(plain["system"])})


class Live:
    """A picture of one system, brought up to date by samples.

    A sample is plain data: `episode` (a key per episode), `t` [s], `y` (6),
    `q` (n), `u` (m) flexures and internal modes or None, `E` and `strain` [J], `w` (6) the
    wrench on the base or None, `marker` (k, 3) points in space or None, `text` lines; `payload`
    (7) where there is one: its place and quaternion; `row` of the simulation where there are
    several (0).

    Raises:
        RenderError: nothing can be drawn here; the message says what is missing.
    """

    def __init__(self, settings: LiveSettings) -> None:
        self.settings = settings
        self.open, self._has_picture = True, False
        self._unsent: list[dict[str, Any]] = []
        self._due: float | None = None  # when the picture under way counts as lost
        if settings.window:
            require_display()
        self.backend = "glfw" if settings.window else choose_backend()
        self._drawer = DrawingProcess(self.backend, "ves_gym.rendering.screen", read=_read)
        self._drawer.send(settings.to_line())

    def picture(self, sample: dict[str, Any]) -> npt.NDArray[np.uint8]:
        """(height, width, 3) with this sample as the latest."""
        self._send([sample])
        shape = (self.settings.height, self.settings.width, 3)
        return np.frombuffer(self._drawer.get(_STALL), np.uint8).reshape(shape).copy()

    def show(self, sample: dict[str, Any]) -> list[Key]:
        """Bring the window up to date; the keys pressed and let go since the last call.

        Waits for the first picture only: what comes while one is drawn is shown with the
        following one. Once the window has been closed (`open`) nothing happens.
        """
        if not self.open:
            return []
        self._unsent.append(sample)
        keys: list[Key] = []
        if self._due is not None:
            if not self._drawer.ready() and time.monotonic() < self._due:
                return []
            keys = self._answer()
        if self.open:
            self._send(self._unsent)
            self._unsent, self._due = [], time.monotonic() + _STALL
        if not self._has_picture:
            keys, self._has_picture = self._answer(), True
        return keys

    def _answer(self) -> list[Key]:
        assert self._due is not None
        answer = self._drawer.get(max(0.0, self._due - time.monotonic()))
        self._due = None
        if answer is None:
            self.open = False
            return []
        return [(name, down) for name, down in json.loads(answer)]

    def _send(self, samples: list[dict[str, Any]]) -> None:
        self._drawer.send(json.dumps(samples).encode() + b"\n")

    def close(self) -> None:
        """End the drawing process; may be called again."""
        self.open = False
        self._drawer.close()


def answer(data: bytes) -> None:
    """Reply to `Live`, whose process this is not: the length, then the data."""
    sys.stdout.buffer.write(len(data).to_bytes(_HEAD, "big") + data)
    sys.stdout.buffer.flush()


def _read(pipe: IO[bytes]) -> bytes | None:
    head = pipe.read(_HEAD)
    if len(head) < _HEAD:
        return None
    return pipe.read(int.from_bytes(head, "big"))
