"""`ves-gym view`, `teleop`: a run that was recorded, and one that is driven."""

from __future__ import annotations

import sys
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.flags import (
    LOG,
    START,
    Answer,
    Context,
    Flag,
    Place,
    number,
    read,
    require_writable,
    say,
    text,
)
from ves_gym.cli.machine import MACHINE
from ves_gym.envs.teleop import Teleop, load_script, read_script
from ves_gym.rendering.opengl import RenderError, has_display
from ves_gym.rendering.render import View, render, show
from ves_gym.rendering.rerun_file import write_rerun
from ves_gym.report.player import can_play, write_player
from ves_gym.system.runlog import RunLog

_AFTER = 2.0  # s that a script goes on after its last key
_EVERY = 1.0  # s between the readings that are printed
_STRIP = 10.0  # s of the energy strip
_LINES = 4  # of readings, a safety stop included


def _movie(value: str, place: Place) -> Path:
    suffix = ".rrd" if place.name == "--rerun" else place.name.replace("--", ".")
    if Path(value).suffix != suffix:
        raise ParameterError(f"{place.name} must be a {suffix} name, got {value!r}")
    return Path(value)


def _size(value: str) -> tuple[int, int]:
    width, height = (int(part) for part in value.split("x"))
    return width, height


def view(
    at: Context,
    log: tuple[Path, ...],
    *,
    gif: Path | None = None,
    mp4: Path | None = None,
    rerun: Path | None = None,
    window: bool = False,
    size: tuple[int, int] | None = None,
    **how: float,
) -> Answer:
    """Draw or show the log; several side by side in a recording for rerun."""
    if rerun is not None:
        if size is not None or set(how) - {"magnify"}:
            raise ParameterError(
                "--rerun has every record: leave out --size, --fps and --speed"
            )
        return _recording(Path(at.out or "", rerun), log, **how)
    if len(log) > 1:
        raise ParameterError(
            f"--gif, --mp4 and --window take one LOG, got {len(log)}; --rerun FILE takes many"
        )
    movie = gif or mp4
    width, height = size or (960, 480)
    view = View(width=width, height=height, **how)
    recorded = RunLog.load(log[0])
    plain = {"schema": "ves-view/1", "log": str(log[0]), "digest": recorded.digest}
    if window or (has_display() and not (movie or at.out)):
        show(recorded, view)
        return Answer(plain=plain)
    if not (movie or size or how) and can_play(recorded):
        path = at.folder("out/view") / f"{log[0].stem}.html"
        write_player(recorded, path, log[0].stem)
        return Answer(
            text="open it in any browser", plain={**plain, "file": str(path)}, files=[path]
        )
    path = Path(at.out or "", movie) if movie else at.folder("out/view") / f"{log[0].stem}.gif"
    require_writable(path.parent, "the place of the pictures")
    drawn = render(recorded, path, view, at.progress)
    text = f"{drawn['frames']} frames, drawn with {drawn['backend']}"
    return Answer(text=text, plain={**plain, "file": str(path), **drawn}, files=[path])


def _recording(path: Path, logs: tuple[Path, ...], magnify: float = 1.0) -> Answer:
    """Write runs under the names of their files, with the folder's where these are the same."""
    stems = Counter(log.stem for log in logs)
    alone = [stems[log.stem] == 1 for log in logs]
    full = ["/".join(log.with_suffix("").parts[-2:]) for log in logs]
    names = [log.stem if k else name for log, k, name in zip(logs, alone, full, strict=True)]
    if len(set(names)) < len(names):
        raise ParameterError(f"runs need different names, got {', '.join(names)}")
    runs = {name: RunLog.load(log) for name, log in zip(names, logs, strict=True)}
    write_rerun(path, runs, magnify)
    plain: dict[str, Any] = {"schema": "ves-view/1", "file": str(path)}
    plain["runs"] = {name: runs[name].digest for name in names}
    text = f"{', '.join(names)}: look at them with `rerun {path}`"
    return Answer(text=text, plain=plain, files=[path])


