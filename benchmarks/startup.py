"""Time from the start of Python to `import ves_gym`, and to the first step of an environment.

    python -m benchmarks.startup

Each in a process of its own, in turn with what it is compared with: `import gymnasium`, and
the first step of Gymnasium's own arm, Pusher-v5. Modules are compiled to bytecode before, as
pip does when it installs; so is the kernel, once per machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import asdict

from benchmarks.timing import Pair, side_by_side
from ves_gym.envs.registration import IDS

REFERENCE = "Pusher-v5"
RUNS = 9
_STEP = (
    "import gymnasium as gym\n"
    "env = gym.make({id!r})\n"
    "env.reset(seed=0)\n"
    "env.step(env.action_space.sample())\n"
)


def seconds_of(code: str) -> None:
    """Run code in a fresh interpreter."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def import_time(runs: int = RUNS) -> Pair:
    """`import ves_gym` beside `import gymnasium`; `ratio` is gymnasium's time over ours."""
    return side_by_side(
        lambda: seconds_of("import ves_gym"), lambda: seconds_of("import gymnasium"), runs
    )


def first_step(name: str, runs: int = RUNS) -> Pair:
    """Make, reset and step one of our environments beside Pusher-v5."""
    ours = _STEP.format(id=f"ves_gym:ves/{name}-v0")
    reference = _STEP.format(id=REFERENCE)
    return side_by_side(lambda: seconds_of(ours), lambda: seconds_of(reference), runs)


def report(small: bool = False) -> dict[str, object]:
    """Print ours over the reference's time, as medians of pairs; return the figures.

    Args:
        small: just enough to see that they can be had.
    """
    results: dict[str, object] = {}
    names, runs = (list(IDS)[:1], 1) if small else (list(IDS), RUNS)
    pairs = {"import": import_time(runs), **{name: first_step(name, runs) for name in names}}
    for name, pair in pairs.items():
        results[name] = asdict(pair)
        what, over = (
            ("import ves_gym", "import gymnasium")
            if name == "import"
            else (f"first step of {name}", f"of {REFERENCE}")
        )
        print(
            f"{what:32s} {1 / pair.ratio:5.2f} x {over}"
            f" ({1 / pair.high:.2f}-{1 / pair.low:.2f}), {pair.ours:.2f} s"
        )
    return results


if __name__ == "__main__":
    report()
