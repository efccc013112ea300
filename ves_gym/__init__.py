"""A PUMA 560 on a long flexible beam in micro-gravity, judged by the energy in its base."""

__version__ = "0.1.0"
