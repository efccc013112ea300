"""PPO on the tasks of arms with six and seven joints, beside their reference controllers.

`python scripts/new_tasks.py RUNS` trains what is not in the folder RUNS yet, by the
configurations of the package, and writes docs/training/new_tasks.json and the picture of
the learning curves, docs/pictures/new_tasks.png. Without RUNS the picture is drawn again.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from ves_gym._util.params import write_text
from ves_gym.baselines.config import CONFIGS, read_config
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.baselines.train import train

ROOT = Path(__file__).parents[1]
FOUND, PICTURE = (
    ROOT / "docs" / "training" / "new_tasks.json",
    ROOT / "docs" / "pictures" / "new_tasks.png",
)
REFERENCES = {
    "PoseReach": "resolved-pose",
    "PayloadTransfer": "resolved",
    "MacroMicro": "braced",
    "ServicerCapture": "servicer",
}
EPISODES = 50  # of controllers
CURVE = ("steps", "return", "success")


def trained(name: str, runs: Path) -> dict[str, Any]:
    """Learning curves of a task, a list of rows per seed, and what controllers reach."""
    config = read_config(CONFIGS / f"{name}-ppo.toml")
    curves = []
    for seed in config.seeds:
        folder = runs / name / f"seed-{seed}"
        rows = _read(folder / "curve.jsonl")
        if not rows or rows[-1]["steps"] < config.total_timesteps:
            rows = train(config, seed, folder, resume=True)
        curves.append([{k: row[k] for k in CURVE} for row in rows])
    beside = {}
    for controller in ("zero", REFERENCES[name]):
        result = evaluate(get_controller(controller), config.env, episodes=EPISODES, threads=1)
        beside[controller] = {
            "return": float(result.values("return")[0].mean()),
            "success": float(result.values("success")[0].mean()),
        }
    return {"env": config.env, "curves": curves, "controllers": beside}


def _read(curve: Path) -> list[dict[str, Any]]:
    lines = curve.read_text("utf-8").splitlines() if curve.is_file() else []
    return [json.loads(line) for line in lines]


def draw(found: dict[str, Any], picture: Path = PICTURE) -> None:
    """Return on the validation episodes against decisions, a panel per task."""
    from matplotlib.figure import Figure

    from ves_gym.report.figures import write_figures

    figure = Figure(figsize=(11, 2.8), layout="constrained")
    for axes, (name, task) in zip(figure.subplots(1, len(found)), found.items(), strict=True):
        for seed, rows in enumerate(task["curves"]):
            steps = [row["steps"] / 1e3 for row in rows]
            axes.plot(
                steps, [row["return"] for row in rows], linewidth=1.1, label=f"seed {seed}"
            )
        styles = ("--", "-")
        for (controller, reached), style in zip(
            task["controllers"].items(), styles, strict=True
        ):
            axes.axhline(
                reached["return"], color="0.4", linewidth=1, linestyle=style, label=controller
            )
        axes.set_title(name, fontsize=9)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=6)
    figure.supxlabel("decisions, thousands", fontsize=9)
    figure.supylabel("return", fontsize=9)
    write_figures({picture.with_suffix(""): figure})


def stored() -> dict[str, Any]:
    """What the last training and evaluation came to."""
    found: dict[str, Any] = json.loads(FOUND.read_text("utf-8"))
    return found


def main(words: list[str]) -> None:
    """Train, evaluate, write and draw."""
    if words:
        found = {name: trained(name, Path(words[0])) for name in REFERENCES}
        write_text(FOUND, json.dumps(found, indent=1) + "\n")
    draw(stored())


if __name__ == "__main__":
    main(sys.argv[1:])
