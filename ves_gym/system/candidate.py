"""`Candidate`: an effect in one place, with the numbers that a fit may choose.

`derived` makes the candidates of an effect from its parameters alone: their shapes say how
many places it has, bounds and null values where a fit begins. `start`, `search` and `name` of
`parameter`, and `places`, `sets_in`, `within` of the class, say it better where an effect
knows more; an effect whose numbers are not its parameters overrides `Effect.candidates` and
puts them together with `placed`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.spatial import AXES, WRENCH

EffectClass = type[Any]  # of a `ves_gym.system.effect.Effect`, which asks for its candidates
PLACES = ("joint", "axis", "row", "whole")
_XYZ = AXES[:3]
_NAMED = (3, 6)  # counts of coordinates that have names; others have numbers
_USUAL = 0.05  # of the way to the nearer bound: where fits begin if an effect does not say
_GRID = {1: 12, 2: 5}  # starts of each number that gives a shape, by how many there are
_FEW = 3

Fields = Callable[[Array], dict[str, Any]]  # free numbers (k,) -> fields of the effect


@dataclass(frozen=True)
class Candidate:
    """An effect with k free numbers in one place.

    `starts` (s, k) are where fits begin; the first is about what a machine may well have,
    and what the data must be able to show if they are to say that it is not there.
    """

    kind: str
    slot: str  # "joint 2", "F_x", "" where there is only one place
    ports: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    starts: tuple[tuple[float, ...], ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    make: Callable[[Array], Any]  # numbers (k,) -> the effect
    factors: tuple[int, ...]  # which of the numbers multiply what the effect does
    sets_in: bool = False  # nothing is proportional to its number: starts are tried as they are
    quiets: tuple[int, ...] = ()  # numbers that take noise off the larger they are
    blurs: tuple[Callable[[Any], Any], ...] = ()  # effect -> another form that it may have
    within: str = ""  # a simpler kind that is a case of this one
    counts: int | None = None  # numbers it costs, where that is not k
    sparse: bool = False  # coordinates of a thing: those that are about zero cost nothing
    least: int = 1  # of a sparse one: numbers that it counts as at least
    # a cause: kind and slot of the candidate that each of its numbers is when alone
    parts: tuple[tuple[str, str], ...] = ()
    # numbers (k,) and their precision (k, k) -> the most probable that can be; None: all can
    feasible: Callable[[Array, Array], Array] | None = None
    # numbers (k,) -> periods that the runs go through of what repeats; None: nothing repeats
    periods: Callable[[Array], float] | None = None

    @property
    def name(self) -> str:
        """Kind and place, e.g. "joint/coulomb at joint 2"."""
        return f"{self.kind} at {self.slot}" if self.slot else self.kind

    @property
    def k(self) -> int:
        """Number of free numbers."""
        return len(self.names)

    @property
    def price(self) -> int:
        """Least number of parameters it counts as; of a cause one a place."""
        if self.parts:
            return len({slot for _, slot in self.parts})
        return self.least if self.sparse else self.k if self.counts is None else self.counts

    @property
    def places(self) -> frozenset[str]:
        """Slots in which it acts; none where there is only one place."""
        return frozenset({self.slot, *(slot for _, slot in self.parts)} - {""})

    def effect(self, values: Array) -> Any:
        """Return the effect with these numbers (k,), clipped to their ranges."""
        return self.make(np.clip(values, self.low, self.high))


@dataclass(frozen=True)
class Number:
    """A number of an effect that a fit may choose."""

    name: str
    unit: str
    range: tuple[float, float]
    starts: tuple[float, ...]
    factor: bool = True  # it multiplies what the effect does; else it gives a shape
    quiets: bool = False  # the larger, the less of a log's noise the effect passes on


@dataclass(frozen=True)
class Scope:
    """A machine as far as it is known before its data are looked at."""

    joints: int
    system: Any = None  # as described, where it is one
    stretch: float = 0.25  # part of its stroke that a leg of the platform is told to go
    travel: tuple[float, ...] = ()  # rad, that each joint covers in the runs; (): not known


def placed(
    cls: EffectClass, slot: str, numbers: Sequence[Number], fields: Fields, sparse: bool = False
) -> Candidate:
    """Return an effect in one place; the rest is as its class says.

    Args:
        cls: effect.
        slot: place, e.g. "joint 2"; "" where there is only one.
        numbers: k that are free.
        fields: free numbers (k,) -> fields of the effect.
        sparse: see `Candidate`.
    """
    starts = itertools.product(*(map(float, x.starts) for x in numbers))
    return Candidate(
        kind=cls.kind,
        slot=slot,
        ports=cls.shows or (cls.port,),
        names=tuple(x.name for x in numbers),
        units=tuple(x.unit for x in numbers),
        starts=tuple(starts),
        low=tuple(x.range[0] for x in numbers),
        high=tuple(x.range[1] for x in numbers),
        make=lambda x: cls(**fields(x)),
        factors=tuple(k for k, x in enumerate(numbers) if x.factor),
        sets_in=cls.sets_in,
        quiets=tuple(k for k, x in enumerate(numbers) if x.quiets),
        blurs=cls.forms,
        within=cls.within,
        sparse=sparse,
    )


def number_of(cls: EffectClass, field: str, name: str = "", unit: str = "") -> Number:
    """Return a free number for a parameter, or for one entry of it, as it is declared.

    Of a parameter whose null value is not zero it is the difference from that.

    Args:
        cls: effect.
        field: name of the parameter.
        name, unit: other than the parameter's.
    """
    meta = _metadata(cls)[field]
    null = meta["null"] or 0.0
    low, high = (x - null for x in meta.get("search") or meta["bounds"])
    name = name or meta.get("name") or field
    starts = meta.get("start")
    if starts is None:
        shapes = sum(_metadata(cls)[k]["null"] is None for k in _free(cls))
        starts = _starts(low, high, shapes if meta["null"] is None else 0)
    return Number(
        name=f"{name} - {null:g}" if null else name,
        unit=unit or meta["unit"],
        range=(low, high),
        starts=starts if isinstance(starts, tuple) else (starts,),
        factor=meta["null"] is not None,
        quiets=bool(meta.get("quiets")),
    )


def at_joint(joint: int, n: int, value: float, elsewhere: float = 0.0) -> tuple[float, ...]:
    """Return a parameter (n,) that has a value at one joint."""
    return tuple(float(value) if k == joint else float(elsewhere) for k in range(n))


def derived(cls: EffectClass, scope: Scope) -> Iterator[Candidate]:
    """Yield the candidates of an effect as its parameters and its class declare them.

    Args:
        cls: effect.
        scope: the machine.

    Raises:
        ParameterError: shapes that do not fit the effect's places.
    """
    free, metadata = _free(cls), _metadata(cls)
    places = cls.places or _places(tuple(free.values()))
    makers = {"joint": _at_joints, "axis": _along_axes, "row": _by_rows, "whole": _as_a_whole}
    if not free or places not in makers:
        raise ParameterError(
            f"effect {cls.kind}: places must be one of {', '.join(PLACES)} and some parameter"
            f" free, got {places!r} and {', '.join(free) or 'none'}"
        )
    joints = scope.joints if places == "joint" else 0
    for slot, entries in makers[places](cls, free, scope):
        rest = {}  # of the parameters, in other places
        for name in free if places != "axis" else [name for name, _, _ in entries]:
            fill = metadata[name]["null"]
            if fill is None:
                fill = number_of(cls, name).starts[0] if joints else 0.0
            rest[name] = np.full([joints if k is None else k for k in free[name]], fill)

        def fields(
            x: Array, entries: Entries = entries, rest: dict[str, Array] = rest
        ) -> dict[str, Any]:
            out = {name: values.copy() for name, values in rest.items()}
            for (name, index, _), value in zip(entries, x, strict=True):
                out[name][index] = value + (metadata[name]["null"] or 0.0)
            return out

        # coordinates of one thing that are about zero cost nothing
        single = places == "whole" and len(free) == 1 and () not in free.values()
        numbers = [number for _, _, number in entries]
        yield placed(cls, slot, numbers, fields, sparse=single or places == "row")


Shapes = dict[str, tuple[int | None, ...]]  # of the free parameters
Entries = list[tuple[str, tuple[int, ...], Number]]  # parameter, place in it, its number
Slots = Iterator[tuple[str, Entries]]


def _metadata(cls: EffectClass) -> dict[str, Any]:
    """Name -> what `parameter` says of it."""
    return {f.name: f.metadata for f in dataclasses.fields(cls)}


def _free(cls: EffectClass) -> Shapes:
    """Shapes of parameters that a fit chooses: what has a null value, a start or no default."""
    return {
        f.name: f.metadata["shape"]
        for f in dataclasses.fields(cls)
        if f.metadata["null"] is not None
        or f.metadata.get("start") is not None
        or f.default is dataclasses.MISSING
    }


def _starts(low: float, high: float, shapes: int) -> tuple[float, ...]:
    """Return where fits begin: a twentieth of the way to the nearer bound, for shapes a grid.

    Args:
        low, high: range, less the null value.
        shapes: numbers of the effect that give a shape; 0 for one that is a size.
    """
    if not shapes:
        return (_USUAL * min((x for x in (high, low) if x), key=abs),)
    grid = np.geomspace if low > 0 else np.linspace
    return tuple(grid(low, high, _GRID.get(shapes, _FEW) + 2)[1:-1].tolist())


def _places(shapes: Sequence[tuple[int | None, ...]]) -> str:
    if any(None in shape for shape in shapes):
        return "joint"
    if (6, 6) in shapes:
        return "row"
    return "axis" if (6,) in shapes else "whole"


def _axes(cls: EffectClass, size: int) -> tuple[str, ...]:
    """Names of coordinates: of the sensor's signals, of a pose, or by number."""
    six = WRENCH if cls.port in ("wrench", "gravity") else AXES
    named = dict(zip(_NAMED, (_XYZ, six), strict=True))
    return named.get(size, tuple(str(k + 1) for k in range(size)))


