"""MuJoCo, loaded so that a broken OpenGL set-up cannot keep the physics from running.

`import mujoco` looks for OpenGL as MUJOCO_GL says and fails when it is not there. Physics
needs none: it is then loaded with rendering off, and drawing reports what is missing.
"""

from __future__ import annotations

import os

try:
    import mujoco
except (ImportError, RuntimeError, AttributeError):
    requested = os.environ.get("MUJOCO_GL")
    if requested is None:
        raise
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco
    finally:
        os.environ["MUJOCO_GL"] = requested

__all__ = ["mujoco"]
