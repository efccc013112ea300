"""What pictures and windows need, or the reason to skip."""

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from ves_gym.rendering.opengl import RenderError, choose_backend


def require_opengl() -> str:
    """The OpenGL backend that draws here; skips the test where there is none."""
    pytest.importorskip("PIL.Image")
    try:
        return choose_backend()
    except RenderError as error:
        pytest.skip(str(error))


@contextmanager
def virtual_display() -> Iterator[None]:
    """A display that nobody sees; skips the test where Xvfb is not installed."""
    if shutil.which("Xvfb") is None:
        pytest.skip("needs Xvfb")
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1280x1024x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    before = os.environ.get("DISPLAY")
    try:
        with os.fdopen(read) as pipe:
            os.environ["DISPLAY"] = f":{pipe.readline().strip()}"  # once it is ready
        yield
    finally:
        os.environ.pop("DISPLAY", None)
        if before is not None:
            os.environ["DISPLAY"] = before
        server.kill()
        server.wait()


def type_keys(title: str, *actions: str) -> None:
    """Keys into the window of a title, like "keydown q"; skips without xdotool."""
    if shutil.which("xdotool") is None:
        pytest.skip("needs xdotool")
    search = ["xdotool", "search", "--sync", "--onlyvisible", "--name", title]
    window = subprocess.run(search, capture_output=True, text=True, check=True, timeout=30)
    focus = ["xdotool", "windowfocus", "--sync", window.stdout.split()[0]]
    for left in reversed(range(20)):  # a window just mapped may not take the focus yet
        if subprocess.run(focus, check=not left, stderr=subprocess.DEVNULL).returncode == 0:
            break
        time.sleep(0.25)
    for action in actions:
        subprocess.run(["xdotool", *action.split()], check=True)