def _at_joints(cls: EffectClass, free: Shapes, scope: Scope) -> Slots:
    """One candidate per joint: entries of (n,), and numbers that all joints share."""
    if not {(None,)} <= set(free.values()) <= {(), (None,)}:
        raise ParameterError(
            f"effect {cls.kind}: parameters of places `joint` must be one number or one per"
            f" joint, got shapes {', '.join(map(str, free.values()))}"
        )
    numbers = {name: number_of(cls, name) for name in free}
    for joint in range(scope.joints):
        places = {name: (joint,) if shape else () for name, shape in free.items()}
        yield f"joint {joint + 1}", [(k, places[k], numbers[k]) for k in free]


def _along_axes(cls: EffectClass, free: Shapes, scope: Scope) -> Slots:
    """One candidate per axis, one number each: of (k,), or of a force and a moment (3,)."""
    sizes = [shape[0] or 0 for shape in free.values() if len(shape) == 1]
    single, both = len(free) == 1 and len(sizes) == 1, len(free) == 2 and sizes == [3, 3]
    if not (single or both):
        raise ParameterError(
            f"effect {cls.kind}: parameters of places `axis` must be one of k numbers or two"
            f" of 3, got shapes {', '.join(map(str, free.values()))}"
        )
    slots = iter(_axes(cls, sum(sizes)))
    for name, size in zip(free, sizes, strict=True):
        units = number_of(cls, name).unit.split(", ")  # of translations, of rotations
        for k in range(size):
            unit = units[-1] if 2 * k >= size else units[0]
            yield next(slots), [(name, (k,), number_of(cls, name, unit=unit))]


def _by_rows(cls: EffectClass, free: Shapes, scope: Scope) -> Slots:
    """One candidate per row of a matrix."""
    ((name, shape),) = free.items()
    rows, columns = (k or 0 for k in shape)
    numbers = [number_of(cls, name, column) for column in _axes(cls, columns)]
    for i, slot in enumerate(_axes(cls, rows)):
        yield slot, [(name, (i, k), number) for k, number in enumerate(numbers)]


def _as_a_whole(cls: EffectClass, free: Shapes, scope: Scope) -> Slots:
    """One candidate for all."""
    entries: Entries = []
    for name, shape in free.items():
        places = list(np.ndindex(*(k or 0 for k in shape)))
        axes = _axes(cls, len(places)) if shape else ("",)
        join = "_" if len(places) in _NAMED else ""
        beside = f"{name}{join}" if len(free) > 1 else ""
        for place, axis in zip(places, axes, strict=True):
            entries.append((name, place, number_of(cls, name, f"{beside}{axis}" * bool(axis))))
    yield "", entries
