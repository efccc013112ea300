"""A serial arm as data: standard Denavit-Hartenberg links with mass properties.

Another arm, or the PUMA with its wrist, is another `Arm` (or a TOML file read by
`read_arm`), not another piece of code.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    from_plain,
    read_table,
    require_positive,
    unit,
)

_ROUNDING = 1e-12  # relative slack of the inertia tests, kg m^2 per kg m^2


@dataclass(frozen=True, kw_only=True)
class Inertial:
    """Mass properties of a rigid body in its own frame."""

    mass: float = unit("kg")
    com: Vector = unit("m")  # (3,) centre of mass
    inertia: Matrix = unit("kg m^2")  # (3, 3) about the centre of mass

    def __post_init__(self) -> None:
        require_positive(self, "mass", zero=True)
        finite(self.com, (3,), "Inertial.com")
        moments = finite(self.inertia, (3, 3), "Inertial.inertia")
        size = max(float(np.abs(moments).max()), 1e-300)
        if np.abs(moments - moments.T).max() > _ROUNDING * size:
            raise ParameterError(f"Inertial.inertia must be symmetric, got {self.inertia}")
        a, b, c = np.linalg.eigvalsh(moments)
        if a < -_ROUNDING * size or c > a + b + _ROUNDING * size:
            raise ParameterError(
                "Inertial.inertia must be that of a rigid body (principal moments >= 0, none"
                f" larger than the sum of the others), got {a:.6g}, {b:.6g}, {c:.6g} kg m^2"
            )

    def spatial(self) -> Array:
        """(6, 6) inertia at the frame's origin, linear part first [kg, kg m, kg m^2]."""
        c = skew(np.array(self.com))
        out = np.zeros((6, 6))
        out[:3, :3] = self.mass * np.eye(3)
        out[:3, 3:] = -self.mass * c
        out[3:, :3] = self.mass * c
        out[3:, 3:] = np.array(self.inertia) - self.mass * c @ c
        return out


@dataclass(frozen=True, kw_only=True)
class Gear:
    """Spring with play between a rotor and its link, a damper beside it.

    Torque at a deflection d of the link against the rotor: -(d less the play) / compliance
    - damping d', the play being what of d lies within half the gap on either side.
    """

    compliance: float = unit("rad/(N m)")
    damping: float = unit("N m s/rad", default=0.0)
    gap: float = unit("rad", default=0.0)

    def __post_init__(self) -> None:
        require_positive(self, "compliance")
        require_positive(self, "damping", "gap", zero=True)

    @property
    def stiffness(self) -> float:
        """1 / compliance [N m/rad]."""
        return 1 / self.compliance


@dataclass(frozen=True, kw_only=True)
class Link:
    """One revolute joint and the link it moves; the frame sits at the link's far end.

    Standard DH: frame i-1 -> i is Rot_z(q + offset) Trans_z(d) Trans_x(a) Rot_x(alpha).
    With a `gear` that gives way q is the rotor's angle and the link turns further by the
    gear's deflection, a coordinate of its own (Spong, J. Dyn. Sys. 109, 1987); without one
    rotor and link are rigidly one.
    """

    d: float = unit("m")
    a: float = unit("m")
    alpha: float = unit("rad")
    offset: float = unit("rad", default=0.0)
    inertial: Inertial
    rotor_inertia: float = unit("kg m^2", default=0.0)  # reflected through the gear
    q_min: float = unit("rad")
    q_max: float = unit("rad")
    v_max: float = unit("rad/s")
    a_max: float = unit("rad/s^2")
    tau_max: float = unit("N m")
    gear: Gear | None = None

    def __post_init__(self) -> None:
        finite((self.d, self.a, self.alpha, self.offset, self.q_min, self.q_max), (6,), "Link")
        require_positive(self, "v_max", "a_max", "tau_max")
        require_positive(self, "rotor_inertia", zero=True)
        if self.gear is not None and self.rotor_inertia == 0:
            raise ParameterError(
                "a Link with a gear needs rotor_inertia > 0 kg m^2: the gear turns against it"
            )
        if not self.q_min < self.q_max:
            raise ParameterError(f"Link needs q_min < q_max, got {self.q_min} and {self.q_max}")

    @property
    def far_end(self) -> tuple[Array, Array]:
        """Rotation (3, 3) and position (3,) of the link frame in the frame at its joint."""
        c, s = math.cos(self.alpha), math.sin(self.alpha)
        rotation = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
        return rotation.round(15), np.array([self.a, 0.0, self.d])

    @property
    def inertial_at_joint(self) -> Inertial:
        """The same mass properties in the frame at the joint (z along its axis)."""
        R, p = self.far_end
        return Inertial(
            mass=self.inertial.mass,
            com=tuple((p + R @ np.array(self.inertial.com)).tolist()),
            inertia=matrix(R @ np.array(self.inertial.inertia) @ R.T),
        )


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A serial arm on a base link fixed to the platform top."""

    name: str
    base: Inertial  # base link, in the platform-top frame
    links: tuple[Link, ...]
    source: str  # where this whole set comes from

    def __post_init__(self) -> None:
        if not self.links:
            raise ParameterError("Arm.links must hold at least one link, got none")

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def geared(self) -> tuple[int, ...]:
        """Joints (from 0) whose gears give way."""
        return tuple(i for i, link in enumerate(self.links) if link.gear is not None)

    def column(self, name: str) -> Array:
        """One number of every link, e.g. `column("tau_max")`: (n,)."""
        return np.array([getattr(link, name) for link in self.links])

    @property
    def mass(self) -> float:
        """Total mass [kg]."""
        return self.base.mass + sum(link.inertial.mass for link in self.links)

    def require_within_limits(self, q: object, name: str = "q") -> Array:
        """Return joint angles as an array inside the joint limits.

        Args:
            q: (n,) angles [rad].
            name: of the angles, for the message.

        Raises:
            ParameterError: names the joint, its angle and its limits.
        """
        array = finite(q, (self.n,), name)
        for i, link in enumerate(self.links):
            if not link.q_min - 1e-9 <= array[i] <= link.q_max + 1e-9:
                raise ParameterError(
                    f"{name}: joint {i + 1} must be within {math.degrees(link.q_min):.1f} to"
                    f" {math.degrees(link.q_max):.1f} deg, got {math.degrees(array[i]):.1f} deg"
                )
        return array


def read_arm(path: str | os.PathLike[str]) -> Arm:
    """Read an arm from a TOML or JSON file that mirrors `Arm`."""
    arm: Arm = from_plain(Arm, read_table(path), str(path))
    return arm


def diagonal(*moments: float) -> Matrix:
    """A diagonal matrix as nested tuples."""
    return matrix(np.diag(moments))


def matrix(values: Array) -> Matrix:
    """A 2-D array as nested tuples of float."""
    return tuple(tuple(row) for row in np.asarray(values, float).tolist())


def skew(v: Array) -> Array:
    """Cross-product matrix: skew(v) @ w = v x w."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0.0]])