def teleop(
    at: Context,
    *,
    keys: str | None = None,
    duration: float | None = None,
    start: Array | None = None,
    log: str | None = None,
) -> Answer:
    """Drive; write the log. Faults are found before anyone drives."""
    files = [] if log is None else at.log(Path(at.out or "", log))
    system = at.case.system
    begin = system.arm.home if start is None else start
    driven = Teleop(system, start=begin, seed=at.case.seed, record=bool(files))
    if keys is None:
        if duration is not None:
            raise ParameterError("--duration is that of a script: give --keys FILE")
        _window(driven)
    else:
        _script(driven, keys, duration)
    scene, sim = driven.batch.scene, driven.batch.sim
    for event in sim.events:
        say(event)
    plain: dict[str, Any] = {
        "schema": "ves-teleop/1",
        "system": system.hash,
        "mode": system.mode,
        "seconds": float(scene.time[0]),
        "E_peak": float(driven.batch.episodes.peaks[0, 0]),
        "events": [{"time": e.time, "reason": e.reason} for e in sim.events],
        "diverged": driven.diverged,
        "log": None,
    }
    if driven.diverged:
        say(sim.describe_divergence(0))
    if files:
        recorded = driven.log()
        recorded.save(files[0])
        plain |= {"log": str(files[0]), "digest": recorded.digest}
    answer = Answer(plain=plain, files=files, negative=driven.diverged)
    return replace(answer, then=[["view", files[0]]]) if files else answer


def _window(driven: Teleop) -> None:
    from ves_gym.envs.recording import Renderer

    try:
        renderer = Renderer(
            driven.task, "human", rolling=_STRIP, lines=_LINES, title="ves-gym teleop"
        )
    except RenderError as error:
        raise RenderError(f"{error}; or script the keys: --keys FILE") from None
    print("keys (in the window; hold those of a joint):")
    for key, what in driven.keys().items():
        print(f"  {key:7} {what}")
    try:
        with suppress(KeyboardInterrupt):  # a way to quit, too
            driven.drive(renderer)
    finally:
        renderer.close()


def _script(driven: Teleop, file: str, seconds: float | None) -> None:
    keys = driven.keys()
    script = read_script(sys.stdin, keys, "stdin") if file == "-" else load_script(file, keys)
    if seconds is None:
        seconds = max((k.time + k.hold for k in script), default=0.0) + _AFTER
    reported = 0.0

    def on_progress(time: float) -> None:
        nonlocal reported
        if time >= reported + _EVERY - 1e-9:
            reported = time
            print(f"{time:6.2f} s  " + "  ".join(driven.readings()))

    driven.play(script, seconds, on_progress)


TABLE = {
    "view": (view, (
        replace(LOG, many=True),
        Flag("--gif", "FILE", _movie, "draw into a GIF", against="target"),
        Flag("--mp4", "FILE", _movie, "draw into an MP4", against="target"),
        Flag("--rerun", "FILE", _movie,
             "record into a .rrd for rerun's viewer, several runs under their names",
             against="target"),
        Flag("--window", help="open a window (default with a display; else a page)",
             against="target"),
        Flag("--speed", "X", number(), "playing speed (1: real time)"),
        Flag("--magnify", "X", number(), "factor on the base's motion (1)"),
        Flag("--fps", "N", number(), "pictures/s (25)"),
        Flag("--size", "WxH", read(_size, "WIDTHxHEIGHT like 960x480"), "pixels (960x480)"),
    )),
    "teleop": (teleop, (
        Flag("--keys", "FILE", text,
             "no window: keys from FILE (- is stdin), lines TIME KEY [SECONDS held]"),
        Flag("--duration", "S", number("s", above=0), "of --keys (2 s after the last key)"),
        START,
        Flag("--log", "NAME", text, "record a run log, .csv or .parquet"),
        *MACHINE,
    )),
}  # fmt: skip
