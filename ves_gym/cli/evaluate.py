"""`ves-gym evaluate`: controllers and policies side by side on the same episodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym.baselines.evaluate import with_deviations
from ves_gym.baselines.registry import CONTROLLERS
from ves_gym.cli.flags import Answer, Flag, integer, names, read, text
from ves_gym.cli.machine import EFFECT, arm_flag
from ves_gym.system.effect import Effect

ARM = replace(arm_flag("that of the environment"), read=text)  # settings have it by name
FLAGS = (
    Flag("ID", help="an environment, such as ves/PumaDamp-v0"),
    Flag("--controller", "A,B", names,
         f"of {', '.join(CONTROLLERS)}; default zero,random and the released policies"),
    Flag("--policy", "FILE", read(lambda value: value if value == "released" else Path(value)),
         "a policy's .json, a folder that `ves-gym train` made (its seeds as one), the name of"
         " a released policy (`ves-gym list policies`), or `released` for all of them;"
         " repeatable",
         many=True),
    Flag("--episodes", "N", integer(), "default 100"),
    Flag("--n-envs", "N", integer(1), "at once; changes no result"),
    Flag("--nominal", help="without randomisation"),
    ARM,
    EFFECT,
)  # fmt: skip


def run(
    id: str,
    *,
    controller: tuple[str, ...] = (),
    policy: tuple[str | Path, ...] = (),
    nominal: bool = False,
    arm: str | None = None,
    effect: tuple[Effect, ...] = (),
    seed: int = 0,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Evaluate; the table, and who beats whom."""
    settings = with_deviations(id, {"randomize": {}} if nominal else {}, effect, arm)
    comparison = vg.evaluate(
        id, [*controller, *policy], seed=seed, progress=progress, **how, **settings
    )
    return Answer(text=comparison, plain=comparison.to_dict())
