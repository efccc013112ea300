"""Every planner and every command on every arm that comes with the package.

    python scripts/every_arm.py [--arms ur5e,iiwa14] [--only planners]

A cell says what came out and the seconds of processor time it took: of planners E_mean over
the straight line's (predicted) on the arm's first question of reach100, third duration, bent
beam; of commands "ok", or the sentence with which they refuse. Cells are stored in
docs/results/every-arm.json as they are done, so a run that was stopped goes on; --again forgets
them. `scripts/results.py` writes them into docs/results.md.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import write_text
from ves_gym.cli import main as cli
from ves_gym.mechanics.arm_library import arm_names, get_arm
from ves_gym.planners.query import Query, solve
from ves_gym.planners.registry import PLANNERS
from ves_gym.planners.suites import reach100, reach_durations
from ves_gym.system.system import System

WORK = Path("out/every-arm")
CELLS = Path(__file__).parents[1] / "docs" / "results" / "every-arm.json"
# Commands that ask no arm, and why.
NO_ARM = {
    "leaderboard": "its problems have arms of their own",
    "sweep, search, merge": "arms stand in their files",
    "doctor": "asks the computer",
}


def question(name: str) -> Query:
    """Return the arm's question: the first of the third duration."""
    arm = get_arm(name)
    duration = reach_durations(arm)[2]
    return reach100(System(arm=arm), "bent", 1, durations=(duration,)).queries[0][1]


def planned(arm: str, planner: str) -> dict[str, Any]:
    """Answer the question, as a cell."""
    query = question(arm)
    straight = solve(PLANNERS["straight"], query).predicted
    begin = time.process_time()
    plan = solve(PLANNERS[planner], query)
    seconds = time.process_time() - begin
    assert straight is not None
    if not plan.feasible:
        return {"seconds": seconds, "why": plan.failure}
    return {"seconds": seconds, "ratio": plan.predicted.E_mean / straight.E_mean}


def commands(arm: str) -> dict[str, list[str]]:
    """Return the command lines, in the order in which they need each other's files."""
    query = question(arm)
    folder = WORK / arm
    start, goal = (
        ",".join(f"{x:.3f}" for x in np.rad2deg(end)) for end in (query.start, query.goal)
    )
    span = ["--start", start, "--goal", goal, "--duration", f"{query.duration:g}"]
    of, out = ["--arm", arm], ["--out", str(folder)]
    keys, log = folder / "keys.txt", folder / "run.csv"
    keys.parent.mkdir(parents=True, exist_ok=True)
    keys.write_text("0.0 q 0.2\n", encoding="utf-8")
    simulated = ["simulate", *span, "--settle", "1", *of, "--record-dt", "0.005", *out]
    lab = ["--mode", "emulated", "--record-dt", "0.0125"]
    one = ["--episodes", "2"]
    task = "ves/PumaReach-v0" if len(query.start) < 6 else "ves/PoseReach-v0"
    controller = "resolved" if len(query.start) < 6 else "resolved-pose"
    poses = ["--poses", "20", "--mode", "emulated", "--log", str(folder / "poses.csv")]
    return {
        "list blocks": ["list", "blocks", *of, "--mode", "emulated"],
        "plan": ["plan", *span, "--planner", "direct", *of, *out],
        "simulate": [*simulated, "--log", "run.csv"],
        "simulate, emulated": [*simulated, *lab, "--log", "lab.csv"],
        "view": ["view", str(log), "--gif", "run.gif", "--fps", "2", *out],
        "map": ["map", "--joints", "1,2", "--points", "11", *of, *out],
        "benchmark": ["benchmark", "--planners", "straight", "--first", "1", "--durations",
                      f"{query.duration:g}", "--no-figures", *of, *out],
        "pped": ["pped", "--objective", "strain", "--no-figures", *of, *out],
        "emulation-check": ["emulation-check", "--no-search", "--no-figures", *of, *out],
        "simulate --poses": ["simulate", *poses, *of],
        "calibrate": ["calibrate", str(folder / "poses.csv"), *out],
        "evaluate": ["evaluate", task, "--controller", f"zero,{controller}", *one, *of],
        "train": ["train", "PumaReach-ppo", "--steps", "2000", "--seeds", "0", *of, *out],
        "teleop": ["teleop", "--keys", str(keys), "--duration", "0.5", *of, *out],
        "diagnose": ["diagnose", str(log), "--final", "0", "--most", "1", "--no-free-run",
                     "--no-figures", *out],
    }  # fmt: skip


