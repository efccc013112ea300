"""Draw a run log with MuJoCo's renderer: a GIF, an MP4 or a window.

All drawing happens in a child process (`python -m ves_gym.rendering.movie`) under the OpenGL
backend that `opengl` chose, watched so that a hang ends in an error.
"""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, require_positive, unit, write_bytes
from ves_gym.rendering.opengl import RenderError, choose_backend, probe, require_display
from ves_gym.rendering.process import DrawingProcess
from ves_gym.system.energy import log_base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

_STALL = 180.0  # s without a finished frame after which drawing has hung

FORMATS = {  # suffix -> modules that write it; Pillow draws the labels
    ".gif": ("PIL",),
    ".mp4": ("PIL", "imageio_ffmpeg"),
}


@dataclass(frozen=True, kw_only=True)
class View:
    """Size, rate and magnification of a drawn run."""

    width: int = unit("px", default=960)
    height: int = unit("px", default=480)
    fps: float = unit("1/s", default=25.0)
    speed: float = unit("1", default=1.0)  # of the run's clock
    magnify: float = unit("1", default=1.0)  # of the base's motion

    def __post_init__(self) -> None:
        require_positive(self, "fps", "speed", "magnify")
        for name in ("width", "height"):
            pixels = getattr(self, name)
            if pixels % 2 or not 64 <= pixels <= 4096:
                raise ParameterError(
                    f"View.{name} must be an even number from 64 to 4096 px, got {pixels}"
                )


def render(
    log: RunLog,
    path: str | os.PathLike[str],
    view: View | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Draw a run log into a .gif or .mp4 file, written completely or not at all.

    Args:
        log: with a system in its metadata.
        path: its suffix chooses the format.
        view: size [px], frame rate [1/s] and magnification.
        progress: called with the fraction done.

    Returns:
        `frames` (how many) and `backend` (the OpenGL that drew them).

    Raises:
        RenderError: no OpenGL, or a package is missing.
        ParameterError: another suffix, or a frame rate the format cannot hold.
    """
    path, view = Path(path), view or View()
    _require_format(path, view)
    clip = _clip(log, view)
    backend = choose_backend()
    with tempfile.TemporaryDirectory(prefix="ves-render-") as folder:
        picture = Path(folder) / f"out{path.suffix}"
        _run_child(clip, view, picture, backend, progress)
        write_bytes(path, picture.read_bytes())
    return {"frames": len(clip["t"]), "backend": backend}


def show(log: RunLog, view: View | None = None) -> None:
    """Replay a run log in a window until it is closed.

    Args:
        log: with a system in its metadata.
        view: frame rate [1/s] and magnification.

    Raises:
        RenderError: no display, or its OpenGL does not work.
    """
    view = view or View()
    clip = _clip(log, view)
    require_display()
    result = probe("glfw")
    if not result.works:
        raise RenderError(f"a window needs glfw's OpenGL, which fails here: {result.reason}")
    with tempfile.TemporaryDirectory(prefix="ves-render-") as folder:
        _run_child(clip, view, Path(folder) / "window", "glfw", None)


def _require_format(path: Path, view: View) -> None:
    if path.suffix not in FORMATS:
        raise ParameterError(f"{path}: expected a {' or '.join(FORMATS)} name")
    require(f"{path.suffix[1:].upper()} output", *FORMATS[path.suffix])
    period = 100 / view.fps  # a GIF counts hundredths of a second
    if path.suffix == ".gif" and (round(period) < 1 or abs(period - round(period)) > 1e-6):
        near = 100 / max(2, round(period))
        raise ParameterError(
            "a GIF shows each frame for a whole number of 1/100 s: fps must be 100 / k"
            f" (50, 25, 20, 10, ...), got {view.fps:g}; nearest {near:.4g}"
        )


def _clip(log: RunLog, view: View) -> dict[str, Any]:
    """Arrays of every frame from a log, the base's motion magnified."""
    if "system" not in log.meta:
        raise ParameterError("the log does not say what to draw: its metadata has no 'system'")
    system = System.from_dict(log.meta["system"], "log metadata: system")
    if log.n_joints != system.arm.n:
        raise ParameterError(
            f"the log's system has an arm of {system.arm.n} joints, its columns {log.n_joints}"
        )
    t = np.arange(log.t[0], log.t[-1] + 1e-9, view.speed / view.fps)

    def at(values: Array) -> Array:
        return np.stack([np.interp(t, log.t, column) for column in values.T], axis=1)

    E = log_base_energy(log, system).total
    clip = {
        "t": t - log.t[0],
        "q": at(log.q),
        "y": view.magnify * at(log.y),
        "E": np.interp(t, log.t, E),
    }
    if log.u is not None and system.mode == "ideal":
        clip["u"] = view.magnify * at(log.u)
    if log.p is not None:  # attitudes of neighbouring samples may differ in sign
        clip["p"] = log.p[np.abs(log.t - t[:, None]).argmin(axis=1)]
    wrench = log.w if log.wg is None else log.wg  # less the weight, where there is any
    if wrench is not None:
        clip["w"] = at(wrench)
    return {"system": system, **clip}


def _run_child(
    clip: dict[str, Any],
    view: View,
    target: Path,
    backend: str,
    progress: Callable[[float], None] | None,
) -> None:
    job = target.with_name("job.npz")
    plain = json.dumps({"system": clip["system"].to_dict(), "view": dataclasses.asdict(view)})
    arrays = {k: v for k, v in clip.items() if k != "system"}
    np.savez(job, job=np.array(plain), **arrays)
    patience = _STALL if target.suffix else None  # a window stays as long as it likes
    words = (str(job), str(target))
    drawer = DrawingProcess(backend, "ves_gym.rendering.movie", *words, read=_read_message)
    try:
        while (message := drawer.get(patience)) is not None:
            if progress is not None:
                progress(float(message))  # one per frame: the fraction done
    finally:
        drawer.close()


def _read_message(pipe: IO[bytes]) -> bytes | None:
    return pipe.readline() or None
