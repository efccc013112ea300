"""OpenGL in child processes: which backend draws here, and a process that draws with it.

MuJoCo reads its OpenGL backend from MUJOCO_GL when it is imported, and a broken OpenGL may
hang or abort, so nothing is ever tried or drawn in the user's own process.
"""

from __future__ import annotations

import ctypes.util
import os
import platform
import queue
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any, NamedTuple

_PATIENCE = 30.0  # s a backend may take to draw one small picture


class RenderError(ValueError):
    """Nothing can be drawn on this machine; the message says what is missing."""


class Probe(NamedTuple):
    """The outcome of drawing with one OpenGL backend: it works, or the reason why not."""

    backend: str
    works: bool
    reason: str


_LIBRARIES = {  # backend -> (library, Debian packages)
    "egl": ("EGL", "libegl1 libgl1-mesa-dri"),
    "osmesa": ("OSMesa", "libosmesa6"),
}
_ON = ("", "enable", "enabled", "on", "true", "1")  # MuJoCo's words for "choose yourself"
_TRY = """
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><geom size="1"/></worldbody></mujoco>')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 0, "it draws nothing but black"
"""


def has_display() -> bool:
    """True if a window can be expected to open."""
    if platform.system() != "Linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def require_display() -> None:
    """Raise a RenderError where no window can open."""
    if not has_display():
        raise RenderError(
            "a window needs a display: DISPLAY is not set; a GIF or render_mode rgb_array needs"
            " none (MUJOCO_GL: egl or osmesa)"
        )


def candidates() -> tuple[str, ...]:
    """Backends to try, in order: MUJOCO_GL alone if set, else what the platform has."""
    platform_backends = {
        "Linux": ("egl", "osmesa", "glfw", "glx"),
        "Darwin": ("cgl", "glfw"),
        "Windows": ("wgl", "glfw"),
    }.get(platform.system(), ("glfw",))
    requested = os.environ.get("MUJOCO_GL", "").strip().lower()
    if requested not in _ON:
        if requested not in platform_backends:
            raise RenderError(
                f"drawing needs MUJOCO_GL to be one of {', '.join(platform_backends)} or unset,"
                f" got {os.environ['MUJOCO_GL']!r}"
            )
        return (requested,)
    if platform.system() == "Linux":
        return ("egl", "osmesa", "glfw") if has_display() else ("egl", "osmesa")
    return platform_backends[:1]


def attempt(code: str, timeout: float, backend: str | None = None) -> tuple[bool, str]:
    """Run Python code in a child process that may hang or crash, hung after so many seconds,
    with MUJOCO_GL as it is or another.

    Return whether it ended well, and the last line that it wrote, or why it ended.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment(backend),
            capture_output=True,
            text=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return False, f"it hangs (gave up after {timeout:g} s)"
    if done.returncode:
        return False, exit_reason(done.returncode, done.stderr)
    lines = done.stdout.strip().splitlines()
    return True, lines[-1] if lines else "works"


@cache
def probe(backend: str) -> Probe:
    """Try to draw with a backend; a second call returns the same outcome without a try."""
    works, words = attempt(_TRY, _PATIENCE, backend)
    library, _ = _LIBRARIES.get(backend, ("", ""))
    if not works and library and ctypes.util.find_library(library) is None:
        words = f"lib{library} is missing"
    elif not works and backend in ("glfw", "glx") and not has_display():
        words = "no display (DISPLAY is not set)"
    return Probe(backend, works, words)


def choose_backend() -> str:
    """The first OpenGL backend that draws, or a RenderError that says what to install."""
    tried = []
    for backend in candidates():
        result = probe(backend)
        if result.works:
            return backend
        tried.append(f"{backend}: {result.reason}")
    raise RenderError(f"no OpenGL to draw with ({'; '.join(tried)}); {install_hint()}")


def state() -> str:
    """The setting of MUJOCO_GL, in words."""
    setting = os.environ.get("MUJOCO_GL")
    return "MUJOCO_GL is not set" if setting is None else f"MUJOCO_GL is {setting!r}"


def install_hint() -> str:
    """Advice for a machine on which no backend draws."""
    packages = ", or ".join(packages for _, packages in _LIBRARIES.values())
    return f"{state()}; on Debian or Ubuntu: apt-get install {packages}"


def exit_reason(status: int, stderr: str) -> str:
    """Say why a process ended: a signal, or the last line of its `stderr`."""
    if status < 0:
        return f"it crashes (signal {-status})"
    lines = [text.strip() for text in stderr.splitlines() if text.strip()]
    return lines[-1] if lines else f"it ends with status {status}"


def environment(backend: str | None) -> dict[str, str]:
    """Environment of a child process: the backend, and this very package."""
    root = str(Path(__file__).parents[2])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    out = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    if backend is not None:
        out["MUJOCO_GL"] = backend
        out.pop("PYOPENGL_PLATFORM", None)  # MuJoCo sets its own
    return out


class DrawingProcess:
    """`python -m MODULE WORDS` with what it writes in a queue, piece by piece as `read` takes
    it.

    It ends with its standard input: no process outlives the one that wants its pictures.
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
        """The next piece, for which it waits so many seconds (None: for ever), None when it has
        ended well; a RenderError where there is none."""
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
