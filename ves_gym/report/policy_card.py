"""A model card of a policy: what it is, how it was made, how well it does, and its limits.

After Mitchell et al., Model cards for model reporting, FAT* 2019. All of it is read from the
policy's file, its training configuration and an evaluation; nothing is written by hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym

from ves_gym._util.params import ParameterError, content_hash, read_table
from ves_gym.baselines.comparison import ControllerComparison
from ves_gym.baselines.config import find_configs
from ves_gym.baselines.controllers import Random, Zero
from ves_gym.baselines.evaluate import evaluate
from ves_gym.baselines.policy import RELEASED, Policy, load_policy, task_name
from ves_gym.envs.build import build_task
from ves_gym.envs.task import Task
from ves_gym.report.pages import estimate_text, markdown_table

LICENCE = "MIT, as the package"
_HALF = 0.5  # rate of success below which a task counts as not solved


def policy_card(name: str, figures: Mapping[str, Any] | None = None) -> str:
    """Return the card of a released policy, such as PumaDamp/ppo, or of a .json file, as
    Markdown.

    `figures`: an evaluation of schema ves-evaluate/1 in which the policy stands under its
    algorithm's name, with an entry `laboratory` where it was evaluated there too.
    """
    policy = load_policy(name)
    about = policy.about
    label = str(about.get("algorithm", policy.name))
    parts = [f"# {name}\n\n{_opening(policy, label)}", _identity(name, policy)]
    parts.append("## How it was trained\n\n" + _training(policy, label))
    if figures is not None:
        parts.append("## How well it does\n\n" + _figures(figures, label))
    parts.append("## Limits\n\n" + _limits(policy, label, figures))
    parts.append(f"## Licence\n\n{LICENCE}.")
    return "\n\n".join(parts) + "\n"


def evaluation_for_card(name: str, episodes: int, seed: int = 0) -> dict[str, Any]:
    """Evaluate a policy for its card, beside no action and noise."""
    policy = load_policy(name)
    env, settings = policy.about.get("env"), policy.about.get("settings", {})
    if not isinstance(env, str):
        raise ParameterError(f"{name}: names no environment; give its --figures")
    policy.name = str(policy.about.get("algorithm", policy.name))
    rivals = (Zero(), Random(), policy)
    rows = (evaluate(c, env, episodes=episodes, seed=seed, **settings) for c in rivals)
    return ControllerComparison(tuple(rows)).to_dict()


def _opening(policy: Policy, label: str) -> str:
    env = str(policy.about.get("env", "unknown"))
    return (
        f"A policy for [`{env}`](../environments/{task_name(env)}.md), trained by {label}. It"
        " decides by the observation alone."
    )


def _task(policy: Policy) -> Task | None:
    """Task that it was trained on; None: its environment is not registered here."""
    env, settings = policy.about.get("env"), policy.about.get("settings", {})
    if env not in gym.registry:
        return None
    settings = {**gym.spec(env).kwargs, **settings}
    settings.pop("goal", None)
    return build_task(**settings)


def _identity(name: str, policy: Policy) -> str:
    net, task = policy.network, _task(policy)
    path = RELEASED / f"{name}.json"
    rows = [("task", f"`{policy.about.get('env', 'unknown')}`")]
    if task is not None:
        rows.append(("task's content, SHA-256", f"`{content_hash(task)}`"))
        period = net.hold * task.system.control_dt
        rows.append(("one decision", f"every {period:g} s ({net.hold} control periods)"))
    if path.is_file():
        rows.append(("weights, SHA-256", f"`{read_table(path)['weights']}`"))
    count = sum(W.size + b.size for W, b in policy.weights)
    layers = " - ".join(map(str, net.sizes))
    rows.append(("network", f"{layers}, {net.activation}, output {net.output}"))
    rows.append(("numbers", f"{count:,}, single precision"))
    rows.append(("observations", f"clipped to +-{net.observation_limit:g} of their scales"))
    if net.features is not None:
        text = f"{net.features.size} of the {net.features.arm}: {net.features}"
        rows.append(("further inputs", text))
    if net.inputs:
        rows.append(("parts of the observation", ", ".join(net.inputs)))
    return markdown_table(("what", "value"), rows)


def _training(policy: Policy, label: str) -> str:
    about = policy.about
    rows: list[tuple[str, str]] = []
    for config in find_configs(str(about.get("env", ""))):
        if config.label != label:
            continue
        plain = config.to_dict()
        skip = ("env", "algorithm", "settings", "seeds", "hyperparameters")
        rows.append(("seeds trained", ", ".join(map(str, config.seeds))))
        rows += [(k, _text(v)) for k, v in plain.items() if k not in skip and v]
        rows += [(k, _text(v)) for k, v in plain["hyperparameters"].items()]
        break
    rows.append(("seed of this policy", str(about.get("seed", "unknown"))))
    rows.append(("decisions of this policy", f"{about.get('steps', 0):,}"))
    for key, value in about.get("settings", {}).items():
        rows.append((f"setting {key}", _text(value)))
    versions = about.get("versions", {})
    rows.append(("versions", ", ".join(f"{k} {v}" for k, v in versions.items())))
    return markdown_table(("setting", "value"), rows)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    return f"{value:,}" if isinstance(value, int) else str(value)


def _figures(figures: Mapping[str, Any], label: str) -> str:
    parts = []
    space = figures["ratios"][label]["E_mean"]
    for title, result in _evaluations(figures):
        rows = []
        for entry in result["controllers"]:
            s, name = entry["summary"], entry["name"]
            rows.append(
                (
                    f"**{name}**" if name == label else name,
                    _estimate(s["success"], ".0%"),
                    _estimate(s["return"]["iqm"], ".3f"),
                    # a base that the laboratory's noise alone moves has no scale
                    _estimate(space and result["ratios"][name]["E_mean"], ".3f"),
                    str(s["failed"]),
                )
            )
        first = result["controllers"][0]
        head = ("controller", "success", "return", f"E_mean over {first['name']}", "failed")
        episodes = first["summary"]["episodes"]
        parts.append(f"{title}, {episodes} episodes:\n\n{markdown_table(head, rows)}")
    parts.append(
        "Return: interquartile mean; E_mean: median over the episodes; in brackets 95 %"
        " intervals."
    )
    return "\n\n".join(parts)


def _evaluations(figures: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    out = [(f"`{figures['id']}`", figures)]
    if "laboratory" in figures:
        lab = figures["laboratory"]
        out.append((f"In the laboratory, `{lab['id']}`, for which it was not trained", lab))
    return out


def _limits(policy: Policy, label: str, figures: Mapping[str, Any] | None) -> str:
    out = [
        "- Trained and evaluated in simulation only; it has moved no real machine, and must"
        " not without limits of joint angles, rates and torques of the machine's own.",
        f"- Made for `{policy.about.get('env', 'unknown')}`: another arm, base, control or"
        " deadline gives its observations and actions another meaning.",
        "- An action depends on the present observation alone: what is constant but unknown"
        " in an episode (payload, friction, stiffness) it cannot identify.",
    ]
    for title, result in _evaluations(figures) if figures is not None else ():
        for entry in result["controllers"]:
            success = entry["summary"]["success"]
            if entry["name"] == label and success["value"] < _HALF:
                out.append(
                    f"- {title}: it does not solve the task (success"
                    f" {_estimate(success, '.0%')})."
                )
    return "\n".join(out)


def _estimate(e: Mapping[str, Any] | None, form: str) -> str:
    return "-" if e is None else estimate_text(e["value"], e["low"], e["high"], form)
