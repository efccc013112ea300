"""Joint servo: proportional-derivative control with optional feed-forward."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector, freeze_arrays, unit
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.dynamics import drawn_configurations, inertia, inverse_dynamics
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.link import BANDWIDTH
from ves_gym.mechanics.motion import Samples
from ves_gym.mechanics.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class JointServo:
    """tau = kp (q_cmd - q) + kd (v_cmd - v) + tau_ff, per joint.

    The proportional and derivative parts act at every physics step. With `feedforward`
    tau_ff is the torque the commanded motion needs: on a base that stands still or, with
    `moving_base`, on the base as that motion moves it. That takes the whole motion in advance:
    who knows the present command alone (an environment) takes the base to stand still.
    """

    kp: Vector = unit("N m/rad")
    kd: Vector = unit("N m s/rad")
    feedforward: bool = True
    moving_base: bool = False  # the feed-forward knows how the described base will move
    source: str = "user"

    def __post_init__(self) -> None:
        freeze_arrays(self)
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

    def for_arm(self, arm: Arm, vehicle: Vehicle) -> JointServo:
        """Return the servo with gains for every joint of the arm on its vehicle: `OWN_GAINS`
        with the arm's own."""
        if not self.kp:
            default = own_gains(arm, vehicle)
            return replace(default, feedforward=self.feedforward, moving_base=self.moving_base)
        if len(self.kp) != arm.n:
            raise ParameterError(
                f"servo must have gains for {arm.n} joints, got {len(self.kp)}"
            )
        return self

    def holds(self, arm: Arm) -> bool:
        """True where joints are fed forward against the base, and do not yield to it; of links
        that bend and gears that give way nobody foresees what they take."""
        rigid = not (arm.bends or arm.geared)
        return self.feedforward and self.moving_base and rigid

    def torque_feedforward(
        self, arm: Arm, command: Samples, base: Sequence[Array] = ()
    ) -> Array:
        """Return the feed-forward torque (..., n) [N m] of a commanded motion, zero without it,
        on a base that moves by y, yd, ydd (..., 6); none: it stands still."""
        if not self.feedforward:
            return np.zeros_like(command.q)
        return inverse_dynamics(arm, command.q, command.v, command.a, base=base)[0]


HIGH_GAINS = JointServo(
    kp=(3000.0, 2000.0, 1000.0), kd=(50.0, 40.0, 30.0), source="thesis eq. 4.6"
)
PPED_GAINS = JointServo(
    kp=(210.0, 33.0, 20.0), kd=(72.0, 55.0, 17.0), source="thesis eq. 4.5, q = (45, 0, 0) deg"
)
OWN_GAINS = JointServo(kp=(), kd=(), source="the arm's own")  # see `own_gains`
OWN_SERVO = replace(OWN_GAINS, moving_base=True)  # of motions that are known beforehand
FREE = JointServo(kp=(0.0,) * 3, kd=(0.0,) * 3, feedforward=False, source="no servo")

_RATIO = 0.7  # damping ratio of a joint alone
_FASTEST = 600.0  # 1/s of a decaying joint: rk4 at 1.25 ms is stable up to 2200


@lru_cache(maxsize=64)
def own_gains(arm: Arm, vehicle: Vehicle) -> JointServo:
    """Return the default gains of a joint servo.

    The thesis's high gains for three joints of an arm without a bandwidth. Else kp = J w^2 and
    kd = 2 zeta J w with w = 2 pi times the bandwidth and zeta = 0.7: J is the largest inertia
    about the joint, others at rest, over configurations within the limits. Where links far out,
    or the base (its fastest response counts, that of its free mass), are so light that one of
    these gains would move some other way of arm and base faster than 600/s, J of the joints
    that take part is lowered until none does; so where links bend.
    """
    if arm.bandwidth is None and arm.n == len(HIGH_GAINS.kp):
        return HIGH_GAINS
    bandwidth = BANDWIDTH if arm.bandwidth is None else arm.bandwidth
    w = 2 * math.pi * bandwidth
    drawn = drawn_configurations(arm)
    J = np.diagonal(inertia(arm, drawn)[:, 6:, 6:], axis1=1, axis2=2).max(axis=0).copy()
    # a fast gain moves what is before a flexure, not what is beyond; and the base
    p, base = arm.bends, vehicle.base_model().full()[0]
    loose = np.zeros((len(drawn), *(p + arm.n + len(base),) * 2))
    arms, bases = slice(0, 6 + p + arm.n), np.r_[:6, 6 + p + arm.n : loose.shape[-1]]
    loose[:, arms, arms] = expand(arm).inertia(drawn, np.zeros((len(drawn), p)))
    loose[:, bases[:, None], bases] += base
    motors = slice(6 + p, 6 + p + arm.n)
    inverse = np.linalg.inv(loose)[:, motors, motors]
    most = _FASTEST / (2 * _RATIO * w)
    for _ in range(200):
        root = np.sqrt(J)
        values, ways = np.linalg.eigh(root[:, None] * inverse * root)
        worst = int(values[:, -1].argmax())
        if values[worst, -1] <= most:
            break
        J *= np.maximum(most / values[worst, -1], 0.5) ** (ways[worst, :, -1] ** 2)
    kp, kd = J * w**2, 2 * _RATIO * J * w
    source = f"{bandwidth:g} Hz and damping ratio {_RATIO:g} at the inertia of {arm.name}"
    return JointServo(kp=_rounded(kp), kd=_rounded(kd), source=source)


def _rounded(values: Array) -> Vector:
    return tuple(float(f"{k:.4g}") for k in values)
