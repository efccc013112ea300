"""How the platform follows its command: the interface, and a servo in pose space.

Two levels of detail stand behind `Follower`: `PoseServo` here, a second-order servo per
axis, and `LegServo` (`legs`), six hydraulic legs with valve, transducer and filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
import scipy

from ves_gym._util.params import Array, Index, require_positive, unit


class Follower(Protocol):
    """n platforms in motion. Leading axis = simulation; nodes 0 .. k are the physics steps
    of one control period, node 0 is now."""

    def reset(self, ids: Index, y: Array, yd: Array) -> None:
        """Put platforms at a pose, moving, commanded to be there.

        Args:
            ids: (m,) which.
            y, yd: (m, 6) pose [m, rad] and its rate.
        """

    def advance(self, y_cmd: Array, yd_cmd: Array) -> tuple[Array, Array, Array]:
        """Follow the command for one control period.

        Args:
            y_cmd, yd_cmd: (n, 6) commanded pose [m, rad] and its rate.

        Returns:
            Y, Y', Y'' (n, k + 1, 6) at the period's nodes.
        """

    def measured(self) -> Array:
        """Pose (n, 6) as the platform's own sensors report it."""

    def get_state(self) -> tuple[Array, ...]:
        """Arrays with leading axis n: everything needed to continue exactly."""

    def set_state(self, state: tuple[Array, ...]) -> None:
        """Return to a state handed out by `get_state`."""


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

    @property
    def lag(self) -> float:
        """Delay of a slow motion [s]: 2 zeta / w, none with rate feed-forward."""
        w = 2 * np.pi * self.bandwidth
        return 0.0 if self.rate_feedforward else float(2 * self.damping_ratio / w)


class PoseFollower:
    """`Follower` of a `PoseServo`, bandwidth [Hz] and damping ratio per simulation."""

    def __init__(
        self,
        servo: PoseServo,
        n: int,
        nodes: Array,
        bandwidth: Array | None = None,
        damping_ratio: Array | None = None,
    ) -> None:
        """`nodes` (k + 1,): instants of one control period [s], from 0."""
        w = (
            2
            * np.pi
            * np.broadcast_to(servo.bandwidth if bandwidth is None else bandwidth, (n,))
        )
        zeta = np.broadcast_to(
            servo.damping_ratio if damping_ratio is None else damping_ratio, (n,)
        )
        self.feedforward, self.nodes = servo.rate_feedforward, nodes
        self._answer = _second_order(w, zeta, nodes)  # (n, k + 1, 3, 2): e, e', e'' from e, e'
        self.y, self.yd = np.zeros((n, 6)), np.zeros((n, 6))

    def put(self, ids: Index, bandwidth: Array, damping_ratio: Array) -> None:
        """Give some platforms another servo.

        Args:
            ids: (m,) which.
            bandwidth: (m,) [Hz].
            damping_ratio: (m,) [1].
        """
        self._answer[ids] = _second_order(2 * np.pi * bandwidth, damping_ratio, self.nodes)

    def reset(self, ids: Index, y: Array, yd: Array) -> None:
        self.y[ids], self.yd[ids] = y, yd

    def advance(self, y_cmd: Array, yd_cmd: Array) -> tuple[Array, Array, Array]:
        rate = yd_cmd if self.feedforward else np.zeros_like(yd_cmd)
        error = np.stack([self.y - y_cmd, self.yd - rate], axis=1)  # (n, 2, 6)
        k = len(self.nodes)
        path = (self._answer.reshape(-1, 3 * k, 2) @ error).reshape(-1, k, 3, 6)
        y = y_cmd[:, None] + rate[:, None] * self.nodes[:, None] + path[:, :, 0]
        yd = rate[:, None] + path[:, :, 1]
        self.y, self.yd = y[:, -1], yd[:, -1]
        return y, yd, path[:, :, 2]

    def poses(self, y_cmd: Array, yd_cmd: Array) -> Array:
        """Return the poses at the ends of N periods; the state stays as it is.

        As N times `advance`, at once. The error's two-number recursion z+ = A z + d is, for its
        first number, one of second order.

        Args:
            y_cmd, yd_cmd: (n, N, 6) commands.

        Returns:
            (n, N, 6) [m, rad].
        """
        rate = yd_cmd if self.feedforward else np.zeros_like(yd_cmd)
        A = self._answer[:, -1, :2]  # (n, 2, 2) of the error over a period
        ahead = np.stack([y_cmd + rate * self.nodes[-1], rate], axis=2)  # (n, N, 2, 6)
        drive = ahead - np.einsum("nij,nkjc->nkic", A, np.stack([y_cmd, rate], axis=2))
        forced = drive[:, :, 0].copy()
        forced[:, 1:] += A[:, 0, 1, None, None] * drive[:, :-1, 1]
        forced[:, 1:] -= A[:, 1, 1, None, None] * drive[:, :-1, 0]
        det: Array = np.linalg.det(A)
        forced[:, 0] += A[:, 0, 0, None] * self.y + A[:, 0, 1, None] * self.yd
        forced[:, 1:2] -= (det[:, None] * self.y)[:, None]
        out: Array = np.empty(forced.shape)
        for i, a in enumerate(A):
            poles = [1.0, -a[0, 0] - a[1, 1], det[i]]
            out[i] = scipy.signal.lfilter([1.0], poles, forced[i], axis=0)
        return out

    def measured(self) -> Array:
        return self.y

    def get_state(self) -> tuple[Array, ...]:
        return self.y.copy(), self.yd.copy()

    def set_state(self, state: tuple[Array, ...]) -> None:
        self.y, self.yd = (part.copy() for part in state)


def _second_order(w: Array, zeta: Array, t: Array) -> Array:
    """(n, m, 3, 2): e, e', e'' at the instants t per unit of e and e' at 0."""
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


def make_follower(servo: Any, n: int, nodes: Array, **options: Any) -> Follower:
    """Return the runtime of a platform servo.

    Args:
        servo: `PoseServo` or `LegServo`.
        n: simulations.
        nodes: (k + 1,) times within a control period [s].
        options: as `PoseFollower` takes them.
    """
    return PoseFollower(servo, n, nodes, **options)
