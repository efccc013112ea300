"""The joints' servo: what the drives are told, and what they give."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.trial.arm import Array, Bodies, Table, arm_bodies

Motion = Callable[[Array], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class Servo:
    """kp (q_cmd - q) + kd (v_cmd - v) and, if asked for, the torque that the motion needs."""

    kp: Array  # (n,) [N m/rad]
    kd: Array  # (n,) [N m s/rad]
    feedforward: bool = False


def needed_torque(bodies: Bodies, q: Array, v: Array, a: Array, weight: bool) -> Array:
    """Return the torque (N, n) for a motion on a base at rest.

    Args:
        bodies: of the arm as described.
        q, v, a: (N, n) [rad, rad/s, rad/s^2].
        weight: with the arm's weight.
    """
    out = np.empty_like(q)
    still = np.zeros(6)
    for k in range(len(q)):
        z, rate = np.concatenate([still, q[k]]), np.concatenate([still, v[k]])
        M, c = bodies.terms(z, rate)
        out[k] = M[6:, 6:] @ a[k] + c[6:]
        if weight:
            out[k] -= bodies.weight(z)[6:]
    return out


def command(
    description: Table, servo: Servo, motion: Motion, t: Array, delay: float, weight: bool
) -> Array:
    """Return kp q_cmd + kd v_cmd + feed-forward (N, n) at times t, sent `delay` earlier."""
    q, v, a = motion(np.maximum(t - delay, 0.0))
    c = servo.kp * q + servo.kd * v
    if servo.feedforward:
        c = c + needed_torque(arm_bodies(description["arm"]), q, v, a, weight)
    return c
