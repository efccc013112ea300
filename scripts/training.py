"""Train the policies of the package, release them, and store what they reach.

`python scripts/training.py RUNS [NAME ...]` takes the runs in RUNS (all configurations, or
those named): learning curves to docs/training, the best policy of each to the package, its
figures on the test episodes to docs/training/NAME.json, an animation to docs/pictures.
`--measure [NAME ...]` in place of RUNS measures released policies again. Without arguments the
figure of the curves is drawn again. `scripts/results.py` writes the tables of docs/results.md.

`--train RUNS [NAME ...]` trains first, all seeds of each, as many at once as there are
processors; runs that are there go on from their checkpoints. `--missing RUNS` says what no
policy is released of and why, and how many hours all of it takes. `--rewards RUNS [NAME ...]`
measures what RUNS has of PPO's seeds, released or not, and writes docs/training/rewards.json.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import ves_gym.api as vg
from ves_gym._util.params import ParameterError, write_bytes, write_text
from ves_gym.baselines.comparison import ControllerComparison
from ves_gym.baselines.config import CONFIGS, TrainConfig, read_config
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import evaluate, make_vector
from ves_gym.baselines.learner import Learner
from ves_gym.baselines.policy import RELEASED, Policy, load_policy, released
from ves_gym.baselines.registry import REFERENCES, get_controller
from ves_gym.envs.registration import IDS

DOCS = Path(__file__).parents[1] / "docs"
PLACE, PICTURES = DOCS / "training", DOCS / "pictures"
REWARDS = PLACE / "rewards.json"
# Beside what rewards alone taught; `zero` is the straight line, `compensating` plans for long.
BESIDE = REFERENCES | {"PumaRestToRest": "zero", "DualArmReach": "resolved"}
EPISODES = 200  # seeds 0, 1, ...: none of them is trained on or chosen by
LAB_EPISODES = 100  # of the same on the ...Emulated twin

FPS, WIDTH, COLOURS = 10, 480, 64  # of the animations
EPISODE = 3  # that they show


def configs() -> list[TrainConfig]:
    """Configurations of the package, in the order of the environments."""
    order = list(IDS)
    found = [read_config(path) for path in CONFIGS.glob("*.toml")]
    return sorted(found, key=lambda c: (order.index(task(c)), c.label))


def task(config: TrainConfig) -> str:
    """Such as PumaDamp."""
    return config.env.rpartition("/")[2].rpartition("-v")[0]


# ------------------------------------------------------------------------ training


def train(found: Iterable[TrainConfig], runs: Path, workers: int) -> None:
    """Train every seed, one configuration after another; what is done stays as it is."""
    for config in found:
        print(vg.train(config, folder=runs / config.name, workers=workers, resume=True))


def missing(runs: Path) -> str:
    """A line per policy that is not released, and hours of one core by measured rates."""
    lines, hours = [], 0.0
    for name in IDS:
        found = [config for config in configs() if task(config) == name]
        lines += [] if found else [f"{name}: no configuration"]
        for config in found:
            reason = _reason(config, runs)
            lines += [f"{config.name}: {reason}"] if reason else []
            each = _seconds_per_decision(config, runs)
            hours += each * config.total_timesteps * len(config.seeds) / 3600
    return "\n".join([*lines, f"all from nothing: {hours:.1f} hours of one core"])


def _reason(config: TrainConfig, runs: Path) -> str:
    """Why no policy of a configuration is released, empty if one is."""
    total = config.total_timesteps
    if (PLACE / f"{config.name}.json").exists() and config.label in released(config.env):
        kept = min(map(_decisions, _curves(config, PLACE)))
        return "" if kept >= total else f"released with {kept:,} of {total:,} decisions"
    done = [_decisions(path) for path in _curves(config, runs)]
    if min(done) < total:
        return f"seeds are at {', '.join(f'{k:,}' for k in done)} of {total:,} decisions"
    return f"trained, not released: python scripts/training.py {runs} {config.name}"


def _curves(config: TrainConfig, folder: Path) -> list[Path]:
    """Files of the curves, of runs or as committed."""
    inside = "seed-{}.jsonl" if folder == PLACE else "seed-{}/curve.jsonl"
    return [folder / config.name / inside.format(seed) for seed in config.seeds]


def _decisions(path: Path) -> int:
    """So many has a run taken, by its curve."""
    return int(read_curve(path)[-1]["steps"]) if path.exists() else 0


def _seconds_per_decision(config: TrainConfig, runs: Path) -> float:
    """Least of all seeds' curves; where there is none, what one iteration takes."""
    every = [path for folder in (runs, PLACE) for path in _curves(config, folder)]
    ends = [read_curve(path)[-1] for path in every if path.exists()]
    rates = [end["seconds"] / end["steps"] for end in ends if end["steps"]]
    if rates:
        return float(min(rates))
    env = make_vector(
        config.env, config.n_envs, AutoresetMode.SAME_STEP, threads=1, **config.settings
    )
    learner, begin = Learner(config, 0, env), time.process_time()
    learner.learn(1, lambda: None)
    env.close()
    return (time.process_time() - begin) / learner.steps


