"""Frames of straight members in space by finite elements: mass, stiffness, stress.

Two-node elements whose shapes are exact under end loads: Timoshenko's with rotary inertia
(Friedman and Kosmatka, Computers & Structures 47, 1993), Euler and Bernoulli's where the
section does not shear; bars in tension and torsion beside them. The mass is consistent.
Six freedoms a node, in the frame's axes: (x, y, z, phi_x, phi_y, phi_z), small.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError, finite
from ves_gym.mechanics.arm import Inertial
from ves_gym.mechanics.beam import Material, Section, Tube

_GAUSS = np.polynomial.legendre.leggauss(4)  # exact to degree 7; the mass needs 6


class Member(NamedTuple):
    """A straight piece between two nodes of a frame."""

    start: int
    end: int
    section: Section | Tube
    material: Material


@dataclass(frozen=True)
class BeamFrame:
    """Nodes, straight members between them and rigid bodies at nodes."""

    nodes: Array  # (k, 3) [m]
    members: tuple[Member, ...]
    bodies: tuple[tuple[int, Inertial], ...] = ()  # node, mass properties about it

    def __post_init__(self) -> None:
        count = len(self.nodes)
        finite(self.nodes, (count, 3), "BeamFrame.nodes")
        ends = [node for member in self.members for node in member[:2]]
        for node in ends + [node for node, _ in self.bodies]:
            if not 0 <= node < count:
                raise ParameterError(f"BeamFrame has nodes 0 to {count - 1}, got {node}")
        for i, member in enumerate(self.members):
            if np.array_equal(self.nodes[member.start], self.nodes[member.end]):
                raise ParameterError(f"BeamFrame.members[{i}] has no length")

    def divided(self, pieces: int) -> BeamFrame:
        """Return the frame with each member cut into equal pieces; old nodes come first."""
        nodes, members = list(self.nodes), []
        for start, end, section, material in self.members:
            cuts = np.linspace(self.nodes[start], self.nodes[end], pieces + 1)[1:-1]
            chain = [start, *range(len(nodes), len(nodes) + len(cuts)), end]
            nodes += list(cuts)
            members += [Member(a, b, section, material) for a, b in itertools.pairwise(chain)]
        return BeamFrame(np.array(nodes), tuple(members), self.bodies)

    def matrices(self) -> tuple[Any, Any]:
        """Return mass and stiffness over all freedoms, two sparse (6k, 6k), SI units."""
        where, *blocks = self._blocks()
        size = 6 * len(self.nodes)
        rows = np.repeat(where, 12, axis=1).ravel()
        columns = np.tile(where, (1, 12)).ravel()
        out = []
        for block in blocks:
            total = scipy.sparse.coo_array(
                (block.ravel(), (rows, columns)), shape=(size, size)
            ).tocsc()
            out.append((total + total.T) / 2)
        return out[0], out[1]

    def dense(self) -> tuple[Array, Array]:
        """Return mass and stiffness over all freedoms, two (6k, 6k), SI units."""
        where, *blocks = self._blocks()
        out = np.zeros((2, 6 * len(self.nodes), 6 * len(self.nodes)))
        for total, block in zip(out, blocks, strict=True):
            np.add.at(total, (where[:, :, None], where[:, None, :]), block)
        M, K = (out + out.swapaxes(-1, -2)) / 2
        return M, K

    def _blocks(self) -> tuple[Any, Array, Array]:
        """Freedoms (e, 12), mass and stiffness (e, 12, 12) of members and bodies."""
        where, mass, stiffness = [], [], []
        for member in self.members:
            turn = np.kron(np.eye(4), self.axes(member).T)  # frame's axes -> local
            m, k = self._element(member)
            where.append(_freedoms(member.start, member.end))
            mass.append(turn.T @ m @ turn)
            stiffness.append(turn.T @ k @ turn)
        for node, body in self.bodies:
            where.append(_freedoms(node, node))
            mass.append(_at_first(body.spatial()))
            stiffness.append(np.zeros((12, 12)))
        return np.array(where), np.array(mass), np.array(stiffness)

    def _element(self, member: Member) -> tuple[Array, Array]:
        # pieces of one member differ in length by rounding: they share one element
        length = float(f"{self.length(member):.14g}")
        return _shared(length, member.section, member.material)

    def length(self, member: Member) -> float:
        """Length of a member [m]."""
        return float(np.linalg.norm(self.nodes[member.end] - self.nodes[member.start]))

    def axes(self, member: Member) -> Array:
        """(3, 3) local axes of a member as columns: along it, local y, local z."""
        x = (self.nodes[member.end] - self.nodes[member.start]) / self.length(member)
        up = getattr(member.section, "up", None)
        # without a direction of its own, that of the axis which is least along the member
        helper = np.eye(3)[int(np.abs(x).argmin())] if up is None else np.array(up, float)
        y = np.cross(helper, x)
        if np.linalg.norm(y) < 1e-9 * np.linalg.norm(helper):
            raise ParameterError(f"Section.up must not lie along its member, got {up}")
        y /= np.linalg.norm(y)
        return np.stack([x, y, np.cross(x, y)], axis=1)

    def end_loads(self, displacement: Array) -> Array:
        """Return what each member's ends carry: forces and moments in its own axes.

        Args:
            displacement: (..., 6k) of all freedoms [m, rad].

        Returns:
            (..., members, 12): at start and end, on the member [N, N m].
        """
        out = np.zeros((*displacement.shape[:-1], len(self.members), 12))
        for i, member in enumerate(self.members):
            _, k = self._element(member)
            turn = np.kron(np.eye(4), self.axes(member).T)
            at = _freedoms(member.start, member.end)
            out[..., i, :] = displacement[..., at] @ (k @ turn).T
        return out

    def stress(self, displacement: Array) -> Array:
        """Return the largest axial stress at each end of each member.

        Tension plus bending at the outermost fibre, without the loads' own inertia within
        the element; for round sections exact in the fibre that is bent most.

        Args:
            displacement: (..., 6k) of all freedoms [m, rad].

        Returns:
            (..., members, 2) at start and end [Pa].
        """
        loads = self.end_loads(displacement).reshape(*displacement.shape[:-1], -1, 2, 6)
        out = np.zeros(loads.shape[:-1])
        for i, member in enumerate(self.members):
            s = member.section.of(member.material)
            if s.fibre is None:
                raise ParameterError(f"Section.fibre of members[{i}] is needed for stress")
            _, _, _, _, my, mz = np.moveaxis(loads[..., i, :, :], -1, 0)
            bent = s.fibre * np.hypot(my / s.second_y, mz / s.second_z)
            out[..., i, :] = np.abs(loads[..., i, :, 0]) / s.area + bent
        return out


@lru_cache(maxsize=256)
def _shared(length: float, section: Section | Tube, material: Material) -> tuple[Array, Array]:
    m, k = element(length, section.of(material), material)
    m.flags.writeable = k.flags.writeable = False
    return m, k


def element(length: float, section: Section, material: Material) -> tuple[Array, Array]:
    """Return mass and stiffness of an element along local x, two (12, 12).

    Args:
        length: of the element [m].
        section: its cross section.
        material: its material.
    """
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
        m, k = _bending(length, shear, rho * area, rho * second)
        grid = np.ix_(freedoms, freedoms)
        mass[grid] += np.outer(signs, signs) * m
        stiffness[grid] += E * second * np.outer(signs, signs) * k
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


def _freedoms(start: int, end: int) -> list[int]:
    return [*range(6 * start, 6 * start + 6), *range(6 * end, 6 * end + 6)]


def _at_first(block: Array) -> Array:
    out = np.zeros((12, 12))
    out[:6, :6] = block
    return out


def polyline(
    segments: Sequence[Sequence[float]],
    sections: Sequence[Section | Tube],
    material: Material,
) -> BeamFrame:
    """Return a chain of members, its last end at the origin.

    Args:
        segments: (s, 3) vectors from the first node on [m].
        sections: one for each segment.
        material: of them all.
    """
    corners = np.vstack([np.zeros(3), np.cumsum(np.array(segments, float), axis=0)])
    members = tuple(Member(i, i + 1, k, material) for i, k in enumerate(sections))
    return BeamFrame(corners - corners[-1], members)
