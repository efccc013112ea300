"""Joint servo: proportional-derivative control with optional feed-forward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector, unit
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import inverse_dynamics
from ves_gym.mechanics.motion import Samples


@dataclass(frozen=True, kw_only=True)
class JointServo:
    """tau = kp (q_cmd - q) + kd (v_cmd - v) + tau_ff, per joint.

    The proportional and derivative parts act at every physics step. With `feedforward`
    tau_ff is the torque the commanded motion needs on a base that stands still.
    """

    kp: Vector = unit("N m/rad")
    kd: Vector = unit("N m s/rad")
    feedforward: bool = True
    source: str = "user"

    def __post_init__(self) -> None:
        for name in ("kp", "kd"):
            gains = getattr(self, name)
            try:
                array = np.asarray(gains)
            except ValueError:  # ragged
                array = np.empty((0, 0))
            good = array.ndim == 1 and array.dtype.kind in "fiu" and np.isfinite(array).all()
            if not good or (array < 0).any():
                raise ParameterError(
                    f"JointServo.{name} must be finite and >= 0, one per joint, got {gains!r}"
                )
        if len(self.kp) != len(self.kd):
            raise ParameterError(
                f"JointServo needs as many kp as kd, got {len(self.kp)} and {len(self.kd)}"
            )

    def torque_feedforward(self, arm: Arm, command: Samples) -> Array:
        """Return the feed-forward torque of a commanded motion; zero without it.

        Args:
            arm: the arm as described.
            command: angles, rates and accelerations (..., n).

        Returns:
            (..., n) [N m].
        """
        if not self.feedforward:
            return np.zeros_like(command.q)
        return inverse_dynamics(arm, command.q, command.v, command.a)[0]


HIGH_GAINS = JointServo(
    kp=(3000.0, 2000.0, 1000.0), kd=(50.0, 40.0, 30.0), source="thesis eq. 4.6"
)
PPED_GAINS = JointServo(
    kp=(210.0, 33.0, 20.0), kd=(72.0, 55.0, 17.0), source="thesis eq. 4.5, q = (45, 0, 0) deg"
)
FREE = JointServo(kp=(0.0,) * 3, kd=(0.0,) * 3, feedforward=False, source="no servo")
