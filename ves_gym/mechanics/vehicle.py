"""Vehicles: what carries the arm. A flexible beam, a satellite, or any M, D, K.

A vehicle answers with `BaseModel`: the linear admittance M Y'' + D Y' + K Y = W of
thesis eq. 2.3 in Y = (x, y, z, phi_x, phi_y, phi_z), and, for a satellite, a rigid body
that turns with the base instead of a constant M.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    from_plain,
    read_table,
    require_choice,
    require_positive,
    symmetric,
    unit,
    write_table,
)
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.arm import Inertial, diagonal, matrix, skew
from ves_gym.mechanics.modes import natural_modes
from ves_gym.mechanics.section import ALUMINIUM as ALUMINIUM
from ves_gym.mechanics.section import Material as Material

_GAUSS = np.polynomial.legendre.leggauss(4)  # exact to degree 7; the beam needs 6


class _Saved:
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
        require_positive(self, "mass", "stiffness")
        require_positive(self, "damping", zero=True)
        length = float(np.linalg.norm(finite(self.direction, (3,), "Oscillator.direction")))
        if abs(length - 1) > 1e-9:
            raise ParameterError(
                f"Oscillator.direction must have length 1, got {self.direction}"
            )


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

    @property
    def mass_matrix(self) -> Array:
        """(6, 6) mass matrix at Y = 0: M plus the rigid body's inertia."""
        return self.M if self.body is None else self.M + self.body.spatial()

    @property
    def m(self) -> int:
        """Number of internal modes."""
        return 0 if self.internal is None else self.internal.m

    def full(self) -> tuple[Array, Array, Array]:
        """Return M, D, K over (Y, u) at Y = 0, the body included: three (6 + m, 6 + m)."""
        out = tuple(np.array(k, dtype=np.float64) for k in (self.mass_matrix, self.D, self.K))
        if self.internal is not None:
            wide = tuple(part.copy() for part in self.internal.matrices())
            for matrix_, block in zip(wide, out, strict=True):
                matrix_[:6, :6] += block
            out = wide
        return out[0], out[1], out[2]

    def attached(self, y: Array) -> Array:
        """(..., m) coordinates u of modes at rest on a base at (..., 6) Y; rates likewise."""
        out = np.zeros((*y.shape[:-1], self.m))
        if self.internal is not None:  # sum by sum: every simulation of a batch rounds alike
            for k in range(6):
                out += self.internal.coupling[k] * y[..., k, None]
        return out

    def scaled(
        self, mass: float = 1.0, damping: float = 1.0, stiffness: float = 1.0
    ) -> BaseModel:
        """Return the base with all its mass, damping or stiffness multiplied.

        Args:
            mass, damping, stiffness: factors of M, D, K over (Y, u) and of the body [1].
        """
        body, internal = self.body, self.internal
        if body is not None and mass != 1:
            moments = matrix(np.array(body.inertia) * mass)
            body = replace(body, mass=body.mass * mass, inertia=moments)
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


def modal_damping(M: Array, K: Array, ratio: float) -> Array:
    """Return the D that gives every mode of (K, M) the same damping ratio.

    Args:
        M: (6, 6) mass, positive definite.
        K: (6, 6) stiffness.
        ratio: of every mode [1].
    """
    omega, modes = natural_modes(K, M)
    rates = np.diag(2 * ratio * omega)
    damping: Array = M @ modes @ rates @ modes.T @ M
    return (damping + damping.T) / 2


def elementwise_damping(M: Array, K: Array, ratio: float) -> Array:
    """Return the thesis's B = 2 zeta sqrt(K M), read by elements on the diagonal (App. A.2).

    Args:
        M, K: (6, 6) mass and stiffness.
        ratio: zeta [1].
    """
    return np.diag(2 * ratio * np.sqrt(np.diag(K) * np.diag(M)))


# ---------------------------------------------------------------------------- beams


