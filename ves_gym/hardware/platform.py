"""How the platform follows its command: a servo in pose space.

The second level of detail is `LegServo` (`leg_servo`): six hydraulic legs with valve,
transducer and filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ves_gym._util.params import Array, require_positive, require_types, unit


@dataclass(frozen=True, kw_only=True)
class PoseServo:
    """A second-order servo on each of the six coordinates, all alike.

    e'' + 2 zeta w e' + w^2 e = 0 with e = Y - Y_cmd. With `rate_feedforward` the command
    moves on at its own rate between samples and e' counts from it, so that steady motion
    is followed without lag; without it the command is held and Y' is damped absolutely,
    as legs do that are sent lengths only. Default bandwidth: the thesis's platform with
    its filter (DESIGN: 8 Hz).
    """

    kind: ClassVar[str] = "pose"
    bandwidth: float = unit("Hz", default=8.0)  # natural frequency w / 2 pi
    damping_ratio: float = unit("1", default=0.7)
    rate_feedforward: bool = True

    def __post_init__(self) -> None:
        require_positive(self, "bandwidth", "damping_ratio")
        require_types(self, "rate_feedforward")

    @property
    def lag(self) -> float:
        """Delay of a slow motion [s]: 2 zeta / w, none with rate feed-forward."""
        w = 2 * np.pi * self.bandwidth
        return 0.0 if self.rate_feedforward else float(2 * self.damping_ratio / w)


def second_order(w: Array, zeta: Array, t: Array) -> Array:
    """Return the response of e'' + 2 zeta w e' + w^2 e = 0.

    Args:
        w: (n,) natural frequencies [rad/s].
        zeta: (n,) damping ratios [1].
        t: (m,) instants [s].

    Returns:
        (n, m, 3, 2): e, e', e'' at the instants per unit of e and e' at 0.
    """
    w, zeta = w[:, None], zeta[:, None]
    root = w * np.sqrt(np.asarray(zeta**2 - 1, complex))
    decay = np.exp(-zeta * w * t)
    swing = np.cosh(root * t)
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = np.where(np.abs(root) * t > 1e-6, np.sinh(root * t) / root, t)
    c, s = (decay * swing).real, (decay * shift).real
    out = np.empty((*c.shape, 3, 2))
    out[..., 0, 0], out[..., 0, 1] = c + zeta * w * s, s
    out[..., 1, 0], out[..., 1, 1] = -(w**2) * s, c - zeta * w * s
    out[..., 2, :] = -(w**2)[..., None] * out[..., 0, :]
    out[..., 2, :] -= (2 * zeta * w)[..., None] * out[..., 1, :]
    return out
