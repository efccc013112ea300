"""Make the documentation's pictures again: `make figures`, or `scripts/figures.py NAME ...`.

A name is that of a file in docs/pictures; without names all are made. Sources are the commands
and data of this repository, nothing else; pictures of pages need Chromium, those of the arm
OpenGL. The table in CONTRIBUTING.md is written from here.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

import ves_gym as vg  # noqa: E402 - run as a file, the root is not on the path
from scripts import training, wiring  # noqa: E402
from scripts.marks import filled  # noqa: E402
from ves_gym._util.params import ParameterError, write_bytes, write_text  # noqa: E402
from ves_gym.cli.main import main as ves_gym  # noqa: E402

PICTURES = ROOT / "docs" / "pictures"
PAGE = ROOT / "CONTRIBUTING.md"
MARK = "pictures"
KEYS = ((0.5, "q", 1.5), (1.5, "a", 1.5), (3.0, "s", 1.0), (4.5, "w", 1.0), (6.0, "d", 1.0))
FPS, SECONDS = 10, 8.0  # of teleop.gif


STUDIO = """(async () => {
  const by = (id) => document.getElementById(id);
  const frame = () => new Promise((go) => setTimeout(go, 50));
  while (by("truth").dataset.done !== "yes" || vesStudio.chart.image === null) await frame();
  const time = by("scene-time");
  time.value = Number(time.min) + 0.23 * (Number(time.max) - Number(time.min));
  time.dispatchEvent(new Event("input"));
  await frame();
})()"""


class Figure(NamedTuple):
    """How a picture is made: a function of its path, and the same in words for the table."""

    make: Callable[[Path], None]
    source: str


def command(*words: str | Path) -> None:
    """Run a command of the package; one that fails ends the program."""
    if status := ves_gym([str(word) for word in words]):
        raise SystemExit(status)


def benchmark(picture: str, words: tuple[str, ...], target: Path) -> None:
    """One of a benchmark's figures."""
    with tempfile.TemporaryDirectory() as folder:
        command("benchmark", *words, "--out", folder)
        (found,) = Path(folder).rglob(picture)
        shutil.copyfile(found, target)


def animation(simulate: tuple[str, ...], size: str, magnify: str, target: Path) -> None:
    """A run, drawn at twice its speed."""
    with tempfile.TemporaryDirectory() as folder:
        command("simulate", *simulate, "--out", folder)
        log = Path(folder) / "run.csv"
        drawn = ("--size", size, "--magnify", magnify, "--speed", "2", "--fps", "10")
        command("view", log, "--gif", target, *drawn)


def shoulder_turn(target: Path) -> None:
    """The thesis's 180 degrees, planned as a straight line without limits of speed."""
    with tempfile.TemporaryDirectory() as folder:
        ends = ("--start=-90,0,0", "--goal", "90,0,0", "--duration", "2", "--v-max", "none")
        command("plan", "--planner", "straight", *ends, "--out", folder)
        animation(("--case", str(Path(folder) / "case.toml")), "720x360", "10", target)


def teleop(target: Path) -> None:
    """An operator's window on the emulated beam, keys as in `KEYS`."""
    from PIL import Image

    from ves_gym.envs.recording import Renderer
    from ves_gym.envs.teleop import Press, Teleop

    driven = Teleop(vg.System(mode="emulated"))
    window = Renderer(driven.task, "rgb_array", rolling=10.0, lines=4)
    every = round(1 / FPS / driven.batch.dt)
    frames: list[Image.Image] = []

    def draw(seconds: float) -> None:
        if round(seconds / driven.batch.dt) % every == 0:
            picture = window.frame(driven.batch, tuple(driven.readings()))
            frames.append(Image.fromarray(picture).quantize(64))

    try:
        driven.play([Press(*key) for key in KEYS], SECONDS, draw)
    finally:
        window.close()
    file = io.BytesIO()
    first, *others = frames
    period = 1000 // FPS
    first.save(file, "GIF", save_all=True, append_images=others, duration=period, loop=0)
    write_bytes(target, file.getvalue())


def episode(task: str, target: Path) -> None:
    """An episode of the released policy."""
    (config, *_) = [c for c in training.configs() if training.task(c) == task]
    training.animate(config)


def by_reference(task: str, seed: int, target: Path) -> None:
    """An episode of the reference controller, until it is solved."""
    import gymnasium as gym

    from ves_gym.baselines.registry import REFERENCES, get_controller

    def pictures() -> Iterator[Any]:
        env: Any = gym.make_vec(f"ves/{task}-v0", num_envs=1, render_mode="rgb_array")
        controller = get_controller(REFERENCES[task])
        observation, _ = env.reset(seed=seed)
        controller.reset(env.unwrapped, np.arange(1))
        for step in range(env.unwrapped.task.steps):
            if step % 8 == 0:
                yield env.render()[0]
            action = controller.act(env.unwrapped, observation)
            observation, _, _, _, info = env.step(action)
            if info["success"][0]:
                break
        yield env.render()[0]
        env.close()

    training.write_gif(pictures(), target)


