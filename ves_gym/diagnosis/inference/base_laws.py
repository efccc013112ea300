"""A spring and a damper more at the base: what stands for a law there that has no name."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.effects.base import BaseUnknown
from ves_gym.mechanics.spatial import AXES
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.system.candidate import Number, placed
from ves_gym.system.system import System

Fields = dict[str, tuple[float, ...]]
_SLOW = 0.5  # Hz, of what stands for the own spring of a base that has none


def base_regressions(system: System) -> list[Candidate]:
    """Return springs and dampers more, one along each coordinate of the base.

    Weights are hundredths of the base's own stiffness, and of what damps it critically.

    Args:
        system: as described.

    Returns:
        Twelve; none of a satellite, which nothing holds.
    """
    if isinstance(system.vehicle, Satellite):
        return []
    base = system.base
    mass = np.diag(base.M)
    springs = np.maximum(np.diag(base.K), mass * (2 * np.pi * _SLOW) ** 2) / 100
    critical = 2 * np.sqrt(springs * mass / 100)
    sizes = {"stiffness": springs, "damping": critical}
    out = []
    for (name, size), (i, axis) in itertools.product(sizes.items(), enumerate(AXES)):

        def fields(x: Array, i: int = i, name: str = name, size: Array = size) -> Fields:
            return {name: tuple((np.eye(6)[i] * size * x[0]).tolist())}

        candidate = placed(BaseUnknown, axis, [Number(name, "1", (0.0, 1e4), (1.0,))], fields)
        out.append(replace(candidate, ports=("base", "wrench")))  # as the library's are
    return out
