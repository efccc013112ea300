"""Materials, cross sections, and frames of straight members by finite elements.

Two-node elements whose shapes are exact under end loads: Timoshenko's with rotary inertia
(Friedman and Kosmatka, Computers & Structures 47, 1993), Euler and Bernoulli's where the
section does not shear; bars in tension and torsion beside them. The mass is consistent.
Six freedoms a node, in the frame's axes: (x, y, z, phi_x, phi_y, phi_z), small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    unit,
)
from ves_gym.mechanics.link import Inertial

_GAUSS = np.polynomial.legendre.leggauss(4)  # exact to degree 7; the mass needs 6


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

    @property
    def diameter(self) -> float:
        """Outer diameter, or that of the round bar of its area [m]."""
        return 2 * (self.fibre or math.sqrt(self.area / math.pi))

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
    """Return the shear coefficient of a tube of inner over outer diameter and Poisson's ratio
    [1] (Cowper, J. Appl. Mech. 33, 1966)."""
    even, cross = (1 + ratio**2) ** 2, ratio**2
    return 6 * (1 + poisson) * even / ((7 + 6 * poisson) * even + (20 + 12 * poisson) * cross)


@dataclass(frozen=True)
class BeamFrame:
    """Straight members one after the other, and rigid bodies at the nodes between them."""

    nodes: Array  # (k, 3) [m]
    members: tuple[tuple[Section | Tube, Material], ...]  # (k - 1) from each node to the next
    bodies: tuple[tuple[int, Inertial], ...] = ()  # node, mass properties about it

    def matrices(self, rotary: bool = True) -> tuple[Array, Array]:
        """Return mass and stiffness over all freedoms, two (6k, 6k), SI units; without `rotary`
        sections that tilt have no inertia."""
        M, K = np.zeros((2, 6 * len(self.nodes), 6 * len(self.nodes)))
        for i in range(len(self.members)):
            at, turn, mass, stiffness = self._element(i, rotary)
            M[at, at] += turn.T @ mass @ turn
            K[at, at] += turn.T @ stiffness @ turn
        for node, body in self.bodies:
            at = slice(6 * node, 6 * node + 6)
            M[at, at] += body.spatial()
        return (M + M.T) / 2, (K + K.T) / 2

    def _element(self, i: int, rotary: bool = True) -> tuple[slice, Array, Array, Array]:
        """Freedoms of a member, (12, 12) frame's axes -> its own, mass and stiffness there."""
        way, (section, material) = self.nodes[i + 1] - self.nodes[i], self.members[i]
        length = float(np.linalg.norm(way))
        turn = np.asarray(np.kron(np.eye(4), _axes(way / length, section).T), np.float64)
        # pieces of one member differ in length by rounding: they share one element
        mass, stiffness = element(float(f"{length:.14g}"), section, material, rotary)
        return slice(6 * i, 6 * i + 12), turn, mass, stiffness


def _axes(x: Array, section: Section | Tube) -> Array:
    """(3, 3) local axes of a member as columns: along it (x), local y, local z."""
    up = getattr(section, "up", None)
    # without a direction of its own, that of the axis which is least along the member
    helper = np.eye(3)[int(np.abs(x).argmin())] if up is None else np.array(up, float)
    y = np.cross(helper, x)
    if np.linalg.norm(y) < 1e-9 * np.linalg.norm(helper):
        raise ParameterError(f"Section.up must not lie along its member, got {up}")
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


@lru_cache(maxsize=256)
def element(
    length: float, section: Section | Tube, material: Material, rotary: bool = True
) -> tuple[Array, Array]:
    """Return mass and stiffness of an element of a length [m] along local x, two (12, 12),
    read-only; with `rotary` sections that tilt have inertia."""
    section = section.of(material)
    E, G, rho = material.youngs_modulus, material.shear_modulus, material.density
    area, polar = section.area, section.second_y + section.second_z
    mass, stiffness = np.zeros((12, 12)), np.zeros((12, 12))
    bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / length
    lump = np.array([[2.0, 1.0], [1.0, 2.0]]) * rho * length / 6
    for at, rigidity, inertia in ((0, E * area, area), (3, G * section.torsion, polar)):
        pair = np.ix_([at, at + 6], [at, at + 6])
        stiffness[pair] += rigidity * bar
        mass[pair] += inertia * lump
    # along y with phi_z = dy/dx; along z with phi_y = -dz/dx
    across = (
        ([1, 5, 7, 11], np.ones(4), section.second_z, section.shear_y),
        ([2, 4, 8, 10], np.array([1.0, -1, 1, -1]), section.second_y, section.shear_z),
    )
    for freedoms, signs, second, share in across:
        shear = 0.0 if share is None else 12 * E * second / (share * G * area * length**2)
        m, k = _bending(length, shear, rho * area, rho * second * rotary)
        grid = np.ix_(freedoms, freedoms)
        mass[grid] += np.outer(signs, signs) * m
        stiffness[grid] += E * second * np.outer(signs, signs) * k
    mass.flags.writeable = stiffness.flags.writeable = False
    return mass, stiffness


def _bending(length: float, shear: float, linear: float, rotary: float) -> tuple[Array, Array]:
    """Mass (4, 4), and stiffness (4, 4) per E I, of bending in one plane.

    `shear` is Phi = 12 E I / (kappa G A length^2), `linear` the mass and `rotary` the
    rotary inertia per length; freedoms: way and slope at either end.
    """
    L, stiffer = length, 1 + shear
    a, b = 4 + shear, 2 - shear
    rows = [[12, 6 * L, -12, 6 * L], [6 * L, a * L**2, -6 * L, b * L**2]]
    rows += [[-12, -6 * L, 12, -6 * L], [6 * L, b * L**2, -6 * L, a * L**2]]
    stiffness = np.array(rows) / (stiffer * L**3)
    mass = np.zeros((4, 4))
    for point, weight in zip(*_GAUSS, strict=True):
        s = (1 + point) / 2
        way = np.array([
            1 + shear - shear * s - 3 * s**2 + 2 * s**3,
            L * ((1 + shear / 2) * s - (2 + shear / 2) * s**2 + s**3),
            shear * s + 3 * s**2 - 2 * s**3,
            L * (-shear / 2 * s - (1 - shear / 2) * s**2 + s**3),
        ])  # fmt: skip
        slope = np.array([
            6 * (s**2 - s) / L,
            3 * s**2 - (4 + shear) * s + stiffer,
            -6 * (s**2 - s) / L,
            3 * s**2 - (2 - shear) * s,
        ])  # fmt: skip
        share = weight * L / 2 / stiffer**2
        mass += share * (linear * np.outer(way, way) + rotary * np.outer(slope, slope))
    return mass, stiffness
