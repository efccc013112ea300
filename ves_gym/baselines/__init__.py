"""Baselines: controllers, training, evaluation, and the policies that come with the package."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.baselines.config import TrainConfig as TrainConfig
    from ves_gym.baselines.minari_files import read_episodes as read_episodes

__all__ = ["TrainConfig", "read_episodes"]

_HOMES = {
    "TrainConfig": "config",
    "read_episodes": "minari_files",
}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
