"""Inverse dynamics and weight as matrices times the inertial numbers of the arm.

Both are linear in mass, first moment and inertia about the frame of each body, so the
derivative of the traced Newton-Euler equations (`engine/kernel/trace.py`) is the regressor.
Platform-top frame, linear part first. `mechanics/gravity.py` keeps the fewest combinations of
these numbers that the weight shows.
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array
from ves_gym.engine.kernel.compiled_function import CompiledFunction
from ves_gym.engine.kernel.maps import points
from ves_gym.engine.kernel.numbers import geometry
from ves_gym.engine.kernel.trace import regressor
from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.body_numbers import numbers_of_body


def inertial_parameters(arm: Arm) -> Array:
    """(10 (n + 1) + n,) numbers that `inertia_regressor` multiplies.

    Base first, of each body m [kg], m c (3) [kg m] and its inertia about the origin of its
    frame xx, xy, yy, xz, yz, zz [kg m^2] (Pinocchio's order); then the rotor inertias.
    """
    bodies = (arm.base, *(link.inertial for link in arm.links))
    return np.concatenate([*map(numbers_of_body, bodies), arm.column("rotor_inertia")])


def weight_parameters(arm: Arm) -> Array:
    """(4 (n + 1),) numbers that `gravity_regressor` multiplies: m, m c of each body."""
    bodies = inertial_parameters(arm)[: 10 * (arm.n + 1)].reshape(-1, 10)
    return bodies[:, :4].ravel()


def inertia_regressor(
    arm: Arm,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    a: npt.ArrayLike,
    *,
    spin: npt.ArrayLike = 0.0,
    turn: npt.ArrayLike = 0.0,
    accel: npt.ArrayLike = 0.0,
) -> Array:
    """Inverse dynamics on a moving base, per inertial number of the arm.

    Args:
        q, v, a: (..., n) joint angles [rad], rates [rad/s], accelerations [rad/s^2].
        spin, turn: (..., 3) angular velocity and acceleration of the base, platform axes.
        accel: (..., 3) acceleration of its origin less that of free fall, platform axes.

    Returns:
        (..., 6 + n, 10 (n + 1) + n): times `inertial_parameters` it is the wrench that the
        arm exerts on its base at the platform-top origin [N, N m] and the joint torques
        [N m], as in `dynamics.inverse_dynamics`. Leading axes broadcast.

    Raises:
        ParameterError: wrong shapes, or numbers that are not finite.
    """
    n = arm.n
    at = points(
        (q, n, "q"),
        (v, n, "v"),
        (a, n, "a"),
        (spin, 3, "spin"),
        (turn, 3, "turn"),
        (accel, 3, "accel"),
    )
    return _regressor(arm, True, 10 * (n + 1) + n, at)


def gravity_regressor(arm: Arm, q: npt.ArrayLike, g: npt.ArrayLike) -> Array:
    """Weight of the arm, per number of its bodies that weighs.

    Args:
        q: (..., n) joint angles [rad].
        g: (..., 3) free fall in platform axes [m/s^2] (`gravity.gravity_vector`).

    Returns:
        (..., 6 + n, 4 (n + 1)): times `weight_parameters` it is the weight's wrench on the
        base [N, N m] and the joint torques that hold the arm [N m]. Leading axes broadcast.

    Raises:
        ParameterError: wrong shapes, or numbers that are not finite.
    """
    at = points((q, arm.n, "q"), (g, 3, "g"))
    return _regressor(arm, False, 4 * (arm.n + 1), at)


def _regressor(arm: Arm, moving: bool, columns: int, x: Array) -> Array:
    rows = 6 + arm.n
    jacobian = _function(arm, moving)(x)
    return np.swapaxes(jacobian.reshape(*x.shape[:-1], columns, rows), -1, -2)


@lru_cache(maxsize=16)
def _function(arm: Arm, moving: bool) -> CompiledFunction:
    key = f"regressor {moving} {geometry(arm)}"
    return CompiledFunction(key, partial(regressor, arm, moving))
