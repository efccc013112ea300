"""Baselines: controllers, training, evaluation, and the policies that come with the package."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.baselines.action_repeat import ActionRepeat as ActionRepeat
    from ves_gym.baselines.config import TrainConfig as TrainConfig
    from ves_gym.baselines.minari_files import read_episodes as read_episodes
    from ves_gym.baselines.policy import save_policy as save_policy
    from ves_gym.baselines.sb3 import Sb3VecEnv as Sb3VecEnv
    from ves_gym.baselines.sb3 import from_sb3 as from_sb3

__all__ = [
    "ActionRepeat",
    "Sb3VecEnv",
    "TrainConfig",
    "from_sb3",
    "read_episodes",
    "save_policy",
]

_HOMES = {
    "ActionRepeat": "action_repeat",
    "Sb3VecEnv": "sb3",
    "TrainConfig": "config",
    "from_sb3": "sb3",
    "read_episodes": "minari_files",
    "save_policy": "policy",
}
_lazily(__name__, _HOMES)
