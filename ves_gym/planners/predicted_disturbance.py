"""Predict how a motion moves base and tool, on the linear base of `prediction`."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array
from ves_gym.mechanics.motion import Motion
from ves_gym.planners.linear_response import LinearResponse
from ves_gym.planners.prediction import FINE, NODES, LinearBase, joint_momentum
from ves_gym.planners.query import Query
from ves_gym.system.disturbance import Disturbance

_AFTER = 3.0  # s after the motion in which peaks are looked for: a swing of 0.2 Hz


def predict_disturbance(query: Query, motion: Motion) -> Disturbance:
    """Predict the disturbance measures of an answer to a query.

    Small angles; the inertia follows the arm, joints give way on their servo.

    Args:
        query: system, servo, the base's motion at the start and the filter of `E_weighted`.
        motion: of the joints.
    """
    linear = LinearBase(query.system, query.servo)
    t = np.linspace(0.0, motion.duration, NODES * FINE + 1)
    u = joint_momentum(query.system, motion, t)
    response = LinearResponse(
        linear, motion, motion, t, u[..., None], query.weight, base=query.base, parts=FINE
    )

    def mean(name: str) -> float:
        rows, tail = response.mean_square(name)
        return float(np.sum(rows**2) + tail[0, 0])

    def size(values: Array) -> Array:
        return np.asarray(np.linalg.norm(values[..., 0], axis=-1), np.float64)

    def peak(name: str) -> float:
        return float(size(response.samples(name, float(t[1]), _AFTER)).max())

    return Disturbance(
        acceleration=mean("acceleration") ** 0.5,
        acceleration_peak=peak("acceleration"),
        angular=mean("angular") ** 0.5,
        angular_peak=peak("angular"),
        tip=mean("tip") ** 0.5,
        tip_peak=peak("tip"),
        tip_end=float(size(response.quantity("tip").nodes[-1])),
        displacement_peak=peak("displacement"),
        rotation_peak=peak("rotation"),
        attitude_end=float(size(response.quantity("rotation").nodes[-1])),
        E_weighted=mean("filtered"),
    )
