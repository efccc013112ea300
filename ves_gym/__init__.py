"""A PUMA 560 on a long flexible beam in micro-gravity, judged by the energy in its base."""

from importlib import import_module
from types import ModuleType

from ves_gym import envs as envs  # files every environment with Gymnasium
from ves_gym.system.effect import EFFECTS

__version__ = "0.2.0"

EFFECTS.fill = lambda: import_module("ves_gym.effects")  # when first asked for one by name


def __getattr__(name: str) -> ModuleType:
    if name == "effects":
        return import_module("ves_gym.effects")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
