"""Baselines: controllers, training, evaluation, and the policies that come with the package."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.baselines.config import TrainConfig as TrainConfig
    from ves_gym.baselines.minari_files import read_episodes as read_episodes
    from ves_gym.baselines.offline import OfflineConfig as OfflineConfig
    from ves_gym.baselines.offline import train_offline as train_offline

__all__ = ["OfflineConfig", "TrainConfig", "read_episodes", "train_offline"]

_HOMES = {
    "OfflineConfig": "offline",
    "TrainConfig": "config",
    "read_episodes": "minari_files",
    "train_offline": "offline",
}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
