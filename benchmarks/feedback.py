"""Controllers of PumaRestToRest on machines that are less and less as described.

    python -m benchmarks.feedback --episodes 100 --controllers direct,refined,adaptive

A row per machine and controller, the same episodes in every row of a machine:

- ratio: E_mean over the straight line's on the same machine: median, mean, worst decile;
- arrived: at the goal and at rest there, by the environment's own tolerances (1 deg of each
  joint; 5 deg/s in space, 8 deg/s in the laboratory);
- solved: arrived with E_mean at most half the straight line's on the same machine, which is
  the environment's success in the laboratory and wherever anything is drawn;
- described: the same with what the straight line is expected to leave on the machine as
  described, the environment's success on the known machine;
- s: seconds per episode, planning and simulation.

Before them what an arm leaves that stays at the goal.

Machines: `known` in space without errors; the laboratories `nominal`, `lab`, `hard` and
`held-out`; `unknown-laboratory` and, in space, `unknown-space`: a payload of up to 10 kg,
stiffness within 30 % and up to 5 N m of Coulomb friction on every joint; in the laboratory
besides a platform up to 10 % faster or slower, noise and drift of the nominal budget.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from benchmarks import store
from ves_gym._util.params import Array, Mask
from ves_gym.baselines.comparison import line_up
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import Evaluation, evaluate, make_vector
from ves_gym.leaderboard.problems import UNKNOWN

SPACE, LABORATORY = "ves/PumaRestToRest-v0", "ves/PumaRestToRestEmulated-v0"
# Success is to arrive; energies are compared with the straight line on the same machine.
ARRIVAL: dict[str, Any] = {"saving": None}
MACHINES: dict[str, tuple[str, dict[str, Any]]] = {
    "known": (SPACE, {}),
    "nominal": (LABORATORY, {"laboratory": "nominal"}),
    "lab": (LABORATORY, {}),
    "hard": (LABORATORY, {"laboratory": "hard"}),
    "held-out": (LABORATORY, {"laboratory": "held-out"}),
    **UNKNOWN,
}
SAVING = 0.5  # of the straight line's energy


class Row(NamedTuple):
    """Results of a controller on a machine."""

    ratio: Array  # (episodes,) E_mean over the straight line's
    arrived: float  # share of the episodes
    solved: float
    described: float
    seconds: float  # per episode

    def __str__(self) -> str:
        middle, mean = np.median(self.ratio), self.ratio.mean()
        worst = np.quantile(self.ratio, 0.9)
        return (
            f"{middle:7.3f} {mean:7.3f} {worst:7.3f} {self.arrived:8.0%} {self.solved:8.0%}"
            f" {self.described:9.0%} {self.seconds:8.2f}"
        )


def on_machine(machine: str, controller: Controller, episodes: int, seed: int) -> Evaluation:
    """Return the episodes of a controller on one of MACHINES.

    Args:
        machine: name.
        controller: whose.
        episodes, seed: as `evaluate`.
    """
    id, settings = MACHINES[machine]
    settings = ARRIVAL | settings
    return evaluate(controller, id, episodes=episodes, seed=seed, threads=1, **settings)


def described(machine: str, episodes: int, seed: int) -> Array:
    """Return what the straight line is expected to leave if the machine is as described [J].

    Args:
        machine: name.
        episodes, seed: as `evaluate`.

    Returns:
        (episodes,).
    """
    id, settings = MACHINES[machine]
    mode = AutoresetMode.DISABLED
    env = make_vector(id, episodes, mode, threads=1, **(ARRIVAL | settings))
    env.reset(seed=[seed + k for k in range(episodes)])
    return env.batch.goals[:, env.task.system.arm.n]


def still(machine: str, episodes: int, seed: int) -> Array:
    """Return E_mean of an arm that stays at the episode's goal [J].

    In the laboratory a payload that nobody was told of weighs on the emulated base, which is
    at rest without it at the start.

    Args:
        machine, episodes, seed: as in `described`.

    Returns:
        (episodes,).
    """
    id, settings = MACHINES[machine]
    mode = AutoresetMode.DISABLED
    env = make_vector(id, episodes, mode, threads=1, **(ARRIVAL | settings))
    seeds = [seed + k for k in range(episodes)]
    env.reset(seed=seeds)
    goal = env.batch.goals[:, : env.task.system.arm.n].copy()
    env.reset(seed=seeds, options={"q": goal, "goal": goal})
    info: dict[str, Any] = {}
    for _ in range(env.task.steps):
        info = env.step(np.zeros((episodes, env.batch.width)))[-1]
    return np.array(info["energy/E_mean"])


def ratios(mine: Evaluation, straight: Evaluation) -> Array:
    """Return E_mean over the straight line's (episodes,)."""
    pairs = zip(mine.rows, straight.rows, strict=True)
    return np.array([a["E_mean"] / b["E_mean"] for a, b in pairs])


