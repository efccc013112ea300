"""Bodies in free space: Jacobi's closed form, and an arm that weighs nothing."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipkinc

from ves_gym.mechanics.arm import Arm
from ves_gym.mechanics.carried import carried_inertia
from ves_gym.mechanics.dynamics import inertia
from ves_gym.mechanics.link import Inertial, Link, Mount, diagonal
from ves_gym.mechanics.payload import Payload
from ves_gym.mechanics.spatial import matvec, rotation, twist

_NOTHING = Inertial(mass=1e-12, com=(0.0, 0.0, 0.0), inertia=diagonal(1e-12, 1e-12, 1e-12))

# a joint that turns a rotor and carries nothing: the satellite under it is all there is
NO_ARM = Arm(
    name="no arm",
    base=_NOTHING,
    links=(
        Link(
            d=0.0,
            a=0.1,
            alpha=0.0,
            inertial=_NOTHING,
            rotor_inertia=1.0,
            q_min=-3.0,
            q_max=3.0,
            v_max=1.0,
            a_max=1.0,
            tau_max=1.0,
        ),
    ),
    source="test: nothing on the satellite",
)

# a body to be caught, wherever the tool happens to be
TARGET = Payload(
    inertial=Inertial(
        mass=40.0,
        com=(0.02, -0.03, 0.05),
        inertia=((2.0, 0.1, 0.05), (0.1, 2.6, -0.04), (0.05, -0.04, 1.7)),
    ),
    grip=Mount(position=(0.2, 0.1, 0.0)),
    position=(0.3, -0.2, 0.4),
    angles=(0.4, -0.2, 1.1),
    velocity=(0.05, 0.02, -0.1),
    spin=(0.3, -0.5, 0.4),
    latch_distance=5.0,
)


def free_body(inertia, w, time):
    """Angular velocity of a free body with principal moments A > B > C (Landau-Lifshitz 37).

    Args:
        inertia: (3,) A > B > C, with L^2 > 2 E B: it circles about the axis of A.
        w: (3,) at time 0, w_A > 0.
        time: (k,) [s].
    """
    A, B, C = inertia
    energy, momentum = np.sum(inertia * w**2), np.sum((inertia * w) ** 2)  # 2 E, L^2
    top = [
        np.sqrt((momentum - energy * C) / (A * (A - C))),
        np.sqrt((energy * A - momentum) / (B * (A - B))),
        np.sqrt((energy * A - momentum) / (C * (A - C))),
    ]
    speed = np.sqrt((A - B) * (momentum - energy * C) / (A * B * C))
    m = (B - C) * (energy * A - momentum) / ((A - B) * (momentum - energy * C))
    # moments fall from the first axis to the third: w_C is minus cn where theirs rise
    phase = ellipkinc(np.arctan2(w[1] / top[1], -w[2] / top[2]), m)
    sn, cn, dn, _ = ellipj(phase + speed * time, m)
    return np.stack([top[0] * dn, top[1] * sn, -top[2] * cn], axis=-1)


def free_attitude(inertia, w, q, time):
    """Attitude of a free body: q' = 1/2 q (0, w(t)) with w in closed form, by SciPy's DOP853.

    Args:
        inertia, w: as in `free_body`.
        q: (4,) at time 0, scalar first.
        time: (k,) rising [s].
    """

    def slope(t, q):
        a, b, c = free_body(inertia, w, np.array([t]))[0]
        turn = np.array([[0, -a, -b, -c], [a, 0, c, -b], [b, -c, 0, a], [c, b, -a, 0]])
        return 0.5 * turn @ q

    run = solve_ivp(slope, (0, time[-1]), q, "DOP853", t_eval=time, rtol=1e-13, atol=1e-13)
    return run.y.T


def rebound(mass: float, stiffness: float, damping: float) -> tuple[float, float]:
    """Return duration [s] and coefficient of restitution of a central impact.

    The force max(0, k d + c d') ends before the overlap does, where the acceleration is zero
    (Schwager and Poeschel, Granular Matter 9, 2007, 465-469).

    Args:
        mass: reduced mass of the two bodies along the normal [kg].
        stiffness: k [N/m].
        damping: c [N s/m].
    """
    natural, decay = math.sqrt(stiffness / mass), damping / (2 * mass)
    if decay < natural:
        omega = math.sqrt(natural**2 - decay**2)
        time = math.atan2(2 * decay * omega, decay**2 - omega**2) / omega
    elif decay == natural:
        time = 2 / decay
    else:
        omega = math.sqrt(decay**2 - natural**2)
        time = math.log((decay + omega) / (decay - omega)) / omega
    return time, math.exp(-decay * time)


def momentum(system, q, v, y, yd, internal=None):
    """Linear and angular momentum (..., 6) in inertial axes, the latter about their origin.

    Of arm, satellite and what it carries; rotors of the arm's joints turn with their joints
    only and carry none (docs/physics.md).
    """
    base = system.base
    moving, H = twist(y, yd), inertia(system.arm, q)
    carried = matvec(H[..., :6, :6] + base.body.spatial(), moving)
    carried = carried + matvec(H[..., :6, 6:], v)
    if base.carried:
        locked, across, _ = carried_inertia(base.carried, internal[0])
        carried = carried + matvec(locked, moving) + matvec(across, internal[1])
    R = rotation(y)
    linear, angular = matvec(R, carried[..., :3]), matvec(R, carried[..., 3:])
    return np.concatenate([linear, angular + np.cross(y[..., :3], linear)], axis=-1)


def momentum_of(mass: np.ndarray, rates: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return linear and angular momentum of an arm with its base about the inertial origin.

    Conjugate to the base's twist, so with a vehicle of constant M that too counts; of a
    satellite it is the momentum of all bodies, rotors' own turning excepted.

    Args:
        mass: (..., N, N) of `tool_motion`.
        rates: (..., N) base twist in its own axes, joints and gears.
        y: (..., 6) base pose [m, rad].

    Returns:
        (..., 6) [kg m/s, kg m^2/s], inertial axes.
    """
    at_base, R = matvec(mass[..., :6, :], rates), rotation(y)
    linear, angular = matvec(R, at_base[..., :3]), matvec(R, at_base[..., 3:])
    return np.concatenate([linear, angular + np.cross(y[..., :3], linear)], axis=-1)
