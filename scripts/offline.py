"""Learn from a data set alone, and draw what came of it: `python scripts/offline.py`.

The set is made from its recipe; behaviour cloning and IQL learn from it with some seeds; they
and those who made the set are evaluated on the same test episodes. Figures go to
docs/training/offline.json, the picture to docs/pictures/offline.png. Without arguments the
picture is drawn again from what is there; `--train` learns first.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

from ves_gym._util.params import write_text
from ves_gym.baselines.comparison import line_up
from ves_gym.baselines.dataset import make_dataset, recipes
from ves_gym.baselines.evaluate import evaluate, pool, report
from ves_gym.baselines.offline import OfflineConfig, train_offline
from ves_gym.report.figures import write_figure

DOCS = Path(__file__).parents[1] / "docs"
RESULT = DOCS / "training" / "offline.json"
SET = "ves/PumaReach-v1/mixed-v0"
NAMES = {"bc": "behaviour cloning", "iql": "IQL"}


def measure(steps: int, seeds: int, episodes: int) -> dict[str, Any]:
    """Figures of the learned policies and of those who made the set."""
    recipe = recipes()[SET]
    data = make_dataset(recipe)
    lineup = [
        (name, group) for name, group in line_up(recipe.env, recipe.behaviours, recipe.seed)
    ]
    for method, name in NAMES.items():
        config = OfflineConfig(method=method, steps=steps, layers=(128, 128), reward_scale=10)
        lineup.append((name, [train_offline(data.episodes, config, k) for k in range(seeds)]))
    found = []
    for name, group in lineup:
        each = [
            evaluate(c, recipe.env, episodes=episodes, threads=1, **data.settings)
            for c in group
        ]
        found.append(pool(each, name))
    result = report(found)
    for entry in result["controllers"]:
        entry.pop("rows")
        entry.pop("about")
    made = {**dataclasses.asdict(recipe), "steps": data.steps, "updates": steps, "seeds": seeds}
    return {**result, "offline": made}


def stored() -> dict[str, Any]:
    """Figures of the last training."""
    result: dict[str, Any] = json.loads(RESULT.read_text("utf-8"))
    return result


def draw(result: dict[str, Any]) -> None:
    """Return and success in the environment, a bar per policy."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 2.8), layout="constrained")
    names = [entry["name"] for entry in result["controllers"]]
    for axes, key in zip(
        figure.subplots(1, 2, sharey=True), ("return", "success"), strict=True
    ):
        found = [entry["summary"][key] for entry in result["controllers"]]
        found = [e["iqm"] if key == "return" else e for e in found]
        values = [e["value"] for e in found]
        low = [e["value"] - e["low"] for e in found]
        high = [e["high"] - e["value"] for e in found]
        colours = ["tab:blue" if n in NAMES.values() else "0.6" for n in names]
        axes.barh(names, values, xerr=[low, high], color=colours, capsize=2)
        axes.set_xlabel("return, interquartile mean" if key == "return" else key, fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3, axis="x")
        axes.invert_yaxis()
    figure.axes[1].invert_yaxis()  # shared: turned twice
    write_figure(figure, DOCS / "pictures" / "offline.png")


def main() -> None:
    """Learn if asked, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", action="store_true", help="learn and evaluate first")
    parser.add_argument("--steps", type=int, default=8000, help="updates")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--episodes", type=int, default=50)
    args = parser.parse_args()
    if args.train:
        result = measure(args.steps, args.seeds, args.episodes)
        write_text(RESULT, json.dumps(result, indent=1) + "\n")
    result = stored()
    for entry in result["controllers"]:
        s = entry["summary"]
        print(entry["name"], s["return"]["iqm"], s["success"])
    draw(result)


if __name__ == "__main__":
    main()
