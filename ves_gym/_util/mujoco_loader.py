"""MuJoCo, loaded so that a broken OpenGL set-up cannot keep the physics from running.

`import mujoco` looks for OpenGL as MUJOCO_GL says and fails when it is not there. Physics
needs none: it is then loaded with rendering off, and drawing reports what is missing.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym._util.reading import read_apart

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


def read_model(path: str | os.PathLike[str]) -> mujoco.MjModel:
    """Return the model of an MJCF file, compiled by `read_apart` in a process of its own."""
    compiled = read_apart("ves_gym._util.mujoco_loader:binary_of", path)["model"].tobytes()
    return mujoco.MjModel.from_binary_path("model.mjb", {"model.mjb": compiled})


def binary_of(path: Path) -> dict[str, Any]:
    """A compiled model in MuJoCo's binary form, for `read_apart`."""
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError, RuntimeError) as error:
        if "unknown exception" in str(error):  # all that is left of std::bad_alloc
            raise MemoryError from None
        raise ParameterError(f"MuJoCo cannot compile it: {error}") from None
    out = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, out)
    return {"model": out}


__all__ = ["mujoco", "read_model"]
