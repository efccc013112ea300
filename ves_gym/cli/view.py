"""`ves-gym view`: watch a run log in a window, or as a GIF or MP4."""

from __future__ import annotations

import argparse
from pathlib import Path

from ves_gym._util.params import ParameterError
from ves_gym.cli.common import progress, write_json
from ves_gym.system.runlog import RunLog

SCHEMA = "ves-view/1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("log", metavar="LOG", help="a run log, .csv or .parquet")
    to = parser.add_mutually_exclusive_group()
    to.add_argument("--gif", metavar="FILE", help="draw into a GIF")
    to.add_argument("--mp4", metavar="FILE", help="draw into an MP4")
    to.add_argument(
        "--window", action="store_true", help="open a window (default with a display; else GIF)"
    )
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="of the clock (1)"
    )
    parser.add_argument(
        "--magnify", type=float, default=1.0, metavar="X", help="the base's motion (1)"
    )
    parser.add_argument("--fps", type=float, default=25.0, metavar="N", help="pictures/s (25)")
    parser.add_argument("--size", default="960x480", metavar="WxH", help="pixels (960x480)")


def run(args: argparse.Namespace) -> int:
    """Draw or show the log."""
    from ves_gym.rendering.opengl import has_display
    from ves_gym.rendering.render import View, render, show

    width, height = _size(args.size)
    view = View(
        width=width, height=height, fps=args.fps, speed=args.speed, magnify=args.magnify
    )
    log = RunLog.load(args.log)
    result = {"schema": SCHEMA, "log": args.log, "digest": log.digest}
    window = args.window or (has_display() and not (args.gif or args.mp4 or args.out))
    if window:
        show(log, view)
        write_json(args.json, {**result, "file": None})
        return 0
    path = _target(args)
    with progress() as on_progress:
        drawn = render(log, path, view, lambda done: on_progress("drawing", done))
    write_json(args.json, {**result, "file": str(path), **drawn})
    print(f"written: {path} ({drawn['frames']} frames, drawn with {drawn['backend']})")
    return 0


def _target(args: argparse.Namespace) -> Path:
    """Return the path of the picture; --gif and --mp4 names lie in --out if that is given."""
    for option in ("gif", "mp4"):
        name = getattr(args, option)
        if name is None:
            continue
        if Path(name).suffix != f".{option}":
            raise ParameterError(f"--{option} must be a .{option} name, got {name!r}")
        return Path(args.out, name) if args.out else Path(name)
    return Path(args.out or "out/view") / f"{Path(args.log).stem}.gif"


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.split("x"))
    except ValueError:
        raise ParameterError(
            f"--size must be WIDTHxHEIGHT like 960x480, got {text!r}"
        ) from None
    return width, height
