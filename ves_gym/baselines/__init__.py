"""Baselines: controllers, training, evaluation, and the policies that come with the package."""

from typing import TYPE_CHECKING

from ves_gym._util.lazy import lazily as _lazily

if TYPE_CHECKING:
    from ves_gym.baselines.config import TrainConfig as TrainConfig

__all__ = ["TrainConfig"]

_HOMES = {"TrainConfig": "config"}
__getattr__, __dir__ = _lazily(__name__, _HOMES)