def curves(target: Path) -> None:
    """Learning curves that are stored in docs/training."""
    done = [c for c in training.configs() if (training.PLACE / f"{c.name}.json").exists()]
    training.draw_curves(done)


def diagnosis(target: Path) -> None:
    """Top of the page about six logs of a machine with a friction that is not described."""
    machine = vg.System(mode="emulated", effects=[vg.effects.JointCoulomb(torque=(0, 0, 2.7))])
    with tempfile.TemporaryDirectory() as folder:
        described = Path(folder) / "machine.toml"
        vg.System(mode="emulated").save(described)
        logs = [Path(folder) / f"run-{k}.csv" for k in range(6)]
        for path, motion in zip(logs, vg.excitation(6), strict=True):
            vg.simulate(motion, machine, settle=1.0).save(path)
        command("diagnose", *logs, "--system", described, "--out", folder)
        (page,) = Path(folder).rglob("*.html")
        screenshot(page, (1000, 850), target)


def studio(target: Path) -> None:
    """The page as it opens, in the middle of the motion."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "studio.html"
        command("studio", "--out", page)
        screenshot(page, (1265, 1500), target, STUDIO)


def screenshot(
    page: Path, size: tuple[int, int], target: Path, script: str | None = None
) -> None:
    """What a browser shows of a page, after a script that it awaits."""
    from tests.browser import NAMES, Browser, find_browser

    path = find_browser()
    if path is None:
        raise ParameterError(f"{target.name} needs a browser: looked for {', '.join(NAMES)}")
    browser = Browser(path)
    try:
        browser.screen(*size)
        browser.send("Emulation.setScrollbarsHidden", hidden=True)
        browser.open(page.as_uri())
        if script is not None:
            browser.do(script)
        browser.picture(target, whole=False)
    finally:
        browser.close()


def schematic(target: Path) -> None:
    """The emulation loop, asked of the loop."""
    write_text(target, wiring.picture())


THESIS = ("--suite", "thesis")
PARETO = ("--planners", "direct,refined", "--bounds", "acceleration_peak=0.5,0.7,1,2",
          "--first", "4", "--durations", "1,2,4")  # fmt: skip
ANIMATED = ("BeamLQR", "FreeFlyerReach", "PoseReach", "PumaDamp", "PumaReach", "PumaReachGoal",
            "PumaTrack")  # fmt: skip

FIGURES: dict[str, Figure] = {
    **{
        f"{task}.gif": Figure(partial(episode, task), "an episode of the released policy")
        for task in ANIMATED
    },
    "diagnosis.png": Figure(diagnosis, "`ves-gym diagnose` of six simulated logs, its page"),
    "energy_thesis.png": Figure(
        partial(benchmark, "energy.png", THESIS), f"`ves-gym benchmark {' '.join(THESIS)}`"
    ),
    "BerthingContact.gif": Figure(
        partial(by_reference, "BerthingContact", 5), "an episode of the controller `resolved`"
    ),
    "DualArmReach.gif": Figure(
        partial(by_reference, "DualArmReach", 3), "an episode of the controller `compensating`"
    ),
    "laboratory.gif": Figure(
        partial(animation, ("--mode", "emulated"), "640x320", "3"),
        "`ves-gym simulate --mode emulated`, `ves-gym view`",
    ),
    "pareto.png": Figure(
        partial(benchmark, "pareto.png", PARETO), f"`ves-gym benchmark {' '.join(PARETO)}`"
    ),
    "shoulder_turn.gif": Figure(shoulder_turn, "`ves-gym plan`, `simulate` and `view`"),
    "studio.png": Figure(studio, "`ves-gym studio`"),
    "teleop.gif": Figure(teleop, "`ves-gym teleop` with keys of a script"),
    "training.png": Figure(curves, "the curves in docs/training"),
    "wiring.svg": Figure(schematic, "`scripts/wiring.py`"),
}


def page() -> str:
    """Text of CONTRIBUTING.md with the table of the pictures as they are made now."""
    rows = [
        f"| `{name}` | {figure.source} | `make figures ARGS={name}` |"
        for name, figure in FIGURES.items()
    ]
    table = "\n".join(("| picture | shows | again |", "|---|---|---|", *rows))
    return filled(PAGE.read_text("utf-8"), {MARK: table})


def main(names: list[str]) -> int:
    """Make pictures and write the table; return the exit status."""
    unknown = sorted(set(names) - set(FIGURES))
    if unknown:
        print(f"pictures are {', '.join(FIGURES)}, got {', '.join(unknown)}", file=sys.stderr)
        return 2
    for name in names or FIGURES:
        start = time.perf_counter()
        FIGURES[name].make(PICTURES / name)
        print(f"{name}: {time.perf_counter() - start:.0f} s")
    write_text(PAGE, page())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
