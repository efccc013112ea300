"""Draw a run log: a GIF, an MP4 or a window, as `live` draws what runs."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, require_positive, unit, write_bytes
from ves_gym.rendering.live import Live, LiveSettings
from ves_gym.system.energy import log_base_energy
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

FORMATS = {".gif": "PIL", ".mp4": "imageio_ffmpeg"}  # suffix -> module that writes it

Frames = Iterator[npt.NDArray[np.uint8]]


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
    """Draw a run log into a .gif or .mp4 file, written completely or not at all; `progress` is
    called with the fraction done.

    Returns `frames` (how many) and `backend` (the OpenGL that drew them). A RenderError says
    what is missing: no OpenGL, or a package.
    """
    path, view = Path(path), view or View()
    _require_format(path, view)
    system, samples = log_samples(log, view)
    live = Live(_settings(system, samples, view))

    def frames() -> Frames:
        for k, sample in enumerate(samples):
            yield live.picture(sample)
            if progress is not None:
                progress((k + 1) / len(samples))

    write = _write_gif if path.suffix == ".gif" else _write_mp4
    try:
        with tempfile.TemporaryDirectory(prefix="ves-render-") as folder:
            movie = Path(folder) / f"movie{path.suffix}"
            write(movie, frames(), view)
            write_bytes(path, movie.read_bytes())
    finally:
        live.close()
    return {"frames": len(samples), "backend": live.backend}


def show(log: RunLog, view: View | None = None) -> None:
    """Replay a run log in a window, over and over, until it is closed (Escape does, too)."""
    view = view or View()
    system, samples = log_samples(log, view)
    live = Live(_settings(system, samples, view, window=True, title="ves-gym view"))
    try:
        due = time.monotonic()
        for k in count():
            episode, at = divmod(k, len(samples))
            keys = live.show({**samples[at], "episode": episode})
            if ("escape", True) in keys or not live.open:
                return
            due = max(due + 1 / view.fps, time.monotonic() - 1.0)  # no catching up
            time.sleep(max(0.0, due - time.monotonic()))
    finally:
        live.close()


def _settings(
    system: System, samples: list[dict[str, Any]], view: View, **window: Any
) -> LiveSettings:
    return LiveSettings(
        system=system,
        width=view.width,
        height=view.height,
        span=max(samples[-1]["t"], 1e-3),
        magnify=view.magnify,
        **window,
    )


def described(log: RunLog) -> System:
    """Return the system of a log that can be drawn."""
    if "system" not in log.meta:
        raise ParameterError("the log does not say what to draw: its metadata has no 'system'")
    system = System.from_dict(log.meta["system"], "log metadata: system")
    if log.n_joints != system.arm.n:
        raise ParameterError(
            f"the log's system has an arm of {system.arm.n} joints, its columns {log.n_joints}"
        )
    return system


def log_samples(log: RunLog, view: View) -> tuple[System, list[dict[str, Any]]]:
    """The system of a log, and a sample of it for every picture, as `Live` takes them."""
    system = described(log)
    t = np.arange(log.t[0], log.t[-1] + 1e-9, view.speed / view.fps)

    def at(values: Array) -> Array:
        return np.stack([np.interp(t, log.t, column) for column in values.T], axis=1)

    energy = log_base_energy(log, system)
    wrench = log.w if log.wg is None else log.wg  # less the weight, where there is any
    # attitudes of neighbouring samples may differ in sign: not interpolated
    nearest = np.abs(log.t - t[:, None]).argmin(axis=1)
    columns: dict[str, Array | None] = {
        "t": t - log.t[0],
        "q": at(log.q),
        "y": at(log.y),
        "u": at(log.u) if log.u is not None and system.mode == "ideal" else None,
        "E": np.interp(t, log.t, energy.total),
        "strain": np.interp(t, log.t, energy.strain),
        "w": None if wrench is None else at(wrench),
        "payload": None if log.p is None else log.p[nearest],
    }
    lists = {k: [None] * len(t) if v is None else v.tolist() for k, v in columns.items()}
    samples = [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]
    return system, [{"episode": 0, "marker": None, "text": [], **k} for k in samples]


# --------------------------------------------------------------------------- files


def _require_format(path: Path, view: View) -> None:
    if path.suffix not in FORMATS:
        raise ParameterError(f"{path}: expected a {' or '.join(FORMATS)} name")
    require(f"{path.suffix[1:].upper()} output", FORMATS[path.suffix])
    period = 100 / view.fps  # a GIF counts hundredths of a second
    if path.suffix == ".gif" and (round(period) < 1 or abs(period - round(period)) > 1e-6):
        near = 100 / max(2, round(period))
        raise ParameterError(
            "a GIF shows each frame for a whole number of 1/100 s: fps must be 100 / k"
            f" (50, 25, 20, 10, ...), got {view.fps:g}; nearest {near:.4g}"
        )


# Colours that a run shows early or late: a GIF's palette has shades of them from the first on.
_ACCENTS = ((0.93, 0.55, 0.16), (0.88, 0.27, 0.27), (0.35, 0.80, 0.48), (0.74, 0.52, 0.95),
            (0.32, 0.72, 0.98), (0.55, 0.60, 0.68))  # fmt: skip


def _write_gif(path: Path, frames: Frames, view: View) -> None:
    from PIL import Image

    first = Image.fromarray(next(frames))
    # one palette for all, so that nothing flickers
    shades = np.linspace(0.25, 1.0, 16)[:, None, None]
    swatch = Image.fromarray((255 * shades * np.array(_ACCENTS)).round().astype(np.uint8))
    sample = first.copy()
    sample.paste(swatch.resize((first.width, first.height // 4), Image.Resampling.NEAREST))
    palette = sample.quantize(256, Image.Quantize.MEDIANCUT)

    def reduced(image: Image.Image) -> Image.Image:
        return image.quantize(palette=palette, dither=Image.Dither.NONE)

    reduced(first).save(
        path,
        save_all=True,
        append_images=(reduced(Image.fromarray(frame)) for frame in frames),
        duration=round(1000 / view.fps),
        loop=0,
    )


def _write_mp4(path: Path, frames: Frames, view: View) -> None:
    import imageio_ffmpeg

    size = (view.width, view.height)
    writer = imageio_ffmpeg.write_frames(str(path), size, fps=view.fps, macro_block_size=2)
    writer.send(None)
    for frame in frames:
        writer.send(frame)
    writer.close()
