"""What the laboratory costs: E_mean and success of emulated environments over ideal ones.

    python scripts/laboratory_cost.py [--episodes 100]

Runs what ships with the package (controllers, policies) on every environment, on both beams,
in space and in the laboratories nominal, lab and hard; writes docs/laboratory-cost.json (each
episode) and docs/laboratory-cost.md. A cell whose task is as it was is not run again: a run
that was cut short goes on.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import Array, content_hash, write_text
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import evaluate, spec_of
from ves_gym.baselines.policy import load_policy, released
from ves_gym.baselines.registry import CONTROLLERS, get_controller
from ves_gym.envs.build import build_task
from ves_gym.simulation.loop_linearisation import EmulationWarning

DOCS = Path(__file__).parents[1] / "docs"
DATA, PAGE = DOCS / "laboratory-cost.json", DOCS / "laboratory-cost.md"
BEAMS = ("bent-thesis", "straight-horizontal-thesis")
SPACE, LABORATORIES = "ideal", ("nominal", "lab", "hard")

# Those that move the arm: energies are told over those in space.
SHIPPED: dict[str, tuple[str, ...]] = {
    "PumaRestToRest": ("zero", "ppo"),  # planned motions: docs/planners.md
    "PumaReach": ("resolved", "ppo"),
    "PumaReachGoal": ("resolved", "ppo"),
    "PumaTrack": ("resolved", "ppo"),
    "PumaDamp": ("high", "pped", "ppo"),
    "FreeFlyerReach": ("ppo",),
    "BeamLQR": ("zero", "lqr", "ppo"),
}


def main() -> None:
    """Fill in what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--episodes", type=int, default=100)
    episodes: int = parser.parse_args().episodes
    cells: dict[str, Any] = json.loads(DATA.read_text("utf-8")) if DATA.exists() else {}
    for name in SHIPPED:
        for vehicle in vehicles(name):
            for controller in SHIPPED[name]:
                for where in (SPACE, *LABORATORIES):
                    key = " ".join((name, vehicle, controller, where))
                    mark = _mark(name, vehicle, controller, where, episodes)
                    if cells.get(key, {}).get("mark") != mark:
                        cells[key] = {
                            "mark": mark,
                            **_run(name, vehicle, controller, where, episodes),
                        }
                        write_text(DATA, _dumped(cells))
                        print(key, flush=True)
    write_text(PAGE, page(cells, episodes))


def vehicles(name: str) -> tuple[str, ...]:
    """Both beams, or the satellite of a task that flies."""
    return ("free-floating",) if name == "FreeFlyerReach" else BEAMS


def _id(name: str, where: str) -> str:
    return f"ves/{name}-v0" if where == SPACE else f"ves/{name}Emulated-v0"


def _settings(vehicle: str, where: str) -> dict[str, Any]:
    return {"vehicle": vehicle} | ({} if where == SPACE else {"laboratory": where})


def _controller(name: str, controller: str) -> Controller:
    if controller in CONTROLLERS:
        return get_controller(controller)
    return load_policy(released(f"ves/{name}-v0")[controller])


def _mark(name: str, vehicle: str, controller: str, where: str, episodes: int) -> str:
    """Digest of what a cell depends on, the engine apart."""
    settings = {**spec_of(_id(name, where)).kwargs, **_settings(vehicle, where)}
    settings.pop("goal", None)
    files = b""
    if controller not in CONTROLLERS:
        files = released(f"ves/{name}-v0")[controller].read_bytes()
    return content_hash([build_task(**settings).to_dict(), files.hex(), episodes])[:16]


def _run(
    name: str, vehicle: str, controller: str, where: str, episodes: int
) -> dict[str, list[Any]]:
    """E_mean and success of every episode, from seeds 0, 1, ..."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EmulationWarning)  # the page shows what comes of it
        found = evaluate(
            _controller(name, controller),
            _id(name, where),
            episodes=episodes,
            threads=1,
            **_settings(vehicle, where),
        )
    return {
        "E_mean": [float(f"{row['E_mean']:.5g}") for row in found.rows],
        "success": [int(row["success"]) for row in found.rows],
        "failed": [int(row["failed"]) for row in found.rows],
    }


def _dumped(cells: dict[str, Any]) -> str:
    rows = [f"{json.dumps(key)}: {json.dumps(cell)}" for key, cell in sorted(cells.items())]
    return "{\n" + ",\n".join(rows) + "\n}\n"


# ---------------------------------------------------------------------------- page


def ratios(cells: dict[str, Any], key: str, where: str) -> Array:
    """E_mean of a laboratory over that in space, where both episodes ran to their end."""
    space, lab = (cells[f"{key} {k}"] for k in (SPACE, where))
    ended = ~(np.array(space["failed"], bool) | np.array(lab["failed"], bool))
    E = (np.array(cell["E_mean"], float)[ended] for cell in (lab, space))
    lab_E, space_E = E
    out: Array = lab_E[space_E > 0] / space_E[space_E > 0]
    return out


def page(cells: dict[str, Any], episodes: int) -> str:
    """The table as Markdown."""
    lines = [
        "<!-- written by scripts/laboratory_cost.py: change the code instead -->",
        "# What the laboratory costs",
        "",
        f"`python scripts/laboratory_cost.py`: {episodes} episodes each, the same in every",
        "column; controllers and policies as they ship. `E_mean` of the true base over that of",
        "the same episode in space: median (90th percentile), of the episodes that ran to the",
        "end in both. Success beside it; *n* failed where joint limits or a safety stop ended",
        "*n* episodes. The [laboratories](laboratory.md#7-named-laboratories) are those of the",
        "`...Emulated-v1` ids; no policy has been trained in one, nor on the straight beam.",
        "",
        "| environment | vehicle | controller | ideal: E_mean, success |"
        " nominal | lab | hard |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in SHIPPED:
        for vehicle in vehicles(name):
            for controller in SHIPPED[name]:
                key = f"{name} {vehicle} {controller}"
                row = [name, vehicle, controller, _ideal(cells[f"{key} {SPACE}"])]
                row += [_cost(cells, key, where) for where in LABORATORIES]
                lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines) + "\n"


def _ideal(cell: dict[str, Any]) -> str:
    return f"{np.median(cell['E_mean']):.3g} J, {_rates(cell)}"


def _cost(cells: dict[str, Any], key: str, where: str) -> str:
    found, cell = ratios(cells, key, where), cells[f"{key} {where}"]
    if not len(found):
        return f"–, {_rates(cell)}"
    return f"{np.median(found):.2f} ({np.quantile(found, 0.9):.2f}), {_rates(cell)}"


def _rates(cell: dict[str, Any]) -> str:
    failed = sum(cell["failed"])
    return f"{np.mean(cell['success']):.0%}" + (f", {failed} failed" if failed else "")


if __name__ == "__main__":
    main()