def solved(mine: Evaluation, straight: Evaluation) -> Mask:
    """Return whose episodes arrive with at most `SAVING` of the straight line's energy."""
    arrived = np.array([k["success"] for k in mine.rows])
    return arrived & (ratios(mine, straight) <= SAVING)


def only(found: Evaluation, counted: Mask) -> Evaluation:
    """Return the results of some of the episodes."""
    rows = [k for k, kept in zip(found.rows, counted, strict=True) if kept]
    return replace(found, rows=rows, seconds=found.seconds * counted.mean())


def row(mine: Evaluation, straight: Evaluation, expected: Array) -> Row:
    """Return the results of a controller beside the straight line on the same episodes.

    Args:
        mine, straight: of `on_machine`.
        expected: (episodes,) [J] of `described`.
    """
    ratio = ratios(mine, straight)
    arrived = np.array([k["success"] for k in mine.rows])
    before = arrived & (mine.values("E_mean")[0] <= SAVING * expected)
    seconds = mine.seconds / len(ratio)
    share = solved(mine, straight).mean()
    return Row(ratio, arrived.mean(), share, before.mean(), seconds)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--controllers", default="direct,refined,adaptive")
    parser.add_argument("--machines", default=",".join(MACHINES))
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=20_000)
    parser.add_argument("--feasible", action="store_true", help="episodes that oracle solves")
    parser.add_argument("--json", type=Path, help="write medians and shares to this file")
    args = parser.parse_args()
    rows: list[list[object]] = []
    span = args.episodes, args.seed
    columns = "median    mean  decile  arrived   solved described        s"
    print(f"machine        controller     {columns}")
    for machine in args.machines.split(","):
        id, _ = MACHINES[machine]
        expected = described(machine, *span)
        straight = on_machine(machine, line_up(id, ["zero"])[0][1][0], *span)
        unmoved = still(machine, *span) / straight.values("E_mean")[0]
        print(
            f"{machine:14s} an arm that stays at the goal: median {np.median(unmoved):.3f},"
            f" more than {SAVING:g} in {np.mean(unmoved > SAVING):.0%} of the episodes"
        )
        counted = np.ones(args.episodes, bool)
        if args.feasible:
            oracle = on_machine(machine, line_up(id, ["oracle"])[0][1][0], *span)
            counted = solved(oracle, straight)
            print(f"{machine:14s} feasible: {counted.sum()} of {args.episodes}")
        for label, group in line_up(id, args.controllers.split(",")):
            mine = on_machine(machine, group[0], *span)
            found = row(only(mine, counted), only(straight, counted), expected[counted])
            print(f"{machine:14s} {label:12s} {found}", flush=True)
            worst = float(np.quantile(found.ratio, 0.9))
            shares = [f"{100 * k:.0f} %" for k in (found.arrived, found.solved)]
            rows.append([machine, f"`{label}`", float(np.median(found.ratio)), worst, *shares])
    if args.json:
        heads = ["machine", "controller", "median", "worst decile", "arrived", "solved"]
        store(args.json, heads, rows)


if __name__ == "__main__":
    main()
