"""`ves-gym train`: policies from a configuration, one per seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ves_gym.api as vg
from ves_gym.baselines.config import LEARNERS, choose_config
from ves_gym.baselines.evaluate import with_deviations
from ves_gym.cli.evaluate import ARM
from ves_gym.cli.flags import Answer, Flag, integer, integers, one_of, text
from ves_gym.cli.machine import EFFECT
from ves_gym.system.effect import Effect

FLAGS = (
    Flag("CONFIG", help="a .toml file, or an environment: ves/PumaDamp-v0"),
    Flag("--algo", "A", text, "ppo, sac, sac-her or another label of a configuration"),
    Flag("--learner", "L", one_of(*LEARNERS),
         f"{' or '.join(LEARNERS)} (default the configuration's); native: PPO in NumPy"),
    Flag("--imitate", "C", text, "a controller whose actions are learned first (native)"),
    Flag("--steps", "N", integer(), "instead of the configuration's"),
    Flag("--seeds", "0,1", integers, "default the configuration's; --seed is added to each"),
    Flag("--workers", "N", integer(1), "seeds at once"),
    Flag("--resume", help="go on from the checkpoints"),
    Flag("--tensorboard", "DIR", text, "show the curves as they grow there"),
    ARM,
    EFFECT,
)  # fmt: skip


def run(
    config: str,
    *,
    algo: str | None = None,
    seeds: tuple[int, ...] | None = None,
    seed: int = 0,
    arm: str | None = None,
    effect: tuple[Effect, ...] = (),
    out: Path | None = None,
    progress: Any = None,
    **how: Any,
) -> Answer:
    """Train, write policies and learning curves; a line per seed."""
    chosen = choose_config(config, algo)
    result = vg.train(
        chosen,
        seeds=[k + seed for k in seeds or chosen.seeds],
        settings=with_deviations(chosen.env, chosen.settings, effect, arm),
        folder=out,
        progress=progress,
        **how,
    )
    return Answer(text=result, plain=result.to_dict())
