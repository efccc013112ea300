"""Rigid-body equations of an arm on a moving base, as CasADi expressions.

Everything is in platform axes about the platform's origin, where spatial inertias of links
simply add. CasADi is the interpreter only: the equations are those of a textbook (Featherstone,
Rigid Body Dynamics Algorithms, 2008, ch. 5 and 6; Craig, Introduction to Robotics, ch. 6).
Twists and wrenches are (6,), linear part first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

SX = Any  # CasADi's scalars and matrices
GRAVITY = 9.81  # m/s^2


@dataclass
class Body:
    """A rigid body: mass [kg], centre [m] and inertia about it [kg m^2], in its frame."""

    mass: float
    com: np.ndarray
    inertia: np.ndarray

    @staticmethod
    def read(table: dict[str, Any]) -> Body:
        return Body(table["mass"], np.array(table["com"]), np.array(table["inertia"]))


@dataclass
class Arm:
    """Bodies (base link first) and Denavit-Hartenberg rows (d, a, alpha, offset)."""

    bodies: list[Body]
    dh: np.ndarray  # (n, 4)
    rotor: np.ndarray  # (n,) kg m^2, on the joint's own axis only
    limits: dict[str, np.ndarray]  # q_min, q_max, v_max, a_max, tau_max

    @property
    def n(self) -> int:
        return len(self.dh)

    @staticmethod
    def read(table: dict[str, Any]) -> Arm:
        links = table["links"]
        column = lambda key: np.array([link[key] for link in links])  # noqa: E731
        return Arm(
            bodies=[Body.read(table["base"]), *(Body.read(k["inertial"]) for k in links)],
            dh=np.stack([column(k) for k in ("d", "a", "alpha", "offset")], axis=1),
            rotor=column("rotor_inertia"),
            limits={k: column(k) for k in ("q_min", "q_max", "v_max", "a_max", "tau_max")},
        )


def cross(a: SX, b: SX) -> SX:
    return ca.vertcat(
        a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    )


def rotation(phi: SX) -> SX:
    """R = Rz(phi_z) Ry(phi_y) Rx(phi_x): platform axes to inertial axes."""
    (cx, cy, cz), (sx, sy, sz) = ([f(phi[i]) for i in range(3)] for f in (ca.cos, ca.sin))
    rz = ca.blockcat([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    ry = ca.blockcat([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rx = ca.blockcat([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    return rz @ ry @ rx


def turn_rates(phi: SX) -> SX:
    """E: angular velocity in platform axes = E(phi) phi'."""
    cx, sx, cy, sy = ca.cos(phi[0]), ca.sin(phi[0]), ca.cos(phi[1]), ca.sin(phi[1])
    return ca.blockcat([[1, 0, -sy], [0, cx, sx * cy], [0, -sx, cx * cy]])


def twist_map(y: SX) -> SX:
    """T(Y), (6, 6): twist in platform axes = T Y'."""
    return ca.diagcat(rotation(y[3:6]).T, turn_rates(y[3:6]))


@dataclass
class Pose:
    """Joint axes, frame origins, centres and inertias in platform axes, for one q."""

    axes: list[SX]  # n
    origins: list[SX]  # n + 1; joint i turns about axes[i] through origins[i]
    masses: list[float]  # n + 1, the base link first
    centres: list[SX]
    inertias: list[SX]


def pose(arm: Arm, q: SX) -> Pose:
    turn, at = ca.SX.eye(3), ca.SX.zeros(3)
    base = arm.bodies[0]
    p = Pose([], [at], [base.mass], [ca.SX(base.com)], [ca.SX(base.inertia)])
    for i, (d, a, alpha, offset) in enumerate(arm.dh):
        c, s = ca.cos(q[i] + offset), ca.sin(q[i] + offset)
        # cos(pi/2) is 6e-17: a sparse zero there keeps the graph small
        ca_, sa = (0.0 if abs(x) < 1e-12 else x for x in (np.cos(alpha), np.sin(alpha)))
        p.axes.append(turn[:, 2])
        at = at + turn @ ca.vertcat(a * c, a * s, d)
        turn = turn @ ca.blockcat([[c, -s * ca_, s * sa], [s, c * ca_, -c * sa], [0, sa, ca_]])
        body = arm.bodies[i + 1]
        p.origins.append(at)
        p.masses.append(body.mass)
        p.centres.append(at + turn @ ca.SX(body.com))
        p.inertias.append(turn @ ca.SX(body.inertia) @ turn.T)
    return p


