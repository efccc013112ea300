"""The drawing process behind `live`: started as `python -m ves_gym.rendering.screen`.

stdin: a line that says what is shown, then a line per picture with the samples since the
last. stdout: an answer to each: pixels, or the keys pressed in the window since. It ends
with its stdin. MUJOCO_GL says what draws.
"""

from __future__ import annotations

import sys

import mujoco
import numpy as np

from ves_gym.rendering.live import LiveSettings, answer
from ves_gym.rendering.stage import Stage


def answer_pictures(settings: LiveSettings) -> None:
    """Answer every line on stdin with pixels."""
    context = mujoco.GLContext(settings.width, settings.height)
    context.make_current()
    stage = Stage(settings)
    pixels = np.zeros((settings.height, settings.width, 3), np.uint8)
    area = mujoco.MjrRect(0, 0, settings.width, settings.height)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, stage.context)
    while message := sys.stdin.readline():
        stage.add_samples(message)
        stage.paint(settings.width, settings.height)
        mujoco.mjr_readPixels(pixels, None, area, stage.context)
        answer(pixels[::-1].tobytes())
    context.free()


if __name__ == "__main__":
    SETTINGS = LiveSettings.from_line(sys.stdin.readline())
    if SETTINGS.window:
        from ves_gym.rendering.window import Window  # needs GLFW

        Window(SETTINGS).run()
    else:
        answer_pictures(SETTINGS)
