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


def pictures(shown: LiveSettings) -> None:
    """Answer every line on stdin with pixels."""
    context = mujoco.GLContext(shown.width, shown.height)
    context.make_current()
    stage = Stage(shown)
    pixels = np.zeros((shown.height, shown.width, 3), np.uint8)
    whole = mujoco.MjrRect(0, 0, shown.width, shown.height)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, stage.context)
    while line := sys.stdin.readline():
        stage.take(line)
        stage.paint(shown.width, shown.height)
        mujoco.mjr_readPixels(pixels, None, whole, stage.context)
        answer(pixels[::-1].tobytes())
    context.free()


def main() -> None:
    """Show what the first line of stdin says."""
    shown = LiveSettings.from_line(sys.stdin.readline())
    if not shown.window:
        pictures(shown)
    else:
        from ves_gym.rendering.window import Window  # needs GLFW

        Window(shown).run()


if __name__ == "__main__":
    main()