@dataclass(frozen=True, kw_only=True)
class Beam(_Saved):
    """A clamped polyline of straight tubes; the arm rides on its free end.

    Compliance: exact Euler-Bernoulli statics of the polyline (derived in
    docs/physics.md; equal to the corrected thesis tables A.2 and A.4). Mass model
    `thesis`: half the beam's mass at the tip, m_eq L^2 about each axis (App. A), the
    vanishing entry floored at rho J L / 3. `consistent`: kinetic energy of the beam in
    its static deflection shapes (Guyan condensation of the consistent mass).
    """

    kind: ClassVar[str] = "beam"
    segments: Matrix = unit("m")  # vectors from clamp to tip, one per tube
    outer_diameter: float = unit("m")
    wall: float = unit("m")
    material: Material = ALUMINIUM
    mass_model: str = "thesis"
    damping_model: str = "modal"
    damping_ratio: float = unit("1", default=0.05)
    source: str = "user"

    def __post_init__(self) -> None:
        require_positive(self, "outer_diameter", "wall")
        require_positive(self, "damping_ratio", zero=True)
        require_choice(self, "mass_model", ("thesis", "consistent"))
        require_choice(self, "damping_model", ("modal", "elementwise"))
        if not self.segments:
            raise ParameterError("Beam.segments must hold at least one vector, got none")
        for i, segment in enumerate(self.segments):
            if np.linalg.norm(finite(segment, (3,), f"Beam.segments[{i}]")) == 0:
                raise ParameterError(f"Beam.segments[{i}] must not have zero length")
        if 2 * self.wall >= self.outer_diameter:
            raise ParameterError(
                f"Beam.wall must be < half the outer diameter {self.outer_diameter} m,"
                f" got {self.wall} m"
            )

    @property
    def section(self) -> tuple[float, float, float]:
        """Area [m^2], second moment I and polar moment J = 2 I [m^4] of the tube."""
        outer, inner = self.outer_diameter, self.outer_diameter - 2 * self.wall
        second = np.pi / 64 * (outer**4 - inner**4)
        return np.pi / 4 * (outer**2 - inner**2), second, 2 * second

    @property
    def mass(self) -> float:
        """Mass of the whole beam [kg]."""
        length = sum(float(np.linalg.norm(s)) for s in self.segments)
        return self.section[0] * length * self.material.density

    @property
    def nodes(self) -> Array:
        """(s + 1, 3) corner points from clamp to tip, tip at the origin [m]."""
        corners = np.vstack([np.zeros(3), np.cumsum(np.array(self.segments), axis=0)])
        relative: Array = corners - corners[-1]
        return relative

    def flexibility(self, segment: int, x: float) -> Array:
        """Return the displacement of a beam point per unit wrench at the tip.

        Args:
            segment: on which the point lies.
            x: distance along it [m].

        Returns:
            (6, 6): rows translation and rotation of the point, columns force and moment at the
            tip, in platform axes.
        """
        nodes = self.nodes
        out = np.zeros((6, 6))
        for k in range(segment + 1):
            length = float(np.linalg.norm(self.segments[k]))
            reach = x if k == segment else length
            along = np.array(self.segments[k]) / length
            end = nodes[k] + reach * along
            # what comes before moves this tube rigidly; its own bending adds to that
            bending = self._cantilever(along, reach) @ _carry(nodes[-1] - end)
            out = _move(end - nodes[k]) @ out + bending
        return out

    def _cantilever(self, along: Array, x: float) -> Array:
        """(6, 6) end displacement of a straight tube of length x per wrench at its end."""
        area, second, polar = self.section
        E, G = self.material.youngs_modulus, self.material.shear_modulus
        across = np.eye(3) - np.outer(along, along)
        bend, tilt = x**3 / (3 * E * second), x**2 / (2 * E * second)
        out = np.zeros((6, 6))
        out[:3, :3] = bend * across + x / (E * area) * np.outer(along, along)
        out[:3, 3:] = -tilt * skew(along)  # a moment m bends the end along m x axis
        out[3:, :3] = tilt * skew(along)
        out[3:, 3:] = x / (E * second) * across + x / (G * polar) * np.outer(along, along)
        return out

    def stiffness(self) -> Array:
        """(6, 6) K at the tip."""
        last = len(self.segments) - 1
        tip = self.flexibility(last, float(np.linalg.norm(self.segments[last])))
        K = np.linalg.inv((tip + tip.T) / 2)
        # a symmetric structure has exact zeros; the inverse leaves rounding there
        K[np.abs(K) < 1e-14 * np.abs(K).max()] = 0.0
        return (K + K.T) / 2

    def thesis_mass(self) -> Array:
        """(6, 6) M of App. A, from the vector clamp -> tip; zero entries floored."""
        reach = -self.nodes[0]
        half = self.mass / 2
        lever = reach @ reach - reach**2
        _, _, polar = self.section
        floor = np.zeros(3)
        for segment in self.segments:
            length = float(np.linalg.norm(segment))
            axial = (np.array(segment) / length) ** 2
            floor += self.material.density * polar * length / 3 * axial
        return np.diag([half] * 3 + np.where(lever > 0, half * lever, floor).tolist())

    def consistent_mass(self) -> Array:
        """(6, 6) M of the beam moving in its static shapes under tip wrenches."""
        area, _, polar = self.section
        K, out = self.stiffness(), np.zeros((6, 6))
        for k, segment in enumerate(self.segments):
            length = float(np.linalg.norm(segment))
            along = np.array(segment) / length
            for node, weight in zip(*_GAUSS, strict=True):
                shape = self.flexibility(k, length * (1 + node) / 2) @ K
                twist = along @ shape[3:]
                density = self.material.density * weight * length / 2
                out += density * (
                    area * shape[:3].T @ shape[:3] + polar * np.outer(twist, twist)
                )
        return (out + out.T) / 2

    def base_model(self) -> BaseModel:
        """M, D, K at the tip, where the arm stands."""
        K = self.stiffness()
        M = self.thesis_mass() if self.mass_model == "thesis" else self.consistent_mass()
        damping = modal_damping if self.damping_model == "modal" else elementwise_damping
        return BaseModel(M, damping(M, K, self.damping_ratio), K)


