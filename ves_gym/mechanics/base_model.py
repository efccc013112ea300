"""The linear model of what carries the arm: M, D, K at its flange, and internal modes.

The admittance M Y'' + D Y' + K Y = W of thesis eq. 2.3 in Y = (x, y, z, phi_x, phi_y,
phi_z); beside it a rigid body that turns with the base (satellites) and internal modes
(structures whose own vibration the flange does not show).
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    freeze_arrays,
    require_positive,
    unit,
    write_table,
)
from ves_gym.mechanics.carried import (
    Carried,
    ReactionWheel,
    carried_inertia,
    linear_joints,
)
from ves_gym.mechanics.link import Inertial, matrix, require_length_1


class Saved:
    """A vehicle that can be written into a file."""

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write as .toml or .json, completely or not at all; `get_vehicle` reads it."""
        write_table(path, self)


@dataclass(frozen=True, kw_only=True)
class Oscillator:
    """A mass on a spring that the vehicle carries, free along one fixed direction.

    In its own coordinate u, its way along `direction`: mass u'' = -f, and f along the
    direction on the vehicle, f = stiffness (u - direction . Y) + damping (u - direction . Y)'.
    """

    mass: float = unit("kg")
    stiffness: float = unit("N/m")
    damping: float = unit("N s/m", default=0.0)
    direction: Vector = unit("1")  # (3,) unit vector

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "mass", "stiffness")
        require_positive(self, "damping", zero=True)
        require_length_1(self.direction, "Oscillator.direction")


@dataclass(frozen=True)
class InternalModes:
    """Motion of a base beside that of its interface: m oscillators of unit mass.

    Oscillator k has its own coordinate u_k and is carried along u_k = P_k . Y. Beside M, D, K
    of `BaseModel` they add (derived in docs/physics.md from Craig and Bampton's reduction)

        kinetic energy   1/2 |u'|^2
        strain energy    1/2 sum_k omega_k^2 (u_k - P_k . Y)^2
        power lost       (Y', u')^T damping (Y', u').
    """

    coupling: Array  # (6, m) P, a column per mode [kg^(1/2), kg^(1/2) m]
    omega: Array  # (m,) with the interface at rest [rad/s]
    damping: Array  # (6 + m, 6 + m) over (Y', u'), symmetric positive semidefinite

    def __post_init__(self) -> None:
        m = len(self.omega)
        for name, shape in (("coupling", (6, m)), ("damping", (6 + m, 6 + m))):
            if np.shape(getattr(self, name)) != shape:
                raise ParameterError(
                    f"InternalModes.{name} of {m} modes must have shape {shape}, got"
                    f" {np.shape(getattr(self, name))}"
                )

    @property
    def m(self) -> int:
        """Number of modes."""
        return len(self.omega)

    @staticmethod
    def of(oscillators: tuple[Oscillator, ...]) -> InternalModes | None:
        """Return masses on springs as modes, u = mass^(1/2) times the way; None for none."""
        m = len(oscillators)
        if not m:
            return None
        coupling, omega, damping = np.zeros((6, m)), np.zeros(m), np.zeros((6 + m, 6 + m))
        for i, oscillator in enumerate(oscillators):
            root = math.sqrt(oscillator.mass)
            coupling[:3, i] = root * np.array(oscillator.direction)
            omega[i] = math.sqrt(oscillator.stiffness / oscillator.mass)
            stretch = np.zeros(6 + m)  # of the spring per (Y, u)
            stretch[:3], stretch[6 + i] = oscillator.direction, -1 / root
            damping += oscillator.damping * np.outer(stretch, stretch)
        return InternalModes(coupling, omega, damping)

    def oscillators(self) -> tuple[Oscillator, ...]:
        """Return masses on springs of which these are the modes, see `of`."""
        out = []
        for i in range(self.m):
            way = self.coupling[:3, i]
            mass = float(way @ way)
            loss = float(self.damping[6 + i, 6 + i])
            out.append(
                Oscillator(
                    mass=mass,
                    stiffness=mass * float(self.omega[i]) ** 2,
                    damping=mass * loss,
                    direction=tuple((way / math.sqrt(mass)).tolist()),
                )
            )
        return tuple(out)

    def joined(self, other: InternalModes | None) -> InternalModes:
        """Return these modes and, after them, those of another set on the same base."""
        if other is None:
            return self
        m, k = self.m, other.m
        damping = np.zeros((6 + m + k, 6 + m + k))
        damping[: 6 + m, : 6 + m] = self.damping
        at = np.r_[:6, 6 + m : 6 + m + k]
        damping[np.ix_(at, at)] += other.damping
        coupling = np.hstack([self.coupling, other.coupling])
        return InternalModes(coupling, np.r_[self.omega, other.omega], damping)

    def matrices(self) -> tuple[Array, Array, Array]:
        """Return their part of M, D, K over (Y, u): three (6 + m, 6 + m)."""
        m = self.m
        stretch = np.vstack([-self.coupling, np.eye(m)])
        mass = np.diag(np.r_[np.zeros(6), np.ones(m)])
        return mass, self.damping, (stretch * self.omega**2) @ stretch.T