def inertia(arm: Arm, p: Pose) -> SX:
    """H, (6+n, 6+n), for (platform twist, q'), by summing composite bodies inwards."""
    n = arm.n
    H = ca.SX.zeros(6 + n, 6 + n)
    mass, first, second = 0, ca.SX.zeros(3), ca.SX.zeros(3, 3)
    screws = [ca.vertcat(cross(p.origins[i], p.axes[i]), p.axes[i]) for i in range(n)]
    for i in range(n, -1, -1):
        m, c = p.masses[i], p.centres[i]
        mass, first = mass + m, first + m * c
        second = second + p.inertias[i] + m * (ca.dot(c, c) * ca.SX.eye(3) - c @ c.T)
        if i == 0:
            break
        s = screws[i - 1]
        momentum = ca.vertcat(
            mass * s[:3] + cross(s[3:], first), cross(first, s[:3]) + second @ s[3:]
        )
        column = ca.vertcat(momentum, *(ca.dot(screws[j], momentum) for j in range(i)))
        H[: 6 + i, 5 + i] = column
        H[5 + i, : 6 + i] = column.T
        H[5 + i, 5 + i] += arm.rotor[i - 1]
    S = ca.skew(first)
    H[:6, :6] = ca.blockcat([[mass * ca.SX.eye(3), -S], [S, second]])
    return H


def newton_euler(
    arm: Arm, p: Pose, twist: SX, point: SX, turn: SX, v: SX, a: SX
) -> tuple[SX, SX]:
    """Wrench (6,) that moves the arm as told, and torques (n,), rotors included.

    Args:
        twist: (6,) of the platform; only its angular part acts.
        point, turn: (3,) acceleration of the origin less gravity, and of the angle.
        v, a: (n,) joint rates and accelerations.
    """
    w, al, acc = twist[3:], turn, point
    forces, moments = [], []
    for i in range(arm.n + 1):
        if i > 0:
            s = p.axes[i - 1]
            al = al + s * a[i - 1] + cross(w, s) * v[i - 1]
            w = w + s * v[i - 1]
            r = p.origins[i] - p.origins[i - 1]
            acc = acc + cross(al, r) + cross(w, cross(w, r))
        c, I = p.centres[i] - p.origins[i], p.inertias[i]
        force = p.masses[i] * (acc + cross(al, c) + cross(w, cross(w, c)))
        forces.append(force)
        moments.append(cross(p.centres[i], force) + I @ al + cross(w, I @ w))
    torques, f, m = [], ca.SX.zeros(3), ca.SX.zeros(3)
    for i in range(arm.n, -1, -1):
        f, m = f + forces[i], m + moments[i]
        if i > 0:
            moment = m - cross(p.origins[i - 1], f)
            torques.append(ca.dot(p.axes[i - 1], moment) + arm.rotor[i - 1] * a[i - 1])
    return ca.vertcat(f, m), ca.vertcat(*torques[::-1])


def solve(A: SX, b: SX) -> SX:
    """A x = b by L D L^T, A (k, k) symmetric positive definite, b (k, m)."""
    k = A.shape[0]
    L, d = ca.SX.eye(k), []
    for j in range(k):
        d.append(A[j, j] - sum((L[j, i] ** 2 * d[i] for i in range(j)), ca.SX(0)))
        for r in range(j + 1, k):
            L[r, j] = (
                A[r, j] - sum((L[r, i] * L[j, i] * d[i] for i in range(j)), ca.SX(0))
            ) / d[j]
    x = ca.SX(b)
    for r in range(k):
        for i in range(r):
            x[r, :] = x[r, :] - L[r, i] * x[i, :]
    for r in range(k):
        x[r, :] = x[r, :] / d[r]
    for r in range(k - 1, -1, -1):
        for i in range(r + 1, k):
            x[r, :] = x[r, :] - L[i, r] * x[i, :]
    return x


def feedforward(arm: Arm) -> ca.Function:
    """Nominal torque (n,) of a commanded motion (q, v, a) on a base at rest, weightless."""
    q, v, a = (ca.SX.sym(k, arm.n) for k in "qva")
    zero = ca.SX.zeros(3)
    _, tau = newton_euler(arm, pose(arm, q), ca.SX.zeros(6), zero, zero, v, a)
    return ca.Function("feedforward", [q, v, a], [tau])
