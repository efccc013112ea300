"""A beam condensed to its tip, where the arm stands (thesis Appendix A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    finite,
    freeze_arrays,
    require_choice,
    require_positive,
    unit,
)
from ves_gym.mechanics.arm import skew
from ves_gym.mechanics.base_model import BaseModel, Saved, elementwise_damping, modal_damping
from ves_gym.mechanics.section import ALUMINIUM, Material

_CLOSED = 0.01  # of a beam's length: a tip nearer to the clamp has no m L^2 about it
_GAUSS = np.polynomial.legendre.leggauss(4)  # exact to degree 7; the beam needs 6


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
        reach = float(np.linalg.norm(self.nodes[0]))
        if self.mass_model == "thesis" and reach < _CLOSED * self.length:
            raise ParameterError(
                f"Beam.mass_model thesis needs a tip apart from the clamp, got {reach:.3g} m on"
                f" {self.length:.3g} m of beam: its m L^2 would vanish; consistent takes any"
            )

    @property
    def section(self) -> tuple[float, float, float]:
        """Area [m^2], second moment I and polar moment J = 2 I [m^4] of the tube."""
        outer, inner = self.outer_diameter, self.outer_diameter - 2 * self.wall
        second = np.pi / 64 * (outer**4 - inner**4)
        return np.pi / 4 * (outer**2 - inner**2), second, 2 * second

    @property
    def length(self) -> float:
        """Sum of the tubes' lengths [m]."""
        return sum(float(np.linalg.norm(s)) for s in self.segments)

    @property
    def mass(self) -> float:
        """Mass of the whole beam [kg]."""
        return self.section[0] * self.length * self.material.density

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
        return np.diag([half] * 3 + np.maximum(half * lever, floor).tolist())

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