# ------------------------------------------------------------------------- release


def release(config: TrainConfig, runs: Path) -> None:
    """Curves and the best policy of a finished run."""
    curves = {}
    for seed, path in zip(config.seeds, _curves(config, runs), strict=True):
        curves[seed] = rows = read_curve(path)
        if rows[-1]["steps"] < config.total_timesteps:
            raise ParameterError(f"{path}: {rows[-1]['steps']} steps: not finished")
        target = PLACE / config.name / f"seed-{seed}.jsonl"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_text(target, "".join(json.dumps(_short(row)) + "\n" for row in rows))
    best = max(curves, key=lambda seed: max(row["return"] for row in curves[seed]))
    folder = RELEASED / task(config)
    folder.mkdir(parents=True, exist_ok=True)
    for suffix in (".json", ".safetensors"):
        source = runs / config.name / f"seed-{best}" / f"best{suffix}"
        shutil.copyfile(source, folder / f"{config.label}{suffix}")


def read_curve(path: Path) -> list[dict[str, Any]]:
    """Rows of a curve.jsonl."""
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def _short(value: Any) -> Any:
    """Numbers to six digits."""
    if isinstance(value, dict):
        return {k: _short(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_short(item) for item in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def measure(config: TrainConfig) -> None:
    """The released policy and its rivals on the test episodes, in the policy's control."""
    best = load_policy(released(config.env)[config.label])
    settings = best.settings(gym.spec(config.env))
    lineup: list[tuple[str, Controller]] = [
        (name, get_controller(name)) for name in (REFERENCES[task(config)], "zero", "random")
    ]
    lineup.append((config.label, best))
    result = _compared(config.env, lineup, EPISODES, settings)
    lab = config.env.replace("-v", "Emulated-v")
    result["laboratory"] = _compared(lab, [lineup[0], lineup[-1]], LAB_EPISODES, settings)
    write_text(PLACE / f"{config.name}.json", json.dumps(_short(result), indent=1) + "\n")


def _compared(
    id: str,
    lineup: Sequence[tuple[str, Controller]],
    episodes: int,
    settings: dict[str, Any],
) -> dict[str, Any]:
    """A report without the rows of the episodes; settings are for zero and random."""
    found = []
    for name, controller in lineup:
        given = settings if name in ("zero", "random") else {}
        played = evaluate(controller, id, episodes=episodes, threads=1, **given)
        found.append(dataclasses.replace(played, name=name))
    result = ControllerComparison(tuple(found)).to_dict()
    for one in result["controllers"]:
        one.pop("rows")
        one.pop("about")
    return result


def measure_rewards(found: Iterable[TrainConfig], runs: Path) -> None:
    """PPO's seeds that are there beside the reference; what others had before stays."""
    every = json.loads(REWARDS.read_text("utf-8")) if REWARDS.exists() else {}
    for config in found:
        folders = sorted((runs / config.name).glob("seed-*/best.json"))
        if config.imitate or not folders:
            continue
        reference = BESIDE[task(config)]
        lineup: list[tuple[str, Controller]] = [(reference, get_controller(reference))]
        lineup += [(path.parent.name, load_policy(path)) for path in folders]
        result = _compared(config.env, lineup, LAB_EPISODES, {})
        summary = {one["name"]: one["summary"]["success"] for one in result["controllers"]}
        every[config.name] = {
            "reference": reference,
            "decisions": min(map(_decisions, (p.with_name("curve.jsonl") for p in folders))),
            "seeds": {
                name: {"success": summary[name], "E_mean": result["ratios"][name]["E_mean"]}
                for name, _ in lineup[1:]
            },
        }
        write_text(REWARDS, json.dumps(_short(every), indent=1, sort_keys=True) + "\n")


# ------------------------------------------------------------------------ pictures


def animate(config: TrainConfig) -> None:
    """The released policy through one episode, as a GIF."""
    policy = load_policy(released(config.env)[config.label])
    settings = policy.settings(gym.spec(config.env))
    env: Any = gym.make(config.env, render_mode="rgb_array", **settings)
    every = round(1 / FPS / env.unwrapped.task.system.control_dt)
    write_gif(_episode(env, policy, every), PICTURES / f"{task(config)}.gif")
    env.close()


def write_gif(pictures: Iterable[Any], target: Path) -> None:
    """Write pictures (height, width, 3) as a GIF; the last one is seen for longer."""
    from PIL import Image

    frames = [
        Image.fromarray(frame).resize((WIDTH, WIDTH * frame.shape[0] // frame.shape[1]))
        for frame in pictures
    ]
    palette = frames[len(frames) // 2].quantize(COLOURS, Image.Quantize.MAXCOVERAGE)
    first, *others = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    held = [round(1000 / FPS)] * len(others) + [1500]  # ms
    buffer = io.BytesIO()
    first.save(buffer, "GIF", save_all=True, append_images=others, duration=held, loop=0)
    write_bytes(target, buffer.getvalue())


def _episode(env: Any, policy: Policy, every: int) -> Iterable[Any]:
    """Frames of an episode, one per so many control periods, and of its end."""
    observation, _ = env.reset(seed=EPISODE)
    action, step, over = None, 0, False
    while not over:
        if step % every == 0:
            yield env.render()
        if step % policy.network.hold == 0:
            rows = observation
            rows = {k: v[None] for k, v in rows.items()} if env.unwrapped.goal else rows[None]
            action = policy(rows)[0]
        observation, _, terminated, truncated, _ = env.step(action)
        step, over = step + 1, terminated or truncated
    yield env.render()


def draw_curves(found: Sequence[TrainConfig]) -> None:
    """Return on the validation episodes against decisions, a panel per task."""
    from matplotlib.figure import Figure

    from ves_gym.report.figures import write_figures

    rows = -(-len(found) // 4)
    figure = Figure(figsize=(11, 2.5 * rows), layout="constrained")
    for axes in figure.subplots(rows, 4).flat[len(found) :]:
        axes.axis("off")
    for axes, config in zip(figure.axes, found, strict=False):
        for seed, curve in curves(config).items():
            steps = [row["steps"] / 1e6 for row in curve]
            axes.plot(steps, [row["return"] for row in curve], linewidth=1.1, label=str(seed))
        zero, random = (
            _summary(config)[name]["return"]["mean"]["value"] for name in ("zero", "random")
        )
        best = max(row["return"] for curve in curves(config).values() for row in curve)
        axes.axhline(zero, color="0.4", linewidth=1, linestyle="--")
        axes.axhline(random, color="0.4", linewidth=1, linestyle=":")
        axes.set_ylim(zero - 0.5 * (best - zero), best + 0.1 * (best - zero))
        axes.set_title(f"{task(config)}, {config.label}", fontsize=9)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
    figure.supxlabel("decisions, millions", fontsize=9)
    figure.supylabel("return", fontsize=9)
    write_figures({PICTURES / "training": figure})


# ---------------------------------------------------------------------------- page


def curves(config: TrainConfig) -> dict[int, list[dict[str, Any]]]:
    """Committed learning curves by seed."""
    return dict(zip(config.seeds, map(read_curve, _curves(config, PLACE)), strict=True))


def results(config: TrainConfig) -> dict[str, Any]:
    """Committed figures on the test episodes."""
    plain: dict[str, Any] = json.loads((PLACE / f"{config.name}.json").read_text("utf-8"))
    return plain


def _summary(config: TrainConfig) -> dict[str, Any]:
    return {one["name"]: one["summary"] for one in results(config)["controllers"]}


def policies() -> str:
    """Return the tables of the released policies."""
    done = [c for c in configs() if (PLACE / f"{c.name}.json").exists()]
    return "\n\n".join((_runs(done), _figures(done)))


def rewards() -> str:
    """Return the table of what rewards alone taught.

    One seed with its interval, or the median of several with the least and the most.
    """
    rows = []
    for name, one in json.loads(REWARDS.read_text("utf-8")).items():
        seeds = list(one["seeds"].values())
        solved = sorted(seed["success"]["value"] for seed in seeds)
        ends = solved[0], solved[-1]
        if len(seeds) == 1:
            ends = seeds[0]["success"]["low"], seeds[0]["success"]["high"]
        low, high = (f"{100 * end:.0f}" for end in ends)
        ratios = [seed["E_mean"]["value"] for seed in seeds]
        rows.append(
            (
                name,
                f"{one['decisions'] / 1e6:.2g} M",
                str(len(seeds)),
                f"{100 * np.median(solved):.0f} ({low} to {high})",
                f"{np.median(ratios):.2g} of `{one['reference']}`",
            )
        )
    return _table(("configuration", "decisions", "seeds", "solved %", "energy"), rows)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _runs(found: Sequence[TrainConfig]) -> str:
    rows = []
    for config in found:
        every = curves(config).values()
        solved = [max(curve, key=lambda row: row["return"])["success"] for curve in every]
        seconds = min(curve[-1]["seconds"] for curve in every)
        rows.append(
            (
                f"[{task(config)}](environments/{task(config)}.md)",
                config.label,
                f"{config.total_timesteps / 1e6:.2g}",
                f"{seconds:.0f}",
                f"{100 * min(solved):.0f} to {100 * max(solved):.0f}",
            )
        )
    return _table(("task", "policy", "M decisions", "s", "solved %"), rows)


def _figures(found: Sequence[TrainConfig]) -> str:
    """In space and in the laboratory; the reference beside the policy, energies over its."""
    rows = []
    for config in found:
        space = results(config)
        lab = space["laboratory"]
        policy, name = config.label, lab["controllers"][0]["name"]
        success = [
            {one["name"]: one["summary"]["success"] for one in result["controllers"]}
            for result in (space, lab)
        ]
        rows.append(
            (
                task(config),
                policy,
                *(f"{_percent(at[policy])} / {_percent(at[name])}" for at in success),
                *(_value(result["ratios"][policy]["E_mean"]) for result in (space, lab)),
            )
        )
    return _table(("task", "policy", "space", "lab", "E space", "E lab"), rows)


def _percent(e: dict[str, Any]) -> str:
    return f"{100 * e['value']:.0f}"


def _value(e: dict[str, Any] | None) -> str:
    return "-" if e is None or e["value"] is None else f"{e['value']:.2g}"


def main(words: Sequence[str]) -> None:
    """See the module's docstring."""
    if words and words[0] == "--missing":
        print(missing(Path(words[1])))
        return
    if words and words[0] == "--rewards":
        measure_rewards(
            [c for c in configs() if c.name in (words[2:] or [c.name])], Path(words[1])
        )
        words = []
    if words and words[0] == "--train":
        words = words[1:]
        chosen = [c for c in configs() if c.name in (words[1:] or [c.name])]
        train(chosen, Path(words[0]), os.cpu_count() or 1)
        return
    for config in configs() if words else ():
        if words[1:] and config.name not in words[1:]:
            continue
        if words[0] != "--measure":
            release(config, Path(words[0]))
        measure(config)
        animate(config)
    draw_curves([c for c in configs() if (PLACE / f"{c.name}.json").exists()])


if __name__ == "__main__":
    main(sys.argv[1:])
