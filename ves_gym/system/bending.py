"""Links that bend, in accounts of energy: their share of the base and of its motion.

The motion beside (Y, q) that simulations and logs hold, (u, u'), begins with the p deflections
of the arm's flexures [rad]; what the vehicle carries and its internal modes follow.
"""

from __future__ import annotations

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.spatial import quadratic
from ves_gym.system.system import System

Internal = tuple[Array, Array]  # u and u' (..., p + m)


def own_modes(system: System, internal: Internal | None) -> Internal | None:
    """Return u and u' of what the vehicle has beside its pose, None where it has nothing.

    Args:
        system: arm and vehicle.
        internal: u and u' (..., p + m) of flexures and modes; None: not known.

    Raises:
        ParameterError: the arm bends, and its deflections are not given.
    """
    p = system.arm.bends
    if p and (internal is None or internal[0].shape[-1] < p):
        raise ParameterError(
            f"the energy of an arm that bends at {p} flexures needs their motion (columns u and"
            " ud of a simulation's log)"
        )
    if internal is None or not system.base.hidden:
        return None
    return internal[0][..., p:], internal[1][..., p:]


def moving_inertia(system: System, q: Array, internal: Internal | None) -> Array:
    """Inertia over base twist, deflections and joint rates (..., 6 + p + n, 6 + p + n).

    Args:
        system: arm and vehicle; a satellite is not in it.
        q: (..., n) joint angles [rad].
        internal: begins with the deflections where the arm bends.
    """
    p = system.arm.bends
    if not p or internal is None:
        return inertia(system.arm, q)
    return expand(system.arm).inertia(q, internal[0][..., :p])


def moving_rates(system: System, twist: Array, internal: Internal | None) -> Array:
    """(..., 6 + p) base twist, and the rates of the deflections where the arm bends.

    Args:
        system: arm and vehicle.
        twist: (..., 6) of the base.
        internal: u and u'.
    """
    p = system.arm.bends
    if not p or internal is None:
        return twist
    return np.concatenate([twist, internal[1][..., :p]], axis=-1)


def in_flexures(
    system: System, internal: Internal | None
) -> tuple[Array | float, Array | float]:
    """Strain energy of the flexures and the power that they lose (...) [J], [W].

    Args:
        system: arm and vehicle.
        internal: u and u'.
    """
    p = system.arm.bends
    if not p or internal is None:
        return 0.0, 0.0
    chain = expand(system.arm)
    d, rate = internal[0][..., :p], internal[1][..., :p]
    return quadratic(np.diag(chain.stiffness), d), 2 * quadratic(np.diag(chain.damping), rate)
