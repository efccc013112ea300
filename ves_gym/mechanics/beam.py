"""Materials, cross sections, and a beam condensed to its tip, where the arm stands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_choice,
    require_positive,
    unit,
)
from ves_gym.mechanics.base_model import BaseModel, Saved, elementwise_damping
from ves_gym.mechanics.modes import modal_damping
from ves_gym.mechanics.spatial import skew

_CLOSED = 0.01  # of a beam's length: a tip nearer to the clamp has no m L^2 about it
_GAUSS = np.polynomial.legendre.leggauss(4)  # exact to degree 7; the beam needs 6


@dataclass(frozen=True, kw_only=True)
class Material:
    """An isotropic elastic material."""

    youngs_modulus: float = unit("Pa")
    shear_modulus: float = unit("Pa")
    density: float = unit("kg/m^3")
    source: str

    def __post_init__(self) -> None:
        require_positive(self, "youngs_modulus", "shear_modulus", "density")

    @property
    def poisson(self) -> float:
        """Poisson's ratio E / 2G - 1 [1]."""
        return self.youngs_modulus / (2 * self.shear_modulus) - 1


ALUMINIUM = Material(
    youngs_modulus=72e9, shear_modulus=27e9, density=2.8e3, source="thesis App. A.2"
)


@dataclass(frozen=True, kw_only=True)
class Section:
    """A cross section by its numbers, in principal axes; the member runs along local x.

    `shear_y`, `shear_z`: share of the area that carries shear (Timoshenko); without them
    the member does not shear (Euler-Bernoulli). `up`: direction near which local z lies.
    """

    kind: ClassVar[str] = "section"
    area: float = unit("m^2")
    second_y: float = unit("m^4")  # int z^2 dA: resists bending along z
    second_z: float = unit("m^4")  # int y^2 dA: resists bending along y
    torsion: float = unit("m^4")  # Saint-Venant's
    shear_y: float | None = unit("1", default=None)
    shear_z: float | None = unit("1", default=None)
    fibre: float | None = unit("m", default=None)  # from the axis to the outermost fibre
    up: Vector | None = unit("1", default=None)

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "area", "second_y", "second_z", "torsion")
        for name in ("shear_y", "shear_z", "fibre"):
            if getattr(self, name) is not None:
                require_positive(self, name)
        if (self.shear_y is None) != (self.shear_z is None):
            raise ParameterError(
                "Section needs both shear_y and shear_z or neither, got"
                f" {self.shear_y} and {self.shear_z}"
            )
        if self.up is not None and not np.linalg.norm(finite(self.up, (3,), "Section.up")):
            raise ParameterError("Section.up must not be zero")

    def of(self, material: Material) -> Section:
        """Return the section itself; a `Tube` becomes one with its material's shear."""
        return self


@dataclass(frozen=True, kw_only=True)
class Tube:
    """A round tube. With `shear` it also shears (Timoshenko, Cowper's coefficient)."""

    kind: ClassVar[str] = "tube"
    outer_diameter: float = unit("m")
    wall: float = unit("m")
    shear: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "outer_diameter", "wall")
        if 2 * self.wall >= self.outer_diameter:
            raise ParameterError(
                f"Tube.wall must be < half the outer diameter {self.outer_diameter} m,"
                f" got {self.wall} m"
            )

    def of(self, material: Material) -> Section:
        """Return the section's numbers; the shear coefficient depends on Poisson's ratio."""
        outer, inner = self.outer_diameter, self.outer_diameter - 2 * self.wall
        second = np.pi / 64 * (outer**4 - inner**4)
        share = cowper(inner / outer, material.poisson) if self.shear else None
        return Section(
            area=np.pi / 4 * (outer**2 - inner**2),
            second_y=second,
            second_z=second,
            torsion=2 * second,
            shear_y=share,
            shear_z=share,
            fibre=outer / 2,
        )


def cowper(ratio: float, poisson: float) -> float:
    """Return the shear coefficient of a round tube [1] (Cowper, J. Appl. Mech. 33, 1966).

    Args:
        ratio: inner over outer diameter [1].
        poisson: Poisson's ratio [1].
    """
    even, cross = (1 + ratio**2) ** 2, ratio**2
    return 6 * (1 + poisson) * even / ((7 + 6 * poisson) * even + (20 + 12 * poisson) * cross)


@dataclass(frozen=True, kw_only=True)
class Beam(Saved):
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
        freeze_arrays(self)
        require_positive(self, "outer_diameter", "wall")
        require_positive(self, "damping_ratio", zero=True)
        Tube(outer_diameter=self.outer_diameter, wall=self.wall)  # refuses too thick a wall
        require_choice(self, "mass_model", ("thesis", "consistent"))
        require_choice(self, "damping_model", ("modal", "elementwise"))
        if not self.segments:
            raise ParameterError("Beam.segments must hold at least one vector, got none")
        for i, segment in enumerate(self.segments):
            if np.linalg.norm(finite(segment, (3,), f"Beam.segments[{i}]")) == 0:
                raise ParameterError(f"Beam.segments[{i}] must not have zero length")
        reach = float(np.linalg.norm(self.nodes[0]))
        if self.mass_model == "thesis" and reach < _CLOSED * self.length:
            raise ParameterError(
                f"Beam.mass_model thesis needs a tip apart from the clamp, got {reach:.3g} m on"
                f" {self.length:.3g} m of beam: its m L^2 would vanish; consistent takes any"
            )

    @cached_property
    def section(self) -> Section:
        """The tubes' cross section; its torsion is their polar moment."""
        tube = Tube(outer_diameter=self.outer_diameter, wall=self.wall)
        return tube.of(self.material)

    @property
    def length(self) -> float:
        """Sum of the tubes' lengths [m]."""
        return sum(float(np.linalg.norm(s)) for s in self.segments)

    @property
    def mass(self) -> float:
        """Mass of the whole beam [kg]."""
        return self.section.area * self.length * self.material.density

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
        area, second, polar = self.section.area, self.section.second_y, self.section.torsion
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
        floor = np.zeros(3)
        for segment in self.segments:
            length = float(np.linalg.norm(segment))
            axial = (np.array(segment) / length) ** 2
            floor += self.material.density * self.section.torsion * length / 3 * axial
        return np.diag([half] * 3 + np.maximum(half * lever, floor).tolist())

    def consistent_mass(self) -> Array:
        """(6, 6) M of the beam moving in its static shapes under tip wrenches."""
        area, polar = self.section.area, self.section.torsion
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