def _move(r: Array) -> Array:
    """Displacement of a point at offset r from that of a rigid body's origin: (6, 6)."""
    out = np.eye(6)
    out[:3, 3:] = -skew(r)
    return out


def _carry(r: Array) -> Array:
    """Wrench at a point from the wrench at offset r from it: (6, 6)."""
    out = np.eye(6)
    out[3:, :3] = skew(r)
    return out


# ------------------------------------------------------------- matrices and satellites


@dataclass(frozen=True, kw_only=True)
class MatrixVehicle(_Saved):
    """The user's own M, D, K in Y; each symmetric and positive semidefinite.

    `drag`: damping that grows with speed, a force c |Y'| Y' along each axis. `extra`:
    masses on springs that it carries. `coupling`, `omega`, `internal_damping`: its internal
    modes, see `InternalModes`; M is then the mass beside them.
    """

    kind: ClassVar[str] = "matrices"
    M: Matrix = unit("kg, kg m, kg m^2")
    D: Matrix = unit("N s/m, N s, N m s")
    K: Matrix = unit("N/m, N, N m")
    drag: Vector | None = unit("N s^2/m^2, N m s^2", default=None)
    extra: tuple[Oscillator, ...] | None = None
    coupling: Matrix | None = unit("kg^(1/2), kg^(1/2) m", default=None)  # (6, m)
    omega: Vector | None = unit("rad/s", default=None)  # (m,)
    internal_damping: Matrix | None = unit("N s/m", default=None)  # (6 + m, 6 + m)
    source: str = "user"

    def __post_init__(self) -> None:
        for name in ("M", "D", "K"):
            symmetric(getattr(self, name), f"MatrixVehicle.{name}")
        self._modes()  # refuses what does not fit together
        if self.drag is not None and (finite(self.drag, (6,), "MatrixVehicle.drag") < 0).any():
            raise ParameterError(f"MatrixVehicle.drag must be >= 0, got {self.drag}")

    def base_model(self) -> BaseModel:
        """The matrices as given, symmetrised to rounding."""
        M, D, K = (symmetric(getattr(self, name), name) for name in "MDK")
        drag = None if self.drag is None else np.array(self.drag)
        internal = InternalModes.of(self.extra or ())
        modes = self._modes()
        if modes is not None:
            internal = modes.joined(internal)
        return BaseModel(M, D, K, drag=drag, internal=internal)

    def _modes(self) -> InternalModes | None:
        if self.omega is None:
            if self.coupling is not None or self.internal_damping is not None:
                raise ParameterError("MatrixVehicle.omega must be given with internal modes")
            return None
        m = len(self.omega)
        if not (finite(self.omega, (m,), "MatrixVehicle.omega") >= 0).all():
            raise ParameterError(f"MatrixVehicle.omega must be >= 0, got {self.omega}")
        coupling = finite(self.coupling, (6, m), "MatrixVehicle.coupling")
        size = 6 + m
        damping = np.zeros((size, size))
        if self.internal_damping is not None:
            damping = symmetric(self.internal_damping, "MatrixVehicle.internal_damping", size)
        return InternalModes(coupling, np.array(self.omega), damping)


@dataclass(frozen=True, kw_only=True)
class Satellite(_Saved):
    """A rigid body in free space under the arm: K = D = 0.

    `thrusters` False is free-floating (no outside force), True is free-flying (its jets
    may apply a wrench: `Simulator.step(..., base_wrench=...)`).
    """

    kind: ClassVar[str] = "satellite"
    body: Inertial
    thrusters: bool = False
    source: str = "user"

    def base_model(self) -> BaseModel:
        """Zero M, D, K, and the body."""
        zero = np.zeros((6, 6))
        return BaseModel(zero, zero, zero, self.body)


Vehicle = Beam | MatrixVehicle | Satellite

