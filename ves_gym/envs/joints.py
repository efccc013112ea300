"""What several tasks say alike about the joints: where episodes start, what moves them."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.envs.control import Acceleration, Control
from ves_gym.envs.task import Field, Scene, Task
from ves_gym.mechanics.arm import Arm


def wide(values: Vector, arm: Arm) -> Array:
    """One number per joint (joints,); fewer are repeated."""
    return np.resize(np.asarray(values, float), arm.n)


def joint_box(task: Task, centre: Vector, span: Vector) -> tuple[Array, Array]:
    """Lower and upper ends (joints,) of centre +- span [rad].

    Raises:
        ParameterError: a negative span, or a box beyond the joint limits.
    """
    arm = task.system.arm
    middle, half = wide(centre, arm), wide(span, arm)
    low, high = middle - half, middle + half
    least, most = arm.column("q_min"), arm.column("q_max")
    if (half < 0).any() or (low < least).any() or (high > most).any():
        limits = [np.rad2deg(k).round(1).tolist() for k in (low, high, least, most)]
        raise ParameterError(
            f"{task.kind}: episodes must start within the joint limits {limits[2]} to"
            f" {limits[3]} deg, got {limits[0]} to {limits[1]} deg"
        )
    return low, high


def require_control(task: Task, *kinds: str) -> None:
    """Raise ParameterError for a control that the task has no observation for."""
    if task.control.kind not in kinds:
        raise ParameterError(
            f"{task.kind}: control must be {' or '.join(kinds)}, got {task.control.kind}"
        )


def rate_fields(control: Control, arm: Arm) -> tuple[Field, ...]:
    """Return the fields of the joints' rates; where they follow a reference, of its rates.

    Args:
        control: of the task.
        arm: whose joints.
    """
    fast = arm.column("v_max")
    if not isinstance(control, Acceleration):
        return (Field("joint_rate", "rad/s", fast, "joint rates"),)
    most = arm.column("a_max") if control.a_max is None else wide(control.a_max, arm)
    return (
        Field("reference_rate", "rad/s", fast, "rate of the reference"),
        Field("reference_acceleration", "rad/s^2", most, "acceleration of the reference"),
    )


def rates(control: Control, s: Scene) -> tuple[Array, ...]:
    """Values of `rate_fields`."""
    if isinstance(control, Acceleration):
        return s.ref[:, 1], s.ref[:, 2]
    return (s.v,)
