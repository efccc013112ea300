"""A flexible structure under the arm, with the modes that its own mass gives it.

The structure is a polyline of tubes and other sections, divided into finite elements, or
the reduced matrices of a user's own model. Interface and internal modes follow by Craig and
Bampton's reduction; docs/physics.md derives both.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, NamedTuple

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
    symmetric,
    unit,
)
from ves_gym._util.threads import on_one_thread
from ves_gym.mechanics.base_model import (
    BaseModel,
    InternalModes,
    Saved,
    elementwise_damping,
)
from ves_gym.mechanics.craig_bampton import Reduction, reduce, with_residual
from ves_gym.mechanics.finite_elements import (
    ALUMINIUM,
    BeamFrame,
    Material,
    Section,
    Tube,
)
from ves_gym.mechanics.link import Inertial, matrix
from ves_gym.mechanics.modes import modal_damping

ELEMENTS = 24  # of a member: eight modes to 1e-5 of their frequency (tests/mechanics)
_ROUNDING = 1e-9
_CLOSED = 0.01  # of a beam's length: a tip nearer to the clamp has no m L^2 about it
REACH = 800.0  # rad/s: omega dt = 1 at a physics step of 1.25 ms


@dataclass(frozen=True, kw_only=True)
class Strut:
    """A straight member of a polyline."""

    vector: Vector = unit("m")  # (3,) from its start to its end
    section: Tube | Section
    material: Material = ALUMINIUM

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if np.linalg.norm(finite(self.vector, (3,), "Strut.vector")) == 0:
            raise ParameterError("Strut.vector must not have zero length")


@dataclass(frozen=True, kw_only=True)
class CornerBody:
    """A rigid body at a corner of a polyline; its frame sits there in platform axes."""

    corner: int  # 0 is the clamp, the last is the flange
    inertial: Inertial


@dataclass(frozen=True, kw_only=True)
class Polyline:
    """A clamped chain of straight members; the arm stands on its free end."""

    kind: ClassVar[str] = "polyline"
    members: tuple[Strut, ...]
    bodies: tuple[CornerBody, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if not self.members:
            raise ParameterError("Polyline.members must hold at least one, got none")
        for body in self.bodies:
            if not 1 <= body.corner <= len(self.members):
                raise ParameterError(
                    f"CornerBody.corner must be 1 to {len(self.members)}, got {body.corner}"
                )

    @staticmethod
    def of(beam: Beam) -> Polyline:
        """Return the members of a condensed beam."""
        tube = Tube(outer_diameter=beam.outer_diameter, wall=beam.wall)
        return Polyline(
            members=tuple(
                Strut(vector=tuple(k), section=tube, material=beam.material)
                for k in beam.segments
            )
        )

    @property
    def corners(self) -> Array:
        """(s + 1, 3) from clamp to flange, the flange at the origin [m]."""
        ends = np.cumsum([k.vector for k in self.members], axis=0)
        out: Array = np.vstack([np.zeros(3), ends]) - ends[-1]
        return out

    def frame(self, elements: int = ELEMENTS) -> BeamFrame:
        """Return the finite-element model, nodes from clamp to flange; `elements` a member."""
        corners = self.corners
        cuts = [np.linspace(*k, elements + 1)[1:] for k in itertools.pairwise(corners)]
        members = tuple((k.section, k.material) for k in self.members for _ in range(elements))
        bodies = tuple((elements * k.corner, k.inertial) for k in self.bodies)
        return BeamFrame(np.vstack([corners[:1], *cuts]), members, bodies)


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
        return Polyline.of(self).corners

    @cached_property
    def _condensed(self) -> Reduction:
        """K and Guyan's M of the beam's own freedoms on its tip, without rotary inertia."""
        return _statics(Polyline.of(self), rotary=False)

    def stiffness(self) -> Array:
        """(6, 6) K at the tip."""
        return self._condensed.K.copy()

    def consistent_mass(self) -> Array:
        """(6, 6) M of the beam moving in its static shapes under tip wrenches."""
        return self._condensed.M.copy()

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

    def base_model(self) -> BaseModel:
        """M, D, K at the tip, where the arm stands."""
        K = self.stiffness()
        M = self.thesis_mass() if self.mass_model == "thesis" else self.consistent_mass()
        damping = modal_damping if self.damping_model == "modal" else elementwise_damping
        return BaseModel(M, damping(M, K, self.damping_ratio), K)


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """Reduced matrices of a user's structure over (Y, eta), and a line to draw it by.

    Over interface and modes with the interface held, as `Structure.reduced` gives them.
    """

    kind: ClassVar[str] = "reduced"
    K: Matrix = unit("N/m, N, N m")
    M: Matrix = unit("kg, kg m, kg m^2")  # in static shapes (Guyan)
    coupling: Matrix = unit("kg^(1/2), kg^(1/2) m")  # (6, m) P
    omega: Vector = unit("rad/s")  # (m,) with the interface held
    damping: Matrix | None = unit("N s/m", default=None)  # (6 + m, 6 + m) over (Y', eta')
    centreline: Matrix | None = unit("m", default=None)  # (k, 3) points at rest
    static: Matrix | None = unit("m, 1", default=None)  # (3 k, 6) per Y
    shapes: Matrix | None = unit("kg^(-1/2)", default=None)  # (3 k, m) per eta
    diameter: float | None = unit("m", default=None)  # to draw it with

    def __post_init__(self) -> None:
        freeze_arrays(self)
        m = len(self.omega)
        symmetric(self.K, "Reduced.K")
        symmetric(self.M, "Reduced.M")
        finite(self.coupling, (6, m), "Reduced.coupling")
        omega = finite(self.omega, (m,), "Reduced.omega")
        if m and not (omega[0] > 0 and (np.diff(omega) >= 0).all()):
            raise ParameterError(
                f"Reduced.omega must be > 0 rad/s and ascend, got {list(self.omega)}"
            )
        P = np.array(self.coupling).reshape(6, m)
        condensed = np.linalg.eigvalsh(np.array(self.M) - P @ P.T)
        if condensed[0] <= 0:
            raise ParameterError(
                "Reduced.M - coupling coupling^T must be positive definite, got an eigenvalue"
                f" {condensed[0]:.6g}"
            )
        if self.damping is not None:
            symmetric(self.damping, "Reduced.damping", 6 + m)
        if self.centreline is not None:
            count = len(self.centreline)
            finite(self.centreline, (count, 3), "Reduced.centreline")
            finite(self.static, (3 * count, 6), "Reduced.static")
            finite(self.shapes, (3 * count, m), "Reduced.shapes")

    @staticmethod
    def of(
        reduction: Reduction,
        line: tuple[Array, Array, Array] | None = None,
        diameter: float | None = None,
    ) -> Reduced:
        """Return the matrices of a reduction in SI units, drawn with a diameter along a line of
        (k, 3) points [m], their ways (3 k, 6) per Y and (3 k, m) per eta."""
        drawn = zip(("centreline", "static", "shapes"), map(matrix, line or ()), strict=False)
        return Reduced(
            K=matrix(reduction.K),
            M=matrix(reduction.M),
            coupling=matrix(reduction.coupling),
            omega=tuple(reduction.omega.tolist()),
            damping=None if reduction.damping is None else matrix(reduction.damping),
            diameter=diameter,
            **dict(drawn),
        )

    def reduction(self) -> Reduction:
        """Return the matrices as a reduction; its freedoms are those of the line."""
        m, count = len(self.omega), 0 if self.centreline is None else len(self.centreline)
        static = np.zeros((0, 6)) if self.static is None else np.array(self.static)
        shapes = np.zeros((0, m)) if self.shapes is None else np.array(self.shapes)
        return Reduction(
            K=symmetric(self.K, "Reduced.K"),
            M=symmetric(self.M, "Reduced.M"),
            coupling=np.array(self.coupling).reshape(6, m),
            omega=np.array(self.omega),
            static=static.reshape(3 * count, 6),
            shapes=shapes.reshape(3 * count, m),
            damping=None if self.damping is None else np.array(self.damping),
        )


class Centreline(NamedTuple):
    """A structure's centreline and its ways."""

    at_rest: Array  # (k, 3) [m]
    static: Array  # (k, 3, 6) per Y
    shapes: Array  # (k, 3, m) per eta