STRAIGHT_VERTICAL = Beam(
    segments=((0.0, 0.0, 12.0),),
    outer_diameter=0.07,
    wall=0.006,
    source="thesis App. A.3: 12 m aluminium tube, 70 x 6 mm, arm on top",
)
STRAIGHT_HORIZONTAL = Beam(
    segments=((-12.0, 0.0, 0.0),),
    outer_diameter=0.07,
    wall=0.006,
    source="thesis App. A.3: the same tube lying along -x",
)
BENT = Beam(
    segments=((-8.0, 0.0, 0.0), (0.0, 0.0, 8.0)),
    outer_diameter=0.18,
    wall=0.007,
    source="thesis App. A.5: 8 + 8 m; 'radius of 9 centimeters' read as 180 mm diameter",
)
DECOUPLED = MatrixVehicle(
    M=diagonal(500, 500, 500, 250, 250, 250),
    D=diagonal(500, 500, 500, 250, 250, 250),
    K=diagonal(1500, 2500, 4000, 1500, 1000, 2000),
    source="thesis Table 5-2",
)
# A nominal 500 kg satellite, a homogeneous cube of 1.5 m edge under the arm (this project).
_CUBE = Inertial(mass=500.0, com=(0.0, 0.0, -0.75), inertia=diagonal(187.5, 187.5, 187.5))
FREE_FLOATING = Satellite(body=_CUBE, source="nominal, this project: 500 kg cube, 1.5 m edge")
FREE_FLYING = Satellite(
    body=_CUBE, thrusters=True, source="nominal, this project: the same cube with jets"
)

VEHICLES: dict[str, Vehicle] = {
    "bent": BENT,
    "straight-vertical": STRAIGHT_VERTICAL,
    "straight-horizontal": STRAIGHT_HORIZONTAL,
    "decoupled": DECOUPLED,
    "free-floating": FREE_FLOATING,
    "free-flying": FREE_FLYING,
}


def has(vehicle: Vehicle, name: str) -> bool:
    """Return True if a vehicle's D or K is other than zero.

    Args:
        vehicle: what carries the arm.
        name: "D" or "K".
    """
    if isinstance(vehicle, Beam):
        return name != "D" or vehicle.damping_ratio > 0
    return isinstance(vehicle, MatrixVehicle) and bool(np.any(getattr(vehicle, name)))


def altered(vehicle: Vehicle, base: BaseModel) -> Vehicle:
    """Return the vehicle of another base model of the same kind (with or without a body).

    Args:
        vehicle: as described.
        base: the model that takes the place of its own.
    """
    if base.body is not None:
        thrusters = isinstance(vehicle, Satellite) and vehicle.thrusters
        return Satellite(body=base.body, thrusters=thrusters, source=vehicle.source)
    parts: dict[str, Any] = {name: matrix(getattr(base, name)) for name in "MDK"}
    drag = None if base.drag is None else tuple(base.drag.tolist())
    if base.internal is not None:
        parts |= {
            "coupling": matrix(base.internal.coupling),
            "omega": tuple(base.internal.omega.tolist()),
            "internal_damping": matrix(base.internal.damping),
        }
    return MatrixVehicle(**parts, drag=drag, source=vehicle.source)


def vehicle_from_plain(plain: Any, where: str = "vehicle") -> Vehicle:
    """Rebuild a vehicle from plain data with an entry `kind`.

    Args:
        plain: a table.
        where: path of the entry, for the message.

    Raises:
        ParameterError: unknown kind, unknown or missing keys.
    """
    vehicle: Vehicle = from_plain(Vehicle, plain, where)
    return vehicle


def get_vehicle(name: str | os.PathLike[str]) -> Vehicle:
    """A vehicle by name, or from a .toml or .json file.

    Raises:
        ParameterError: neither a known name nor a readable vehicle file.
    """
    text = os.fspath(name)
    if text in VEHICLES:
        return VEHICLES[text]
    if text.endswith((".toml", ".json")):
        return vehicle_from_plain(read_table(text), text)
    raise ParameterError(
        f"vehicle must be one of {', '.join(VEHICLES)}, or a .toml or .json file, got {text!r}"
        f"{did_you_mean(text, VEHICLES)}"
    )


def beam_line(vehicle: object, y: Array, points: int = 7) -> Array | None:
    """Return the bent centreline of a beam, None of a vehicle that is none.

    Args:
        vehicle: what carries the arm.
        y: (N, 6) base poses [m, rad].
        points: of each segment, both ends included.

    Returns:
        (N, k, 3) points [m].
    """
    if not isinstance(vehicle, Beam):
        return None
    nodes, K = vehicle.nodes, vehicle.stiffness()
    points_along = [np.broadcast_to(nodes[0], (len(y), 3))]
    for s, segment in enumerate(vehicle.segments):
        length = float(np.linalg.norm(segment))
        for x in np.linspace(0, length, points)[1:]:
            shape = (vehicle.flexibility(s, float(x)) @ K)[:3]
            points_along.append(nodes[s] + x / length * np.array(segment) + y @ shape.T)
    return np.stack(points_along, axis=1)
