"""Momentum of arm, satellite and what it carries: kept where no jet blows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.carried import carried_inertia
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.spatial import matvec, rotation, twist
from ves_gym.system.bending import Internal
from ves_gym.system.system import System


def momentum(
    system: System,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    y: npt.ArrayLike,
    yd: npt.ArrayLike,
    internal: Internal | None = None,
) -> Array:
    """Return linear and angular momentum in inertial axes, the latter about their origin.

    The rotors of the arm's joints turn with their joints only and carry none (docs/physics.md).

    Args:
        system: arm and satellite.
        q, v: (..., n) joint angles [rad] and rates [rad/s].
        y, yd: (..., 6) pose of the base and its rate.
        internal: coordinates and rates (..., k) of wheels and appendages.

    Returns:
        (..., 6) [kg m/s, kg m^2/s].

    Raises:
        ParameterError: the vehicle is no body in free space, or `internal` is missing.
    """
    base = system.base
    system.arm.require_rigid("momentum")
    if base.body is None:
        raise ParameterError(
            f"momentum needs a satellite, got a vehicle of kind {system.vehicle.kind}"
        )
    if base.m:
        raise ParameterError(
            f"momentum needs bodies on the satellite, got {base.m} of its `extra` masses, whose"
            " place beside their way is not known: describe them as appendages"
        )
    pose, rates = np.asarray(y, float), np.asarray(v, float)
    moving, H = twist(pose, yd), inertia(system.arm, q)
    carried = matvec(H[..., :6, :6] + base.body.spatial(), moving)
    carried = carried + matvec(H[..., :6, 6:], rates)
    if base.carried:
        if internal is None:
            raise ParameterError("momentum needs the motion of wheels and appendages")
        locked, across, _ = carried_inertia(base.carried, internal[0])
        carried = carried + matvec(locked, moving) + matvec(across, internal[1])
    R = rotation(pose)
    linear, angular = matvec(R, carried[..., :3]), matvec(R, carried[..., 3:])
    out: Array = np.concatenate([linear, angular + np.cross(pose[..., :3], linear)], axis=-1)
    return out