@dataclass(frozen=True, kw_only=True)
class FlexibleBase(Saved):
    """A flexible structure: the pose of its flange and `modes` internal modes.

    Damping: `damping_ratio` of every mode of the whole without the arm, or one for each of
    its 6 + m modes, slowest first (`damping_ratios`), or neither where the structure brings
    a damping matrix of its own. Modes faster than `fastest` follow the flange in statics: right
    for an arm's motion, too heavy for an impulse. `residual` makes of all that is left out of a
    polyline six modes more, so that an impulse meets the flange alone, as with all modes.
    """

    kind: ClassVar[str] = "flexible"
    structure: Polyline | Reduced
    modes: int = 8
    damping_ratio: float | None = unit("1", default=None)
    damping_ratios: Vector | None = unit("1", default=None)
    fastest: float = unit("rad/s", default=REACH)
    residual: bool = False
    source: str = "user"

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "fastest")
        if self.residual and (isinstance(self.structure, Reduced) or self.damping_ratios):
            raise ParameterError(
                "FlexibleBase.residual needs a polyline and one damping_ratio: give a structure"
                " of matrices all the modes that an impulse is to find"
            )
        most = 120 if isinstance(self.structure, Polyline) else len(self.structure.omega)
        if isinstance(self.modes, bool) or not 0 <= self.modes <= most:
            raise ParameterError(f"FlexibleBase.modes must be 0 to {most}, got {self.modes!r}")
        has_damping = isinstance(self.structure, Reduced) and self.structure.damping is not None
        count = (self.damping_ratio is not None) + (self.damping_ratios is not None)
        if count != (0 if has_damping and not count else 1):
            raise ParameterError(
                "FlexibleBase needs damping_ratio or damping_ratios, or a structure with its"
                f" own damping, got {self.damping_ratio} and {self.damping_ratios}"
            )
        if self.damping_ratio is not None:
            require_positive(self, "damping_ratio", zero=True)
        if self.damping_ratios is not None:
            size = (6 + self.modes,)
            ratios = finite(self.damping_ratios, size, "FlexibleBase.damping_ratios")
            if (ratios < 0).any():
                raise ParameterError(
                    f"FlexibleBase.damping_ratios must be >= 0, got {self.damping_ratios}"
                )

    @staticmethod
    def of(beam: Beam, modes: int) -> FlexibleBase:
        """Return a condensed beam with so many modes of its own: its shape, section, material,
        damping ratio and source."""
        return FlexibleBase(
            structure=Polyline.of(beam),
            modes=modes,
            damping_ratio=beam.damping_ratio,
            source=beam.source,
        )

    @property
    def nodes(self) -> Array | None:
        """(k, 3) corners from clamp to flange, or the drawn points of a user's model [m]."""
        if isinstance(self.structure, Polyline):
            return self.structure.corners
        points = self.structure.centreline
        return None if points is None else np.array(points)

    @property
    def outer_diameter(self) -> float:
        """Largest outer diameter, to draw it and to keep clear of it [m]."""
        if isinstance(self.structure, Reduced):
            return self.structure.diameter or 0.1
        return max(k.section.of(k.material).diameter for k in self.structure.members)

    def reduction(self) -> Reduction:
        """Return interface and the retained internal modes."""
        return _reduction(self)

    def base_model(self) -> BaseModel:
        """M, K at the flange, and the internal modes with all the damping."""
        return _base_model(self)

    def centreline(self) -> Centreline | None:
        """Return the centreline and its ways, None of a model without one."""
        return _centreline(self)