@dataclass(frozen=True)
class BaseModel:
    """Linear base dynamics in Y, SI units, plus an optional rigid body at the base.

    With internal modes M, D, K are what is left of the base beside them: M is its mass where
    all u stand still, K is its static stiffness.
    """

    M: Array  # (6, 6) constant mass matrix [kg, kg m, kg m^2]
    D: Array  # (6, 6) damping [N s/m, N s, N m s]
    K: Array  # (6, 6) stiffness [N/m, N, N m]
    body: Inertial | None = None
    drag: Array | None = None  # (6,) c of a damping force c |Y'| Y' [N s^2/m^2, N m s^2]
    internal: InternalModes | None = None
    carried: tuple[Carried, ...] = ()  # on the body, one joint each

    @property
    def mass_matrix(self) -> Array:
        """(6, 6) mass matrix at Y = 0: M plus the rigid body's inertia."""
        return self.M if self.body is None else self.M + self.rigid()

    def rigid(self) -> Array:
        """(6, 6) inertia of the body and of what it carries, their joints locked as relaxed."""
        if self.body is None:
            return np.zeros((6, 6))
        rigid = self.body.spatial()
        if not self.carried:
            return rigid
        return rigid + carried_inertia(self.carried, np.zeros(len(self.carried)))[0]

    @property
    def m(self) -> int:
        """Number of internal modes."""
        return 0 if self.internal is None else self.internal.m

    @property
    def hidden(self) -> int:
        """Number of coordinates beside Y: of wheels and appendages, then of internal modes."""
        return len(self.carried) + self.m

    def full(self) -> tuple[Array, Array, Array]:
        """Return M, D, K over (Y, u) at Y = 0, the body included: three (6 + h, 6 + h).

        u are the h hidden coordinates, joints of wheels and appendages before the modes.
        """
        k, size = len(self.carried), 6 + self.hidden
        out = np.zeros((3, size, size))
        out[:, :6, :6] = self.mass_matrix, self.D, self.K
        if self.internal is not None:
            at = np.r_[:6, 6 + k : size]
            out[:, at[:, None], at] += np.stack(self.internal.matrices())
        if k:
            joints = range(6, 6 + k)
            across, *diagonals = linear_joints(self.carried)
            out[0, :6, joints], out[0, joints, :6] = across.T, across.T
            out[:, joints, joints] = diagonals
        return out[0], out[1], out[2]

    def with_full(self, D: Array, K: Array) -> BaseModel:
        """Return the base whose damping and stiffness over (Y, u) are D, K (6 + m, 6 + m).

        Its modes are turned to those of the new stiffness (orthogonally: they have unit mass).
        Of the interface alone, (6, 6), they are its own, without the modes'.
        """
        if self.internal is None or len(K) == 6:
            return replace(self, D=D, K=K)
        squares, turn = np.linalg.eigh(K[6:, 6:])
        coupling = -K[:6, 6:] @ turn / squares
        every = np.eye(len(K))
        every[6:, 6:] = turn
        damping = every.T @ D @ every
        damping[:6, :6] -= self.D
        internal = InternalModes(coupling, np.sqrt(squares), damping)
        return replace(self, K=K[:6, :6] - (coupling * squares) @ coupling.T, internal=internal)

    def locked(self) -> BaseModel:
        """Return the base whose wheels and appendages do not move on it."""
        return replace(self, M=self.mass_matrix, body=None, carried=())

    @property
    def wheels(self) -> tuple[ReactionWheel, ...]:
        """The wheels among what is carried, the first of it."""
        return tuple(part for part in self.carried if isinstance(part, ReactionWheel))

    def condensed(self) -> tuple[Array, Array, Array]:
        """Return M, D, K of the interface with internal modes that follow it: three (6, 6).

        Guyan's static condensation: right for motions much slower than the slowest mode.
        """
        M, D, _ = self.full()
        follow = np.vstack([np.eye(6), self.at_rest(np.eye(6)).T])
        return follow.T @ M @ follow, follow.T @ D @ follow, self.K.copy()

    def attached(self, y: Array) -> Array:
        """(..., m) coordinates u of modes at rest on a base at (..., 6) Y; rates likewise."""
        return carried(self.coupling, y)

    def at_rest(self, y: Array) -> Array:
        """(..., h) hidden coordinates at rest on a base at (..., 6) Y; rates likewise."""
        still = np.zeros((*y.shape[:-1], len(self.carried)))
        return np.concatenate([still, self.attached(y)], axis=-1)

    @property
    def coupling(self) -> Array:
        """(6, m) of the internal modes, m = 0 without any."""
        return np.zeros((6, 0)) if self.internal is None else self.internal.coupling

    def scaled(
        self, mass: float = 1.0, damping: float = 1.0, stiffness: float = 1.0
    ) -> BaseModel:
        """Return the base with all its mass (its body's too), damping or stiffness over (Y, u)
        multiplied [1]."""
        body, internal = self.body, self.internal
        if body is not None and mass != 1:
            moments = matrix(np.array(body.inertia) * mass)
            body = replace(body, mass=body.mass * mass, inertia=moments)
            if self.carried:
                raise ParameterError("a base that carries wheels or appendages has no scaling")
        if internal is not None:
            rate = np.r_[
                np.ones(6), np.full(internal.m, 1 / math.sqrt(mass))
            ]  # of u by the old
            internal = InternalModes(
                coupling=internal.coupling * math.sqrt(mass),
                omega=internal.omega * math.sqrt(stiffness / mass),
                damping=damping * internal.damping * np.outer(rate, rate),
            )
        return replace(
            self,
            M=self.M * mass,
            D=self.D * damping,
            K=self.K * stiffness,
            body=body,
            internal=internal,
        )


def carried(coupling: Array, y: Array) -> Array:
    """Return coordinates u (..., m) of modes at rest on bases at Y (..., 6), or rates; coupling
    is (6, m), or (..., 6, m) of each."""
    out = np.zeros((*y.shape[:-1], coupling.shape[-1]))
    for k in range(6):  # sum by sum: every simulation of a batch rounds alike
        out += coupling[..., k, :] * y[..., k, None]
    return out


def elementwise_damping(M: Array, K: Array, ratio: float) -> Array:
    """Return the thesis's B = 2 zeta sqrt(K M), read by elements on the diagonal (App. A.2)."""
    return np.diag(2 * ratio * np.sqrt(np.diag(K) * np.diag(M)))
