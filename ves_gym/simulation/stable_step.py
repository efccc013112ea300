"""Physics steps that an integrator can take, judged at q = 0 by what swings by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array, Mask, ParameterError
from ves_gym.mechanics.base_model import BaseModel
from ves_gym.mechanics.carried import Appendage, carried_inertia
from ves_gym.mechanics.dynamics import drawn_configurations, inertia
from ves_gym.mechanics.flexure import expand
from ves_gym.mechanics.latch import tool_motion
from ves_gym.mechanics.payload import Contact
from ves_gym.system.system import PRESCRIBED_INERTIA, System

_JUDGED = 8  # further configurations of an arm that bends
_SURE = 2.0  # |pole| times step: RK4 is stable in the left half of a disc of 2.6 around 0


def require_stable_step(system: System) -> None:
    """Refuse a physics step the integrator cannot take, judged at q = 0.

    Joints locked, or free where gears give way or links bend. An arm that bends is judged at
    other angles within its limits as well: what swings with a long link depends on them.
    """
    _require_stable_step(system, np.zeros(system.arm.n))
    if system.arm.bends:
        for q in drawn_configurations(system.arm)[1 : 1 + _JUDGED]:
            _require_stable_step(system, q)
    if system.contact is not None:
        _require_stable_contact(system, system.contact)


def _require_stable_contact(system: System, contact: Contact) -> None:
    """Refuse a step too long for the contact's spring between the lightest it can push, q = 0.

    The inverse mass at a point of a body grows with its distance r from where the body's
    inverse inertia is taken: at most (sqrt(linear) + r sqrt(angular))^2.
    """
    arm, base = system.arm, system.base
    hidden = np.zeros(len(arm.geared) + len(base.carried))
    inertia = PRESCRIBED_INERTIA if system.drive == "prescribed" else 0.0
    tool = tool_motion(arm, base, np.zeros(6), np.zeros(arm.n), hidden, inertia)
    inverse = tool.J @ np.linalg.solve(tool.mass, tool.J.T)
    linear, angular = (np.linalg.eigvalsh(inverse[k : k + 3, k : k + 3])[-1] for k in (0, 3))
    lever = max(shape.lever for shape in contact.tool)
    lightness = (math.sqrt(linear) + lever * math.sqrt(angular)) ** 2
    if contact.on == "payload" and system.payload is not None:
        body = system.payload.inertial
        lever = max(shape.lever for shape in contact.target) + float(np.linalg.norm(body.com))
        turning = 1 / float(np.linalg.eigvalsh(np.array(body.inertia))[0])
        lightness += (math.sqrt(1 / body.mass) + lever * math.sqrt(turning)) ** 2
    stiffness, damping = (contact.points * k for k in (contact.stiffness, contact.damping))
    poles = np.roots([1.0, damping * lightness, stiffness * lightness])
    fastest = float(np.abs(poles).max())
    if fastest * system.physics_dt > _SURE:
        raise ParameterError(
            f"physics_dt must be <= {_SURE / fastest:.3g} s for a contact of"
            f" {contact.stiffness:g} N/m and {contact.damping:g} N s/m (up to {contact.points}"
            f" points on {1 / lightness:.3g} kg), got {system.physics_dt:g} s"
        )


def _require_stable_step(system: System, q: Array) -> None:
    M, damping, stiffness = _passive(system, q)
    K, D = np.linalg.solve(M, stiffness), np.linalg.solve(M, damping)
    eye, none = np.eye(len(M)), np.zeros(M.shape)
    poles = np.linalg.eigvals(np.block([[none, eye], [-K, -D]]))

    def stable(dt: float) -> bool:
        """True if a step lets no mode grow."""
        if system.integrator == "rk4":
            z = poles * dt
            growth = np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))
        else:  # rates first, coordinates with the new rates
            implicit = system.integrator == "implicitfast"
            inverse = np.linalg.inv(eye + dt * D) if implicit else eye
            carry = inverse if implicit else eye - dt * D
            rates = np.hstack([-dt * inverse @ K, carry])
            step = np.vstack([np.hstack([eye, none]) + dt * rates, rates])
            growth = np.abs(np.linalg.eigvals(step))
        return bool(growth.max() <= 1 + 1e-7)  # rounding of a double eigenvalue 1

    if stable(system.physics_dt):
        return
    low, high = 0.0, system.physics_dt
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    passive = system.arm.geared or system.arm.bends
    what = "arm's or vehicle's" if passive else "vehicle's"
    raise ParameterError(
        f"physics_dt must be <= {low:.3g} s for the {what} fastest mode of"
        f" {np.abs(poles).max() / 2 / np.pi:.3g} Hz, got {system.physics_dt:g} s"
    )


def steps_are_small(system: System, bases: BaseModel) -> Mask:
    """(k,) vehicles whose poles, by a bound, are slow enough for the physics step.

    |s|^2 <= |s| |D| + |K| for every pole s, by the norms of L^-1 D L^-T and L^-1 K L^-T with
    M = L L^T. Where it is False, `require_stable_step` knows.

    Args:
        system: arm and steps.
        bases: M, D, K (k, 6, 6), positive semidefinite.
    """
    unsure = np.zeros(len(bases.M), bool)
    if system.integrator != "rk4" or system.arm.geared or system.arm.bends:
        return unsure
    alone = replace(system, vehicle=system.vehicle, effects=())
    locked, _, _ = _passive(alone, np.zeros(system.arm.n))
    try:
        root = np.linalg.cholesky(locked - system.base.M + bases.M)
    except np.linalg.LinAlgError:
        return unsure
    inverse = np.linalg.inv(root)
    damping, stiffness = (
        np.linalg.norm(inverse @ part @ np.swapaxes(inverse, -1, -2), axis=(-2, -1))
        for part in (bases.D, bases.K)
    )
    fastest = (damping + np.sqrt(damping**2 + 4 * stiffness)) / 2
    return np.asarray(fastest * system.physics_dt <= _SURE)


def _passive(system: System, q: Array) -> tuple[Array, Array, Array]:
    """M, D, K of what swings by itself, with the joints at q (n,)."""
    base, chain = system.base, expand(system.arm)
    arm = chain.arm  # every joint, driven or passive
    H = inertia(arm, chain.angles(q))
    if base.carried and not (arm.geared or base.m or chain.passive):
        return _with_carried(base, H[:6, :6])
    if not (arm.geared or base.m or chain.passive):
        return base.mass_matrix + H[:6, :6], base.D, base.K
    n, g, m = arm.n, len(arm.geared), base.m
    # coordinates: Y, rotors and flexures, deflections of the gears, internal modes
    link = np.zeros((6 + n, 6 + n + g))  # velocities of base and links from theirs
    link[:, : 6 + n] = np.eye(6 + n)
    link[[6 + i for i in arm.geared], 6 + n + np.arange(g)] = 1.0
    rotors = np.diag(np.r_[np.zeros(6), arm.column("rotor_inertia")])
    M, D, K = np.zeros((3, 6 + n + g + m, 6 + n + g + m))
    M[: 6 + n + g, : 6 + n + g] = link.T @ (H - rotors) @ link
    M[: 6 + n, : 6 + n] += rotors
    for k, i in enumerate(arm.geared, start=6 + n):
        gear = arm.links[i].gear
        assert gear is not None
        D[k, k], K[k, k] = gear.damping, gear.stiffness
    bends = 6 + np.array(chain.passive, int)
    D[bends, bends], K[bends, bends] = chain.damping, chain.stiffness
    free = np.arange(6, 6 + n + g)  # a platform goes where it is told
    if system.mode == "ideal":
        free = np.arange(len(M))
        at = np.r_[:6, 6 + n + g : len(M)]
        for part, block in zip((M, D, K), base.full(), strict=True):
            part[at[:, None], at] += block
    picked = free[:, None], free
    return M[picked], D[picked], K[picked]


def _with_carried(base: BaseModel, arm: Array) -> tuple[Array, Array, Array]:
    """M, D, K over the base and the joints of what it carries, arm (6, 6) locked."""
    k = len(base.carried)
    _, across, joints = carried_inertia(base.carried, np.zeros(k))
    M, D, K = np.zeros((3, 6 + k, 6 + k))
    M[:6, :6] = base.mass_matrix + arm
    M[:6, 6:], M[6:, :6], M[6:, 6:] = across, across.T, np.diag(joints)
    D[:6, :6], K[:6, :6] = base.D, base.K
    for i, part in enumerate(base.carried, start=6):
        if isinstance(part, Appendage):
            D[i, i], K[i, i] = part.damping, part.stiffness
        else:
            D[i, i] = part.viscous
    return M, D, K