def as_an_impulse_finds(base: FlexibleBase) -> FlexibleBase:
    """Return an undamped base with everything that its modes leave out."""
    changes: dict[str, Any] = {"damping_ratio": 0.0, "damping_ratios": None}
    if isinstance(base.structure, Polyline):
        return replace(base, residual=True, **changes)
    return replace(base, modes=len(base.structure.omega), fastest=math.inf, **changes)


@lru_cache(maxsize=32)
@on_one_thread(scipy=False)  # a machine has the same bits in every process
def _reduction(base: FlexibleBase) -> Reduction:
    if isinstance(base.structure, Reduced):
        return base.structure.reduction().truncated(base.modes).within(base.fastest)
    return _polyline_reduction(base)


def _polyline_reduction(base: FlexibleBase) -> Reduction:
    polyline = base.structure
    assert isinstance(polyline, Polyline)
    mass, stiffness = polyline.frame().matrices()
    reduced = _on_the_flange((mass, stiffness), base.modes).within(base.fastest)
    if base.residual:
        flange = np.arange(len(mass) - 6, len(mass))
        reduced = with_residual(reduced, mass, stiffness, flange, range(6))
    # what symmetry makes zero is zero, not what rounding leaves of it
    # (a mode carries at most the mass along an axis)
    least = _ROUNDING * np.sqrt(np.diag(reduced.M))[:, None]
    coupling = np.where(np.abs(reduced.coupling) < least, 0.0, reduced.coupling)
    mass = _with_zeros(reduced.M, _ROUNDING)
    return replace(reduced, K=_statics(polyline).K, M=mass, coupling=coupling)


