"""Physics steps that an integrator can take: decided by the fastest rate of the closed loop.

Base, joints with their servos, gears, flexures, internal modes and what the base carries, all
free to move. A load in the hand makes everything slower, so the arm without it decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.contact import Contact
from ves_gym.mechanics.dynamics import drawn_configurations
from ves_gym.mechanics.latch import response, tool_motion
from ves_gym.mechanics.linear_motion import LinearMotion
from ves_gym.mechanics.servo import OWN_GAINS, JointServo
from ves_gym.system.system import System

_MOST = 10_000  # steps of a control period that are chosen: a thousandth of the usual speed
_SURE = 2.0  # |pole| times step: RK4 is stable in the left half of a disc of 2.6 around 0


def require_stable_step(system: System, servo: JointServo | None) -> None:
    """Refuse a physics step that the integrator cannot take at some configuration.

    Args:
        system: as it really is.
        servo: gains for every joint; None: motors without a servo.

    Raises:
        ParameterError: it names the step that is needed and what needs it.
    """
    loop = _Loop.of(system, servo)
    if loop.M.size:  # something is free to move
        sure = system.integrator == "rk4" and loop.bound().max() * system.physics_dt <= _SURE
        if not sure:
            _require_stable_loop(system, loop)
    if system.contact is not None and _contact_rate(system)[0] * system.physics_dt > 1.0:
        _refuse_contact(system, system.contact)


def with_stable_step(system: System, servo: JointServo = OWN_GAINS) -> System:
    """Return a system with a physics step for its arm, under its servos, on its vehicle.

    Its own step, or the longest part of the control period that is no longer than the time
    constant of the fastest motion and will do for its contact.

    Args:
        system: with the longest step that will do.
        servo: of motors.

    Raises:
        ParameterError: it would be so short that nobody could wait for the run.
    """
    motors = system.drive == "motor"
    gains = servo.for_arm(system.arm, system.vehicle) if motors else None
    loop = _Loop.of(system.actual, gains)
    rate = float(loop.bound().max()) if loop.M.size else 0.0
    touching = 0.0 if system.contact is None else _contact_rate(system.actual)[0]
    if max(rate, touching) * system.physics_dt <= 1.0:
        return system
    if rate * system.physics_dt > 1.0:
        rate = float(np.abs(loop.poles()).max())
    steps = math.ceil(system.control_dt * max(rate, touching))
    if steps <= system.substeps:
        return system
    if steps > _MOST:
        what = "contact" if touching > rate else "servos"
        raise ParameterError(
            f"the fastest motion of {system.arm.name} with its {what} on"
            f" {system.vehicle.kind}, {max(rate, touching):.4g}/s, needs physics steps of"
            f" {system.control_dt / steps:.3g} s, at least {system.control_dt / _MOST:.3g} s"
            " are taken: give softer ones, or the rotors' inertia"
        )
    return system.replace(physics_dt=system.control_dt / steps)


def _contact_rate(system: System) -> tuple[float, float]:
    """Least steps a second that the contact's springs need, and 1 / mass that they push.

    Between the lightest masses that tool and payload can show, all points at once. The inverse
    mass at a point of a body grows with its distance r from where the body's inverse inertia
    is taken: at most (sqrt(linear) + r sqrt(angular))^2.
    """
    arm, base, contact = system.arm, system.base, system.contact
    assert contact is not None
    q = drawn_configurations(arm)
    hidden = np.zeros((len(q), len(arm.geared) + len(base.carried)))
    tool = tool_motion(arm, base, np.zeros((len(q), 6)), q, hidden)
    inverse = tool.J @ response(
        tool.mass, np.swapaxes(tool.J, -1, -2), system.prescribed_coordinates
    )
    linear, angular = (
        np.linalg.eigvalsh(inverse[:, k : k + 3, k : k + 3])[:, -1] for k in (0, 3)
    )
    lever = max(shape.lever for shape in contact.tool)
    lightness = float((np.sqrt(linear) + lever * np.sqrt(np.maximum(angular, 0))).max() ** 2)
    if contact.on == "payload" and system.payload is not None:
        body = system.payload.inertial
        lever = max(shape.lever for shape in contact.target) + float(np.linalg.norm(body.com))
        turning = 1 / float(np.linalg.eigvalsh(np.array(body.inertia))[0])
        lightness += (math.sqrt(1 / body.mass) + lever * math.sqrt(turning)) ** 2
    damping = max(contact.damping, contact.tangential_damping)
    share = contact.points * lightness
    fastest = float(np.abs(np.roots([1.0, damping * share, contact.stiffness * share])).max())
    return fastest / _SURE, lightness


def _refuse_contact(system: System, contact: Contact) -> None:
    rate, lightness = _contact_rate(system)
    damping = max(contact.damping, contact.tangential_damping)
    raise ParameterError(
        f"physics_dt must be <= {1 / rate:.3g} s for a contact of {contact.stiffness:g} N/m"
        f" and {damping:g} N s/m (up to {contact.points} points on {1 / lightness:.3g} kg), got"
        f" {system.physics_dt:g} s"
    )


@dataclass
class _Loop:
    """M x'' + D x' + K x = 0 at several configurations, (c, s, s) each.

    x as `LinearMotion` has it, without joints that follow exactly.
    """

    M: Array
    D: Array
    K: Array

    @classmethod
    def of(cls, system: System, servo: JointServo | None) -> _Loop:
        free_motion = LinearMotion(system.arm, system.base)
        M = free_motion.mass(free_motion.inertia(drawn_configurations(system.arm)))
        D, K, motors = free_motion.D, free_motion.K, free_motion.motors
        moves = np.ones(free_motion.size, bool)
        moves[:6] = system.mode == "ideal"  # a platform goes where it is told
        moves[motors] = system.drive == "motor"
        if servo is not None:
            D[motors, motors], K[motors, motors] = servo.kd, servo.kp
        D, K = (np.broadcast_to(part, M.shape) for part in (D, K))
        free = np.flatnonzero(moves)
        picked = slice(None), free[:, None], free
        return cls(M[picked], D[picked], K[picked])

    def bound(self) -> Array:
        """Return what no rate exceeds, (c,) [1/s].

        |s|^2 <= |s| |D| + |K| for every pole s, by the norms of L^-1 D L^-T and L^-1 K L^-T
        with M = L L^T.
        """
        inverse = np.linalg.inv(np.linalg.cholesky(self.M))
        damping, stiffness = (
            np.linalg.eigvalsh(inverse @ part @ np.swapaxes(inverse, -1, -2))[..., -1]
            for part in (self.D, self.K)
        )
        return np.asarray((damping + np.sqrt(damping**2 + 4 * stiffness)) / 2)

    def poles(self) -> npt.NDArray[np.complex128]:
        """Return the eigenvalues, (c, 2 s) [1/s]."""
        size = self.M.shape[-1]
        A = np.zeros((len(self.M), 2 * size, 2 * size))
        A[:, :size, size:] = np.eye(size)
        A[:, size:, :size] = -np.linalg.solve(self.M, self.K)
        A[:, size:, size:] = -np.linalg.solve(self.M, self.D)
        return np.linalg.eigvals(A).astype(complex)

    def growth(self, integrator: str, dt: float) -> float:
        """Return by how much a step multiplies what grows most, at worst."""
        if integrator == "rk4":
            z = self.poles() * dt
            return float(np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))).max())
        # rates first, coordinates with the new rates
        eye, implicit = np.eye(self.M.shape[-1]), integrator == "implicitfast"
        K, D = np.linalg.solve(self.M, self.K), np.linalg.solve(self.M, self.D)
        inverse = np.linalg.inv(eye + dt * D) if implicit else np.broadcast_to(eye, D.shape)
        carry = inverse if implicit else eye - dt * D
        rates = np.concatenate([-dt * inverse @ K, carry], axis=-1)
        locked = np.broadcast_to(np.hstack([eye, 0 * eye]), rates.shape)
        step = np.concatenate([locked + dt * rates, rates], axis=-2)
        return float(np.abs(np.linalg.eigvals(step)).max())


def _require_stable_loop(system: System, loop: _Loop) -> None:
    def stable(dt: float) -> bool:
        return loop.growth(system.integrator, dt) <= 1 + 1e-7  # a double eigenvalue 1, rounded

    if stable(system.physics_dt):
        return
    fastest = float(np.abs(loop.poles()).max())
    low, high = min(0.5 / fastest, system.physics_dt), system.physics_dt
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if stable(middle) else (low, middle)
    raise ParameterError(
        f"physics_dt must be <= {low:.3g} s for the fastest motion of {system.arm.name} with"
        f" its servos on {system.vehicle.kind}, {fastest:.4g}/s, got {system.physics_dt:g} s"
    )
