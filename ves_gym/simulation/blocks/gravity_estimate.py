"""The estimate of the arm's weight that the emulation subtracts, as a block."""

from __future__ import annotations

from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.engine.batch_parameters import Bodies
from ves_gym.engine.kernel.maps import weight_function
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.gravity import gravity_vector, gravity_wrench
from ves_gym.simulation.blocks.block import Block, LoopShape, Memory, Values
from ves_gym.system.deviations import LoopParameters


class GravityEstimate(Block):
    """Weight from measured joints and pose (thesis eq. 3.5, 3.9), possibly an old one."""

    name = "gravity_estimate"
    outputs = ("weight",)

    def __init__(self, arm: Arm, shape: LoopShape, oldest: int, tabulated: bool) -> None:
        """`oldest`: periods to look back over; `tabulated`: from a table, not the model."""
        self.arm, self.shape, self.oldest, self.tabulated = arm, shape, oldest, tabulated
        self._weights = weight_function(arm)
        self.inputs = ("table",) if tabulated else ("q", "y_measured")

    @property
    def memory(self) -> dict[str, Memory]:
        return {"history": Memory((self.oldest + 1, 6))}  # earlier estimates, newest first

    @property
    def structure(self) -> tuple[Any, ...]:
        geometry = [(k.d, k.a, k.alpha, k.beta, k.offset) for k in self.arm.links]
        return (self.arm.mount, geometry, self.oldest, self.tabulated)

    def parameters(self, p: LoopParameters, bodies: Bodies) -> dict[str, Array]:
        return {
            "mass": p.gravity_mass,
            "P": p.gravity_P,
            "tilt": p.gravity_tilt,
            "shares": shares(p.gravity_delay / self.shape.control_dt, self.oldest + 1),
        }

    def estimate(self, p: Values, u: Values) -> Array:
        """Present estimate (n, 6)."""
        if self.tabulated:
            return u["table"]
        g = gravity_vector(self._pose(p, u))
        return gravity_wrench(self.arm, u["q"], g, p["mass"], p["P"])

    @staticmethod
    def _pose(p: Values, u: Values) -> Array:
        """Pose (n, 6) that the estimate is given [m, rad]."""
        y = u["y_measured"]
        return np.concatenate([y[:, :3], y[:, 3:] + p["tilt"]], axis=-1)

    def step(
        self, p: Values, x: Values, u: Values
    ) -> tuple[dict[str, Array], dict[str, Array]]:
        fresh = self.estimate(p, u)
        history = np.concatenate([fresh[:, None], x["history"][:, :-1]], axis=1)
        return {"history": history}, {"weight": mixed(p["shares"], history)}

    def start(self, p: Values, u: Values) -> tuple[dict[str, Array], dict[str, Array]]:
        if self.tabulated:
            fresh = u["table"]
        else:  # what `estimate` gives, sooner
            fresh = self._weights(u["q"], self._pose(p, u), p["mass"][:, None], p["P"])
        history = np.repeat(fresh[:, None], self.oldest + 1, axis=1)
        return {"history": history}, {"weight": fresh}


def shares(age: Array, nodes: int) -> Array:
    """Return weights (n, nodes) that interpolate past values linearly at an age.

    Args:
        age: (n,) in periods, 0 to nodes - 1.
        nodes: values remembered, newest first.
    """
    away: Array = np.abs(np.arange(nodes) - age[:, None])
    return np.asarray(np.clip(1 - away, 0.0, None), dtype=np.float64)


def mixed(weights: Array, history: Array) -> Array:
    """Return sums of remembered values.

    Args:
        weights: (n, m).
        history: (n, m, c).

    Returns:
        (n, c).
    """
    out: Array = (weights[:, None, :] @ history)[:, 0]
    return out
