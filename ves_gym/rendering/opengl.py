"""Which OpenGL draws on this machine: tried in child processes that may hang or crash.

MuJoCo reads its OpenGL backend from MUJOCO_GL when it is imported, and a broken OpenGL
may hang or abort, so nothing is ever tried in the user's own process.
"""

from __future__ import annotations

import ctypes.util
import os
import platform
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

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


@cache
def probe(backend: str, timeout: float = _PATIENCE) -> Probe:
    """Try to draw with a backend, in a child process that may hang or crash.

    Args:
        backend: a value of MUJOCO_GL.
        timeout: after which it counts as hung [s].

    Returns:
        The outcome; the same one again without another try.
    """
    try:
        done = subprocess.run(
            [sys.executable, "-c", _TRY],
            env=environment(backend),
            capture_output=True,
            text=True,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        return Probe(backend, False, f"drawing hangs (gave up after {timeout:g} s)")
    if done.returncode == 0:
        return Probe(backend, True, "works")
    library, _ = _LIBRARIES.get(backend, ("", ""))
    if library and ctypes.util.find_library(library) is None:
        return Probe(backend, False, f"lib{library} is missing")
    if backend in ("glfw", "glx") and not has_display():
        return Probe(backend, False, "no display (DISPLAY is not set)")
    return Probe(backend, False, exit_reason(done.returncode, done.stderr))


def choose_backend() -> str:
    """The first OpenGL backend that draws, or a RenderError that says what to install."""
    tried = []
    for backend in candidates():
        result = probe(backend)
        if result.works:
            return backend
        tried.append(f"{backend}: {result.reason}")
    raise RenderError(f"no OpenGL to draw with ({'; '.join(tried)}); {install_hint()}")


def install_hint() -> str:
    """Advice for a machine on which no backend draws."""
    setting = os.environ.get("MUJOCO_GL")
    state = "is not set" if setting is None else f"is {setting!r}"
    packages = ", or ".join(packages for _, packages in _LIBRARIES.values())
    return f"MUJOCO_GL {state}; on Debian or Ubuntu: apt-get install {packages}"


def exit_reason(status: int, stderr: str) -> str:
    """Explain why a process ended.

    Args:
        status: exit status, negative for a signal.
        stderr: what it wrote there.

    Returns:
        The reason in words.
    """
    lines = [text.strip() for text in stderr.splitlines() if text.strip()]
    if status < 0:
        return f"it crashes (signal {-status})"
    return lines[-1] if lines else f"it ends with status {status}"


def environment(backend: str) -> dict[str, str]:
    """Environment of a drawing process: the backend, and this very package."""
    root = str(Path(__file__).parents[2])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"}
    return {**environment, "MUJOCO_GL": backend, "PYTHONPATH": os.pathsep.join(paths)}
