"""Write docs/api.md from the docstrings: `python scripts/api.py`.

tests/test_api.py compares: the page does not go stale.
"""

from __future__ import annotations

import importlib
import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import ves_gym as vg

PAGE = Path(__file__).parents[1] / "docs" / "api.md"

GROUPS = {
    "Verbs": (
        "simulate plan compare coupling_map diagnose evaluate train energy check_emulation"
        " render export excitation calibrate"
    ),
    "Model": (
        "System Arm Link Inertial PUMA_560 Beam MatrixVehicle Satellite get_vehicle"
        " EmulatorSettings JointServo Motion"
    ),
    "Simulation": "Simulator State Divergence RunLog Energies EnergyBalance rollout_gradients",
    "Effects": "effects Effect parameter register_effect",
    "Planning": "Query Case load_case Plan Planner NoPlan register_planner",
    "Environments and policies": "Task register_task Policy Controller load_policy",
    "Diagnosis and board": "Diagnosis Candidate MjcfMachine make_entry verify_entry",
    "Errors": "ParameterError",
}
ROOMS = (
    "baselines",
    "diagnosis",
    "envs",
    "experiments",
    "hardware",
    "leaderboard",
    "mechanics",
    "planners",
    "report",
    "simulation",
)
CONSTANTS = {
    "PUMA_560": "The thesis's arm, without its wrist.",
    "BENT": "The thesis's bent beam by finite elements, with its internal modes.",
    "BENT_THESIS": "The same with six condensed modes, as in thesis App. A.",
}

HEAD = """# Names

`import ves_gym as vg` has every name below. SI units, angles in radians. `help(vg.simulate)`
shows arguments, shapes and errors. Bad input raises `vg.ParameterError`.

A result prints in one line, shows itself in a notebook, and draws itself: `plot(ax=None)` takes
matplotlib axes and returns them. `RunLog.plot` has three panels, or base energy alone in one;
`CouplingMap.plot` takes `paths=[plan, ...]`, `Comparison.plot` `log=True`, that of `evaluate`
`measure="E_int"`. Logs, motions, systems, vehicles and cases have `save` and `load` (vehicles:
`get_vehicle`, cases: `load_case`); maps (.npz), comparisons, evaluations and a `Diagnosis`
(.json) have `save`.
"""
MIDDLE = """
## Rarer things

Under the package that they belong to: `vg.simulation.weigh_poses(...)`, or
`from ves_gym.simulation import weigh_poses`; `help(vg.simulation.weigh_poses)` describes it.
What is not named here may change between versions.
"""


def summary(value: Any, name: str) -> str:
    """Return the first sentence of a docstring, fit for a list."""
    name = name.rpartition(".")[2]
    if name in CONSTANTS:
        return CONSTANTS[name]
    text = inspect.getdoc(value) or ""
    first = " ".join(text.split("\n\n")[0].split())
    sentence = re.match(r".+?[.](?= |$)", first)
    return sentence[0] if sentence else first


def row(name: str, value: Any) -> str:
    """Return the line of a name."""
    call = f"{name}()" if inspect.isfunction(value) else name
    return f"- `{call}`: {summary(value, name)}"


def page() -> str:
    """Return the text of the page."""
    parts = [HEAD]
    for title, names in GROUPS.items():
        rows = [row(name, getattr(vg, name)) for name in names.split()]
        parts.append("\n".join([f"## {title}\n", *rows, ""]))
    parts.append(MIDDLE.strip("\n") + "\n")
    for room in ROOMS:
        names = ", ".join(
            f"`{name}`" for name in importlib.import_module(f"ves_gym.{room}").__all__
        )
        parts.append(textwrap.fill(f"- `{room}`: {names}", 96, subsequent_indent="  "))
    parts.append("")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
