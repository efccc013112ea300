"""`TrainConfig`: everything that a training run is made of, as a TOML file."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ves_gym._util.params import (
    ParameterError,
    from_plain,
    read_table,
    require_choice,
    require_least,
    require_one_of,
    to_plain,
)
from ves_gym.baselines.evaluate import spec_of
from ves_gym.baselines.policy import ACTIVATIONS, task_name

CONFIGS = Path(__file__).parent / "configs"
GENERAL = "PumaReach-ppo"  # whose hyper-parameters serve where nobody has searched any
FEATURES, CRITICS = ("", "arm"), ("", "privileged")
ALGORITHMS = ("PPO", "DAgger")
_STAGES, _EASIER = 6, 0.6  # steps of a curriculum, and its share of the training


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """A training run.

    A step is a decision, held for `hold` control periods of each of `n_envs` environments.
    `settings` go to the environment (see `envs.build_task`); those of `curriculum`, name =
    [first, last], go from one to the other by equal factors over the first 0.6 of the training
    and are left alone when it is judged. `hyperparameters` are the fields of
    `ppo.Settings`; the learning rate falls linearly to `final_rate` of itself. Where the
    network or the noise start follows from `layers`, `activation` and `log_std`.

    With `imitate`, the policy first learns what a built-in controller does (`imitation` are
    the fields of `learner.ImitationConfig`); its decisions count as steps. Algorithm DAgger
    does no more than that.
    """

    env: str
    algorithm: str
    total_timesteps: int
    n_envs: int
    imitate: str = ""  # a controller, by its name
    imitation: dict[str, Any] = field(default_factory=dict)
    frames: int = 1  # observations that the policy sees, those of its last decisions
    features: str = ""  # arm: further inputs, see `arm_features.ArmFeatures`
    critic: str = ""  # privileged: PPO's critic sees `Batch.privileged` too
    hold: int = 1
    settings: dict[str, Any] = field(default_factory=dict)
    curriculum: dict[str, tuple[float, float]] = field(default_factory=dict)
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    hyperparameters: dict[str, Any] = field(default_factory=dict)
    layers: tuple[int, ...] = (64, 64)
    activation: str = "tanh"
    log_std: float = -1.0  # of PPO's noise at first
    final_rate: float = 0.0  # of the learning rate
    reward_scale: float = 1.0  # constant factor of the rewards that the algorithm sees
    eval_every: int = 0  # steps; 0: a twentieth of the run
    eval_episodes: int = 100

    def __post_init__(self) -> None:
        require_choice(self, "algorithm", ALGORITHMS)
        require_choice(self, "activation", ACTIVATIONS)
        require_choice(self, "features", FEATURES)
        require_choice(self, "critic", CRITICS)
        if (self.imitation or self.algorithm == "DAgger") and not self.imitate:
            raise ParameterError(
                "TrainConfig.imitation and algorithm DAgger need a controller to imitate"
            )
        counts = "total_timesteps", "n_envs", "hold", "frames", "eval_episodes"
        require_least(self, 1, *counts)
        require_least(self, 0, "eval_every")
        if not self.seeds or any(s < 0 for s in self.seeds):
            raise ParameterError(f"TrainConfig.seeds must be numbers >= 0, got {self.seeds}")
        if any(not min(ends) > 0 for ends in self.curriculum.values()):
            raise ParameterError(f"TrainConfig.curriculum must be > 0, got {self.curriculum}")
        if not 0 <= self.final_rate <= 1 or not self.reward_scale > 0:
            raise ParameterError(
                "TrainConfig needs 0 <= final_rate <= 1 and reward_scale > 0, got"
                f" {self.final_rate} and {self.reward_scale}"
            )

    def settings_at(self, steps: int) -> dict[str, Any]:
        """Settings of the environment after a number of decisions."""
        done = min(1.0, steps / (_EASIER * self.total_timesteps))
        share = int(_STAGES * done) / _STAGES
        return self.settings | {
            k: a * (b / a) ** share for k, (a, b) in self.curriculum.items()
        }

    @property
    def name(self) -> str:
        """Such as PumaRestToRest-ppo."""
        return f"{task_name(self.env)}-{self.label}"

    @property
    def label(self) -> str:
        """The algorithm's name in file names: ppo, resolved-ppo, closing-dagger."""
        return "-".join(filter(None, (self.imitate, self.algorithm.lower())))

    def learning_rate(self, rate: float, remaining: float) -> float:
        """Learning rate, `rate` at first, where a share `remaining` of the training is left."""
        return rate * (self.final_rate + (1 - self.final_rate) * max(0.0, remaining))

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        plain: dict[str, Any] = to_plain(self)
        return plain


def read_config(path: str | os.PathLike[str]) -> TrainConfig:
    """A configuration from a TOML or JSON file; unknown keys are an error."""
    config: TrainConfig = from_plain(TrainConfig, read_table(path), str(path))
    return config


def released_configs() -> list[TrainConfig]:
    """The configurations that come with the package."""
    return [read_config(path) for path in sorted(CONFIGS.glob("*.toml"))]


def find_configs(env: str, algorithm: str | None = None) -> list[TrainConfig]:
    """The configurations that come with the package for an environment.

    An ...Emulated id without its own is trained as its twin in space.
    """
    every = released_configs()
    chosen = [c for c in every if algorithm in (None, c.label, c.algorithm)]
    if not chosen:
        require_one_of("algorithm", algorithm, sorted({c.label for c in every}))
    matching = [c for c in chosen if c.env == env]
    if not matching:
        twin = env.replace("Emulated-v", "-v")
        matching = [dataclasses.replace(c, env=env) for c in chosen if c.env == twin]
    return matching


def choose_config(
    source: str | os.PathLike[str], algorithm: str | None = None, base: Path = Path()
) -> TrainConfig:
    """Return the configuration that a text stands for.

    Args:
        source: a .toml or .json file, a name such as PumaDamp-ppo, or a registered environment,
            which has at least ppo.
        algorithm: its label, such as ppo; None: the first there is.
        base: folder that paths start from.

    Raises:
        ParameterError: no such file or configuration, or it is for another algorithm.
    """
    text = str(source)
    shipped = CONFIGS / f"{text}.toml"
    if Path(text).suffix in (".toml", ".json") or shipped.is_file():
        config = read_config(shipped if shipped.is_file() else base / text)
        if algorithm not in (None, config.algorithm, config.label):
            raise ParameterError(f"{text} is for {config.label}, got algorithm {algorithm}")
        return config
    name = text if "/" in text else f"ves/{text}"
    spec_of(name)  # an unknown id is refused with those that it may have meant
    configs = find_configs(name, algorithm)
    if configs:
        return configs[0]
    if algorithm not in (None, "ppo", "PPO"):
        labels = ", ".join(sorted({"ppo", *(c.label for c in find_configs(name))}))
        raise ParameterError(
            f"{name} has no {algorithm}: give a .toml file, or one of {labels}"
        )
    general = read_config(CONFIGS / f"{GENERAL}.toml")
    of_its_task: dict[str, Any] = {"features": "", "settings": {}, "curriculum": {}}
    return dataclasses.replace(general, env=name, **of_its_task)
