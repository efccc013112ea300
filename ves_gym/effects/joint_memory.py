"""Joint friction that depends on how a joint has moved: of a diagnosis, without a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, Vector
from ves_gym.system.deviations import Delays
from ves_gym.system.effect import DelayEffect, parameter, register
from ves_gym.system.system import System

_FAR = (-500.0, 500.0)
LEVELS = ("lasting", "rested_fast", "rested", "rested_slow")  # in the order of `RESTING`


@register("joint/memory")
@dataclass(frozen=True, kw_only=True)
class JointMemory(DelayEffect):
    """Friction that builds up over a distance after a reversal and grows while a joint rests.

    A diagnosis writes it where something is missing that is not in its library. The torque is
    -z max(0, lasting + sum of rested_k a_k), z a bristle's deflection, z' = (v - |v| z) / b,
    and the age a_k of the rest in parts of 1, a_k' = (1 - a_k) / T_k - |v| a_k / c
    (`rest_friction`). |z| <= 1, so it is bounded; it takes energy out but for what the bristles
    hold, the level times b / 2 at most.
    """

    modes = ("ideal", "emulated")
    port = "joint"
    shows = ("joint",)
    hidden = "it stands for what has no name; a diagnosis writes it where nothing else is left"
    lasting: Vector = parameter("N m", bounds=_FAR, shape=(None,))
    rested_fast: Vector = parameter("N m", bounds=_FAR, shape=(None,))  # T of 0.5 s
    rested: Vector = parameter("N m", bounds=_FAR, shape=(None,))  # 1.5 s
    rested_slow: Vector = parameter("N m", bounds=_FAR, shape=(None,))  # 5 s

    def check(self, system: System) -> None:
        """One number per joint in each, on motors."""
        self._require_per_joint(system, *LEVELS)
        self._require_motor(system)

    @property
    def levels(self) -> Array:
        """(joints, 1 + K, ...) lasting friction, and that of each time of rest [N m]."""
        return np.stack([np.asarray(getattr(self, name), float) for name in LEVELS], axis=1)

    def wire(self, delays: Delays) -> None:
        """Add to the friction of all simulations."""
        delays.friction = delays.friction + self.levels