def carried_out(words: list[str]) -> dict[str, Any]:
    """Run a command in this process, as a cell."""
    said, wrong = io.StringIO(), io.StringIO()
    begin = time.process_time()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(wrong):
        status = cli.main(words)
    seconds = time.process_time() - begin
    if status == cli.BAD_INPUT:
        lines = [k for k in wrong.getvalue().splitlines() if "error: " in k]
        return {"seconds": seconds, "why": lines[-1].partition("error: ")[2] if lines else "?"}
    return {"seconds": seconds}


def cell(entry: dict[str, Any] | None, notes: list[str]) -> str:
    """Return a cell's text; a reason becomes a numbered note."""
    if entry is None:
        return "-"
    time_taken = f"{entry['seconds']:.1f} s"
    if "why" in entry:
        if entry["why"] not in notes:
            notes.append(entry["why"])
        return f"no ({notes.index(entry['why']) + 1}), {time_taken}"
    if "ratio" in entry:
        return f"{entry['ratio']:.3g}, {time_taken}"
    return f"ok, {time_taken}"


def table() -> str:
    """Return the table of the cells that are stored, and its notes."""
    cells, arms = json.loads(CELLS.read_text("utf-8")), arm_names()
    notes: list[str] = []
    rows: dict[str, list[str]] = {}
    for kind in ("planner", "command"):
        names = dict.fromkeys(k.split("|")[2] for k in cells if k.startswith(f"{kind}|"))
        for name in names:
            label = f"`{name}`" if kind == "planner" else f"`ves-gym {name}`"
            row = [cell(cells.get(f"{kind}|{arm}|{name}"), notes) for arm in arms]
            rows[label] = row
    lines = [f"| | {' | '.join(arms)} |", "|---" * (len(arms) + 1) + "|"]
    lines += [f"| {label} | {' | '.join(row)} |" for label, row in rows.items()]
    lines += ["", *(f"{i}. {why}" for i, why in enumerate(notes, 1))]
    rest = "; ".join(f"`{name}`: {why}" for name, why in NO_ARM.items())
    return "\n".join([*lines, "", f"Commands that take no arm: {rest}."])


def main() -> None:
    """Fill in the cells that are missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--arms", default=",".join(arm_names()))
    parser.add_argument("--only", choices=("planners", "commands"))
    parser.add_argument("--again", action="store_true")
    args = parser.parse_args()
    cells: dict[str, Any] = {}
    if CELLS.exists() and not args.again:
        cells = json.loads(CELLS.read_text("utf-8"))
    todo: list[tuple[str, str, str]] = []
    lines = {arm: commands(arm) for arm in args.arms.split(",")}
    if args.only != "commands":
        todo += [("planner", arm, name) for name in PLANNERS for arm in lines]
    if args.only != "planners":
        names = next(iter(lines.values()))
        todo += [("command", arm, name) for name in names for arm in lines]
    for kind, arm, name in todo:
        key = f"{kind}|{arm}|{name}"
        if key in cells:
            continue
        poses = cells.get(f"command|{arm}|simulate --poses", {})
        if kind == "planner":
            cells[key] = planned(arm, name)
        elif name == "calibrate" and "why" in poses:
            cells[key] = {**poses, "seconds": 0.0}  # there is nothing to calibrate from
        else:
            cells[key] = carried_out(lines[arm][name])
        CELLS.parent.mkdir(parents=True, exist_ok=True)
        write_text(CELLS, json.dumps(cells, indent=1) + "\n")
        print(key, cells[key], flush=True)


if __name__ == "__main__":
    main()
