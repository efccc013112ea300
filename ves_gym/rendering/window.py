"""A live picture in a window of its own."""

from __future__ import annotations

import json
import queue
import sys
import threading
from typing import Any

import glfw
import mujoco

from ves_gym.rendering.live import LiveSettings, answer
from ves_gym.rendering.stage import MAIN, Stage

_NAMES = {glfw.KEY_SPACE: "space", glfw.KEY_ESCAPE: "escape"}  # others have their character's


class Window:
    """The picture in a window: drag to turn, scroll to zoom."""

    def __init__(self, settings: LiveSettings) -> None:
        if not glfw.init():
            raise RuntimeError("GLFW finds no display")
        glfw.window_hint(glfw.SAMPLES, 4)
        self.handle = glfw.create_window(
            settings.width, settings.height, settings.title, None, None
        )
        if not self.handle:
            raise RuntimeError("GLFW opens no window")
        glfw.make_context_current(self.handle)
        self.stage = Stage(settings)
        self.keys: list[tuple[str, bool]] = []
        self.cursor = 0.0, 0.0
        glfw.set_key_callback(self.handle, self._key)
        glfw.set_cursor_pos_callback(self.handle, self._move)
        glfw.set_scroll_callback(self.handle, self._scroll)
        glfw.set_window_refresh_callback(self.handle, lambda handle: self.paint())

    def run(self) -> None:
        """Answer the lines on stdin until they end or the window is closed."""
        lines = queue.SimpleQueue[str]()
        threading.Thread(target=_feed, args=(lines,), daemon=True).start()
        while not glfw.window_should_close(self.handle):
            glfw.wait_events_timeout(0.1)
            if lines.empty():
                continue
            message = lines.get()
            if not message:
                break
            self.stage.add_samples(message)
            self.paint()
            answer(json.dumps(self.keys).encode())
            self.keys.clear()
        self.stage.context.free()  # before what it lives in
        glfw.terminate()

    def paint(self) -> None:
        """Draw what is known."""
        if self.stage.samples:
            self.stage.paint(*glfw.get_framebuffer_size(self.handle))
            glfw.swap_buffers(self.handle)

    def _key(self, handle: Any, key: int, code: int, action: int, mods: int) -> None:
        name = _NAMES.get(key) or glfw.get_key_name(key, code)
        if name and action != glfw.REPEAT:
            self.keys.append((name, action == glfw.PRESS))

    def _move(self, handle: Any, x: float, y: float) -> None:
        height = max(1, glfw.get_window_size(handle)[1])
        dx, dy = (x - self.cursor[0]) / height, (y - self.cursor[1]) / height
        self.cursor = x, y
        if glfw.get_mouse_button(handle, glfw.MOUSE_BUTTON_LEFT) == glfw.PRESS:
            self._camera(mujoco.mjtMouse.mjMOUSE_ROTATE_V, dx, dy)

    def _scroll(self, handle: Any, x: float, y: float) -> None:
        self._camera(mujoco.mjtMouse.mjMOUSE_ZOOM, 0.0, -0.05 * y)

    def _camera(self, kind: Any, dx: float, dy: float) -> None:
        """Move the camera of the picture under the cursor."""
        if self.stage.samples:
            side = self.cursor[0] > MAIN * glfw.get_window_size(self.handle)[0]
            camera = self.stage.cameras[int(side)]
            mujoco.mjv_moveCamera(self.stage.drawing.model, kind, dx, dy, camera)
            self.paint()


def _feed(lines: queue.SimpleQueue[str]) -> None:
    """Queue the lines of stdin, an empty one at its end."""
    while True:
        message = sys.stdin.readline()
        lines.put(message)
        glfw.post_empty_event()
        if not message:
            return
