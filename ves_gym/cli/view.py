"""`ves-gym view`: watch a run log in a window, or as a GIF or MP4."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError
from ves_gym.cli.files import log_file
from ves_gym.cli.flags import Answer, Flag, Place, number
from ves_gym.system.runlog import RunLog

SCHEMA = "ves-view/1"


def _picture(value: str, place: Place) -> Path:
    suffix = place.name.replace("--", ".")
    if Path(value).suffix != suffix:
        raise ParameterError(f"{place.name} must be a {suffix} name, got {value!r}")
    return Path(value)


def _size(value: str, place: Place) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in value.split("x"))
    except ValueError:
        raise ParameterError(
            f"{place.name} must be WIDTHxHEIGHT like 960x480, got {value!r}"
        ) from None
    return width, height


FLAGS = (
    Flag("LOG", read=log_file, help="a run log, .csv or .parquet, or a case that names one"),
    Flag("--gif", "FILE", _picture, "draw into a GIF", against="to"),
    Flag("--mp4", "FILE", _picture, "draw into an MP4", against="to"),
    Flag("--window", help="open a window (default with a display; else GIF)", against="to"),
    Flag("--speed", "X", number(), "of the clock (1)"),
    Flag("--magnify", "X", number(), "the base's motion (1)"),
    Flag("--fps", "N", number(), "pictures/s (25)"),
    Flag("--size", "WxH", _size, "pixels (960x480)"),
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

    view = View(width=size[0], height=size[1], **how)
    shown = RunLog.load(log)
    plain = {"schema": SCHEMA, "log": str(log), "digest": shown.digest}
    if window or (has_display() and not (gif or mp4 or out)):
        show(shown, view)
        return Answer(plain=plain)
    named = gif or mp4
    path = Path(out or "", named) if named else (out or Path("out/view")) / f"{log.stem}.gif"
    drawn = render(shown, path, view, progress)
    said = f"{drawn['frames']} frames, drawn with {drawn['backend']}"
    return Answer(text=said, plain={**plain, "file": str(path), **drawn}, files=[path])
