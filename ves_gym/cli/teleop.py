"""`ves-gym teleop`: drive the arm from the keyboard while its base reacts."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from ves_gym._util.params import Array, ParameterError
from ves_gym.cli.files import log_files, log_path
from ves_gym.cli.flags import Answer, Flag, number, say, text
from ves_gym.cli.machine import MACHINE
from ves_gym.cli.simulate import START
from ves_gym.envs.teleop import Teleop, load_script, read_script
from ves_gym.planners.case import Case

SCHEMA = "ves-teleop/1"
_AFTER = 2.0  # s that a script goes on after its last key
_EVERY = 1.0  # s between the readings that are printed
_STRIP = 10.0  # s of the energy strip
_LINES = 4  # of readings, a safety stop included
FLAGS = (
    Flag("--keys", "FILE", text,
         "no window: keys from FILE (- is stdin), lines TIME KEY [SECONDS held]"),
    Flag("--duration", "S", number("s", above=0), "of --keys (2 s after the last key)"),
    START,
    Flag("--log", "NAME", text, "record a run log, .csv or .parquet"),
    *MACHINE,
)  # fmt: skip


def run(
    case: Case,
    *,
    keys: str | None = None,
    duration: float | None = None,
    start: Array | None = None,
    log: str | None = None,
    out: Path | None = None,
    json: str | None = None,
) -> Answer:
    """Drive; write the log. Faults are found before anyone drives."""
    path = None if log is None else log_path(Path(out or "", log), json)
    system = case.system
    teleop = Teleop(
        system,
        start=system.arm.home if start is None else start,
        seed=case.seed,
        record=path is not None,
    )
    if keys is None:
        if duration is not None:
            raise ParameterError("--duration is that of a script: give --keys FILE")
        _window(teleop)
    else:
        _script(teleop, keys, duration)
    scene, sim = teleop.batch.scene, teleop.batch.sim
    for event in sim.events:
        say(event)
    plain = {
        "schema": SCHEMA,
        "system": system.hash,
        "mode": system.mode,
        "seconds": float(scene.time[0]),
        "E_peak": float(teleop.batch.episodes.peaks[0, 0]),
        "events": [{"time": e.time, "reason": e.reason} for e in sim.events],
        "diverged": teleop.diverged,
        "log": None,
    }
    if teleop.diverged:
        say(sim.describe_divergence(0))
    if path is None:
        return Answer(plain=plain, negative=teleop.diverged)
    recorded = teleop.log()
    recorded.save(path)
    return Answer(
        plain={**plain, "log": str(path), "digest": recorded.digest},
        files=log_files(path),
        then=[["view", path]],
        negative=teleop.diverged,
    )


def _window(teleop: Teleop) -> None:
    from ves_gym.envs.rendering import Renderer
    from ves_gym.rendering.opengl import RenderError

    try:
        renderer = Renderer(
            teleop.task, "human", rolling=_STRIP, lines=_LINES, title="ves-gym teleop"
        )
    except RenderError as error:
        raise RenderError(f"{error}; or script the keys: --keys FILE") from None
    print("keys (in the window; hold those of a joint):")
    for key, what in teleop.keys().items():
        print(f"  {key:7} {what}")
    try:
        with suppress(KeyboardInterrupt):  # a way to quit, too
            teleop.drive(renderer)
    finally:
        renderer.close()


def _script(teleop: Teleop, file: str, seconds: float | None) -> None:
    keys = teleop.keys()
    script = read_script(sys.stdin, keys, "stdin") if file == "-" else load_script(file, keys)
    if seconds is None:
        seconds = max((k.time + k.hold for k in script), default=0.0) + _AFTER
    reported = 0.0

    def on_progress(time: float) -> None:
        nonlocal reported
        if time >= reported + _EVERY - 1e-9:
            reported = time
            print(f"{time:6.2f} s  " + "  ".join(teleop.readings()))

    teleop.play(script, seconds, on_progress)
