"""What several tasks say alike about the joints: where episodes start, what moves them."""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array, ParameterError, Vector
from ves_gym.envs.control import Control, SmoothReference
from ves_gym.envs.task import Field, Scene, Task
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.motion import QUINTIC_PEAK_SPEED

# controls that move a reference smoothly, by acceleration or by velocity
REFERENCES = ("acceleration", "joint_velocity", "tool_velocity")


def wide(values: Vector, arm: Arm) -> Array:
    """One number per joint (joints,); fewer are repeated."""
    return np.resize(np.asarray(values, float), arm.n)


def joint_box(task: Task, centre: Vector, span: Vector) -> tuple[Array, Array]:
    """Lower and upper ends (joints,) of centre +- span [rad].

    Numbers that are not one per joint are meant for another arm: repeated, and cut to what
    this one's limits leave.

    Raises:
        ParameterError: a negative span, or a box beyond the joint limits.
    """
    middle, half = middle_and_half(task.system.arm, centre, span)
    return _require_inside(task, middle, half)


def middle_and_half(arm: Arm, centre: Vector, span: Vector) -> tuple[Array, Array]:
    """Return the middle and half the width (joints,) of the box centre +- span [rad].

    Args:
        arm: whose joints; see `joint_box`.
        centre: of the box.
        span: to either side.
    """
    middle, half = wide(centre, arm), wide(span, arm)
    if arm.n in (len(span), 3):
        return middle, half
    least, most = arm.column("q_min"), arm.column("q_max")
    half = np.minimum(half, _SHARE * (most - least) / 2)
    spare = half + 1e-9  # rad, rounding
    return np.clip(middle, least + spare, most - spare), half


def home_of(arm: Arm, home: Vector) -> Array:
    """Return the angles (joints,) where episodes are about [rad], see `joint_box`.

    Args:
        arm: whose joints.
        home: as the task has it.
    """
    return middle_and_half(arm, home, home if arm.n == len(home) else (0.0,))[0]


_SHARE = 0.9  # of a joint's range, the most that a box meant for another arm takes


def drawn_joints(arm: Arm, least: int = 6) -> int:
    """Return for how many joints an episode's numbers are drawn: `least`, or the arm's.

    Args:
        arm: whose joints.
        least: so that arms with fewer joints have the same beginnings whatever the number.
    """
    return max(least, arm.n)


def _require_inside(task: Task, middle: Array, half: Array) -> tuple[Array, Array]:
    arm = task.system.arm
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


def straight_pace(arm: Arm, way: Array, seconds: float) -> Array:
    """Return the largest share of its speed that a joint takes on straight quintics.

    Args:
        arm: whose joints.
        way: (..., joints) from their starts to their ends [rad].
        seconds: that they take [s].

    Returns:
        (...,); up to one is within the limits.
    """
    speed = np.abs(way) * (QUINTIC_PEAK_SPEED / seconds)
    pace: Array = (speed / arm.column("v_max")).max(axis=-1)
    return pace


def rate_fields(control: Control, arm: Arm) -> tuple[Field, ...]:
    """Return the fields of the joints' rates; where they follow a reference, of its rates.

    Args:
        control: of the task.
        arm: whose joints.
    """
    fast = arm.column("v_max")
    if not isinstance(control, SmoothReference):
        return (Field("joint_rate", "rad/s", fast, "joint rates"),)
    most = np.resize(control.limits(arm), arm.n)
    return (
        Field("reference_rate", "rad/s", fast, "rate of the reference"),
        Field("reference_acceleration", "rad/s^2", most, "acceleration of the reference"),
    )


def rates(control: Control, s: Scene) -> tuple[Array, ...]:
    """Values of `rate_fields`."""
    if isinstance(control, SmoothReference):
        return s.ref[:, 1], s.ref[:, 2]
    return (s.v,)
