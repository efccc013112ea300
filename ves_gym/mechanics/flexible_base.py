"""A flexible structure under the arm, with the modes that its own mass gives it.

The structure is a polyline of tubes and other sections, divided into finite elements, or
the reduced matrices of a user's own model. Interface and internal modes follow by Craig and
Bampton's reduction; docs/physics.md derives both.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from ves_gym._util.params import (
    Array,
    Matrix,
    ParameterError,
    Vector,
    finite,
    freeze_arrays,
    require_positive,
    symmetric,
    unit,
)
from ves_gym._util.threads import on_one_thread
from ves_gym.mechanics.arm import Inertial
from ves_gym.mechanics.base_model import BaseModel, InternalModes, Saved
from ves_gym.mechanics.beam import ALUMINIUM, Beam, Material, Section, Tube
from ves_gym.mechanics.craig_bampton import Reduction, reduce
from ves_gym.mechanics.finite_elements import BeamFrame, Member

ELEMENTS = 24  # of a member: eight modes to 1e-5 of their frequency (tests/mechanics)
_ROUNDING = 1e-9
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
        """Return the finite-element model; corners are its first nodes.

        Args:
            elements: of each member.
        """
        members = tuple(
            Member(i, i + 1, k.section, k.material) for i, k in enumerate(self.members)
        )
        bodies = tuple((k.corner, k.inertial) for k in self.bodies)
        return BeamFrame(self.corners, members, bodies).divided(elements)

    def path(self, elements: int = ELEMENTS) -> list[int]:
        """Nodes of `frame` from clamp to flange."""
        corners, inner = len(self.members) + 1, elements - 1
        out = [0]
        for i in range(len(self.members)):
            first = corners + i * inner
            out += [*range(first, first + inner), i + 1]
        return out


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
        condensed = np.linalg.eigvalsh(self._condensed())
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

    def _condensed(self) -> Array:
        P = np.array(self.coupling).reshape(6, -1)
        condensed: Array = np.array(self.M) - P @ P.T
        return condensed

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
    a damping matrix of its own. Modes faster than `fastest` follow the flange in statics.
    """

    kind: ClassVar[str] = "flexible"
    structure: Polyline | Reduced
    modes: int = 8
    damping_ratio: float | None = unit("1", default=None)
    damping_ratios: Vector | None = unit("1", default=None)
    fastest: float = unit("rad/s", default=REACH)
    source: str = "user"

    def __post_init__(self) -> None:
        freeze_arrays(self)
        require_positive(self, "fastest")
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
        """Return a condensed beam with its own modes and the same damping ratio.

        Args:
            beam: its shape, section, material, damping ratio and source are taken over.
            modes: internal modes to keep.
        """
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
        tubes = [k.section.of(k.material) for k in self.structure.members]
        return max(2 * (k.fibre or np.sqrt(k.area / np.pi)) for k in tubes)

    def reduction(self) -> Reduction:
        """Return interface and the internal modes that are kept."""
        return _reduction(self)

    def base_model(self) -> BaseModel:
        """M, K at the flange, and the internal modes with all the damping."""
        return _base_model(self)

    def centreline(self) -> Centreline | None:
        """Return the centreline and its ways, None of a model without one."""
        return _centreline(self)


@lru_cache(maxsize=32)
@on_one_thread()  # a machine has the same bits in every process
def _reduction(base: FlexibleBase) -> Reduction:
    if isinstance(base.structure, Reduced):
        return base.structure.reduction().truncated(base.modes).within(base.fastest)
    reduced = _polyline_reduction(base.structure, base.modes)
    return reduced.within(base.fastest)


def _polyline_reduction(polyline: Polyline, modes: int) -> Reduction:
    flange = np.arange(6) + 6 * len(polyline.members)
    M, K = polyline.frame().dense()
    reduced = reduce(M, K, flange, modes, held=range(6))
    # one element a member is exact in statics, and better conditioned
    coarse = polyline.frame(1).dense()
    stiffness = reduce(*coarse, flange, 0, held=range(6)).K
    stiffness[np.abs(stiffness) < 1e-14 * np.abs(stiffness).max()] = 0.0  # as `Beam` has it
    # what symmetry makes zero is zero, not what rounding leaves of it
    # (a mode carries at most the mass along an axis)
    least = _ROUNDING * np.sqrt(np.diag(reduced.M))[:, None]
    coupling = np.where(np.abs(reduced.coupling) < least, 0.0, reduced.coupling)
    mass = _with_zeros(reduced.M, _ROUNDING)
    return replace(reduced, K=stiffness, M=mass, coupling=coupling)


def _with_zeros(values: Array, least: float) -> Array:
    """A symmetric matrix without entries below a share of their two diagonal ones."""
    size = np.sqrt(np.diag(values))
    return np.where(np.abs(values) < least * np.outer(size, size), 0.0, values)


@lru_cache(maxsize=32)
@on_one_thread()
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
        path = base.structure.path()
        at_rest = base.structure.frame().nodes[path]
        rows = 6 * np.array(path)[:, None] + np.arange(3)
    return Centreline(at_rest, reduced.static[rows], reduced.shapes[rows])


def bent_line(
    base: FlexibleBase, y: Array, u: Array | None = None, points: int = 7
) -> Array | None:
    """Return the bent centreline of a flexible base.

    Args:
        base: what carries the arm.
        y: (N, 6) poses of its flange [m, rad].
        u: (N, m) internal modes [kg^(1/2) m]; None: they rest on the flange.
        points: of each member of a polyline, both ends included.

    Returns:
        (N, k, 3) points [m], None of a model without a line to draw.
    """
    centreline = base.centreline()
    if centreline is None:
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


def stress(base: FlexibleBase, y: Array, u: Array | None = None) -> Array:
    """Return the largest axial stress along a polyline, tension and bending together.

    What its static shapes and internal modes strain; modes that are left out add nothing.

    Args:
        base: of a polyline.
        y: (N, 6) poses of its flange [m, rad].
        u: (N, m) internal modes [kg^(1/2) m]; None: they rest on the flange.

    Returns:
        (N, members, 2) at start and end of each member [Pa].

    Raises:
        ParameterError: a user's reduced matrices, which know no sections.
    """
    if isinstance(base.structure, Reduced):
        raise ParameterError("stress needs a Polyline, got reduced matrices")
    reduced, frame = base.reduction(), base.structure.frame()
    moved = y @ reduced.static.T
    if u is not None:
        moved = moved + (u - y @ reduced.coupling) @ reduced.shapes.T
    ends = frame.stress(moved)  # (N, elements, 2), member by member
    first = np.arange(len(base.structure.members)) * ELEMENTS
    return np.stack([ends[:, first, 0], ends[:, first + ELEMENTS - 1, 1]], axis=-1)
