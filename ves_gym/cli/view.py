"""`ves-gym view`: watch a run log in a window, or as a GIF or MP4."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.cli.files import log_file
from ves_gym.cli.flags import Answer, Flag, Place, number, read
from ves_gym.system.runlog import RunLog

SCHEMA = "ves-view/1"


def _movie(value: str, place: Place) -> Path:
    suffix = place.name.replace("--", ".")
    if Path(value).suffix != suffix:
        raise ParameterError(f"{place.name} must be a {suffix} name, got {value!r}")
    return Path(value)


def _size(value: str) -> tuple[int, int]:
    width, height = (int(part) for part in value.split("x"))
    return width, height


FLAGS = (
    Flag("LOG", read=log_file, help="a run log, .csv or .parquet, or a case that names one"),
    Flag("--gif", "FILE", _movie, "draw into a GIF", against="target"),
    Flag("--mp4", "FILE", _movie, "draw into an MP4", against="target"),
    Flag("--window", help="open a window (default with a display; else GIF)", against="target"),
    Flag("--speed", "X", number(), "of the clock (1)"),
    Flag("--magnify", "X", number(), "the base's motion (1)"),
    Flag("--fps", "N", number(), "pictures/s (25)"),
    Flag("--size", "WxH", read(_size, "WIDTHxHEIGHT like 960x480"), "pixels (960x480)"),
)


def run(
    log: Path,
    *,
    gif: Path | None = None,
    mp4: Path | None = None,
    window: bool = False,
    size: tuple[int, int] = (960, 480),
    out: Path | None = None,
    progress: Any = None,
    **how: float,
) -> Answer:
    """Draw or show the log."""
    from ves_gym.rendering.opengl import has_display
    from ves_gym.rendering.render import View, render, show

    movie = gif or mp4
    view = View(width=size[0], height=size[1], **how)
    recorded = RunLog.load(log)
    plain = {"schema": SCHEMA, "log": str(log), "digest": recorded.digest}
    if window or (has_display() and not (movie or out)):
        show(recorded, view)
        return Answer(plain=plain)
    path = Path(out or "", movie) if movie else (out or Path("out/view")) / f"{log.stem}.gif"
    drawn = render(recorded, path, view, progress)
    text = f"{drawn['frames']} frames, drawn with {drawn['backend']}"
    return Answer(text=text, plain={**plain, "file": str(path), **drawn}, files=[path])