def _statics(polyline: Polyline, rotary: bool = True) -> Reduction:
    """Interface alone: one element a member is exact, and better conditioned than many."""
    reduced = _on_the_flange(polyline.frame(1).matrices(rotary), 0)
    # a symmetric structure has exact zeros; the solution leaves rounding there
    small = np.abs(reduced.K) < 1e-14 * np.abs(reduced.K).max()
    return replace(reduced, K=np.where(small, 0.0, reduced.K))


def _on_the_flange(matrices: tuple[Array, Array], modes: int) -> Reduction:
    """Clamped at the first node, its interface the last one."""
    size = len(matrices[0])
    return reduce(*matrices, np.arange(size - 6, size), modes, held=range(6))


def _with_zeros(values: Array, least: float) -> Array:
    """A symmetric matrix without entries below a share of their two diagonal ones."""
    size = np.sqrt(np.diag(values))
    return np.where(np.abs(values) < least * np.outer(size, size), 0.0, values)


@lru_cache(maxsize=32)
@on_one_thread(scipy=False)
def _base_model(base: FlexibleBase) -> BaseModel:
    reduced = base.reduction()
    if base.damping_ratio is not None:
        damping = reduced.modal_damping(base.damping_ratio)
    elif base.damping_ratios is not None:
        damping = reduced.modal_damping(np.array(base.damping_ratios[: 6 + reduced.m]))
    elif reduced.damping is not None:
        damping = reduced.damping
    condensed, damping = (_with_zeros(k, 1e-12) for k in reduced.absolute(damping))
    zero = np.zeros((6, 6))
    modes = InternalModes(reduced.coupling, reduced.omega, damping)
    for array in (condensed, zero, reduced.K, modes.coupling, modes.omega, modes.damping):
        array.flags.writeable = False  # shared by every system with this base
    return BaseModel(condensed, zero, reduced.K, internal=modes)


@lru_cache(maxsize=32)
def _centreline(base: FlexibleBase) -> Centreline | None:
    reduced = base.reduction()
    if isinstance(base.structure, Reduced):
        if base.structure.centreline is None:
            return None
        at_rest = np.array(base.structure.centreline)
        rows = np.arange(3 * len(at_rest)).reshape(-1, 3)
    else:
        at_rest = base.structure.frame().nodes
        rows = np.arange(6 * len(at_rest)).reshape(-1, 6)[:, :3]
    return Centreline(at_rest, reduced.static[rows], reduced.shapes[rows])


def beam_line(
    vehicle: object, y: Array, u: Array | None = None, points: int = 7
) -> Array | None:
    """Return the bent centreline (N, k, 3) [m] of a beam or a flexible base; None of another
    vehicle.

    At poses y (N, 6) of its flange and u (N, m) of internal modes [kg^(1/2) m] (None: at rest
    on the flange), with so many points of each member of a polyline, both ends included.
    """
    base = FlexibleBase.of(vehicle, 0) if isinstance(vehicle, Beam) else vehicle
    centreline = base.centreline() if isinstance(base, FlexibleBase) else None
    if not isinstance(base, FlexibleBase) or centreline is None:
        return None
    at_rest, static, shapes = centreline
    if isinstance(base.structure, Polyline):
        cuts = np.unique(np.round(np.linspace(0, ELEMENTS, points)).astype(int))
        starts = [ELEMENTS * i for i in range(len(base.structure.members))]
        chosen = np.unique([a + b for a, b in itertools.product(starts, cuts)])
        at_rest, static, shapes = at_rest[chosen], static[chosen], shapes[chosen]
    out = at_rest + np.einsum("kic,nc->nki", static, y)
    if u is not None:
        eta = u - y @ base.reduction().coupling
        out = out + np.einsum("kic,nc->nki", shapes, eta)
    return np.asarray(out, dtype=np.float64)
