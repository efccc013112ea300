"""Resets with random effects: processor time over that of stepping the episode.

    python -m benchmarks.resets [--rows NAME ...]

256 environments on one thread. A reset draws effects and questions anew; the episode's cost
is that of its steps, measured on forty of them. The least of eight is taken of both.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from time import process_time
from typing import Any

import numpy as np

from ves_gym.envs.vector import VesVectorEnv

ENVS, REPEATS, STEPS = 256, 8, 5
THREE = {
    "gravity/scale": {"error": (-0.005, 0.005)},
    "gravity/tilt": {"angles": ([-0.005] * 3, [0.005] * 3)},
    "sensor/bias": {"force": ([-1.0] * 3, [1.0] * 3)},
}
VEHICLE = {"base/stiffness": {"error": (-0.1, 0.1)}}
ARM = {"payload/mass": {"mass": (0.0, 2.0)}}
NOMINAL = {"mode": "emulated", "laboratory": "nominal"}
ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    "no random effect": ("rest_to_rest", NOMINAL),
    "three effects": ("rest_to_rest", NOMINAL | {"randomize": THREE}),
    "laboratory lab": ("rest_to_rest", {"mode": "emulated", "laboratory": "lab"}),
    "laboratory hard": ("rest_to_rest", {"mode": "emulated", "laboratory": "hard"}),
    "vehicle": ("rest_to_rest", NOMINAL | {"randomize": VEHICLE}),
    "vehicle, in space": ("rest_to_rest", {"randomize": VEHICLE}),
    "arm": ("rest_to_rest", NOMINAL | {"randomize": ARM}),
    "arm, in space": ("rest_to_rest", {"randomize": ARM}),
    "track, three effects": ("track", NOMINAL | {"randomize": THREE}),
    "track, in space": ("track", {}),
}


def reset_and_episode(
    task: str, settings: dict[str, Any], n: int = ENVS, repeats: int = REPEATS
) -> tuple[float, float]:
    """Processor time of a reset of all environments, and of stepping their episode [s].

    Args:
        task: name.
        settings: of the environments.
        n: environments.
        repeats: of both.
    """
    env = VesVectorEnv(n, task, threads=1, **settings)
    env.reset(seed=0)
    resets, steps = [], []
    action = np.zeros((n, *env.single_action_space.shape))
    for _ in range(repeats):
        began = process_time()
        env.reset()
        resets.append(process_time() - began)
        began = process_time()
        for _ in range(STEPS):
            env.step(action)
        steps.append((process_time() - began) / STEPS)
    return min(resets), min(steps) * env.task.steps


def report(small: bool = False, names: Sequence[str] = tuple(ROWS)) -> dict[str, object]:
    """Print a row for each, and return the shares; `small`: just enough to see them."""
    out: dict[str, object] = {}
    for name in names:
        sizes = (2, 1) if small else (ENVS, REPEATS)
        reset, episode = reset_and_episode(*ROWS[name], *sizes)
        out[name] = share = reset / max(episode, 1e-9)
        print(
            f"reset {name:24s} {share:7.1%}: {1e3 * reset:6.1f} of {1e3 * episode:6.1f} ms",
            flush=True,
        )
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    report(names=parser.parse_args().rows)


if __name__ == "__main__":
    main()
