"""A PUMA 560 on a long flexible beam in micro-gravity, judged by the energy in its base."""

from ves_gym import effects as effects  # files every effect under its name
from ves_gym import envs as envs  # files every environment with Gymnasium

__version__ = "0.1.0"
