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


def import_time() -> Pair:
    """`import ves_gym` beside `import gymnasium`; `ratio` is gymnasium's time over ours."""
    return side_by_side(
        lambda: seconds_of("import ves_gym"), lambda: seconds_of("import gymnasium"), RUNS
    )


def first_step(name: str) -> Pair:
    """Make, reset and step one of our environments beside Pusher-v5."""
    ours = _STEP.format(id=f"ves_gym:ves/{name}-v0")
    reference = _STEP.format(id=REFERENCE)
    return side_by_side(lambda: seconds_of(ours), lambda: seconds_of(reference), RUNS)


def report() -> dict[str, object]:
    """Print ours over the reference's time, as medians of pairs; return the figures."""
    results: dict[str, object] = {}
    pairs = {"import": import_time(), **{name: first_step(name) for name in IDS}}
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
