"""What small machines have in common: a description and a list of effects that it may have.

A machine that is neither a `System` nor joints on a fixed base: static poses of a sensor, an
arm over a force plate, a linear plant. Its effects are its own, registered by kind so that a
mapping file can hold them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.machines.base import Nuisance, Port
from ves_gym.diagnosis.machines.tolerances import LEAST, with_known

PLANT_EFFECTS: dict[str, type[PlantEffect]] = {}
Effects = tuple["PlantEffect", ...]


class PlantEffect:
    """Base of what a small machine may have besides its description."""

    REGISTRY: ClassVar[dict[str, type[PlantEffect]]] = PLANT_EFFECTS
    kind: ClassVar[str]


def plant_effect(kind: str) -> Callable[[type], type]:
    """Register a frozen dataclass under a kind.

    Raises:
        ParameterError: the kind is registered already.
    """

    def register(cls: type) -> type:
        if kind in PLANT_EFFECTS:
            raise ParameterError(f"effect {kind!r} is registered already")
        cls.kind = kind  # type: ignore[attr-defined]
        PLANT_EFFECTS[kind] = cls
        return cls

    return register


@dataclass(frozen=True)
class Size:
    """A number of a candidate: its name, unit, where a fit begins, how far it may go."""

    name: str
    unit: str
    start: float
    low: float
    high: float


def candidate_of(
    cls: type,
    ports: Sequence[str],
    numbers: Sequence[Size],
    make: Callable[[Array], Any],
    slot: str = "",
    *,
    sparse: bool = False,
    starts: Sequence[Sequence[float]] = (),
    factors: Sequence[int] | None = None,
) -> Candidate:
    """Return a candidate for an effect of a small machine.

    Args:
        cls: effect.
        ports: at which it shows.
        numbers: k that a fit chooses.
        make: numbers (k,) -> the effect.
        slot: place, "" where there is one only.
        sparse: numbers about zero cost nothing.
        starts: (s, k) where fits begin, if not at those of the numbers.
        factors: which numbers multiply what the effect does; default all.
    """
    return Candidate(
        kind=cls.kind,  # type: ignore[attr-defined]
        slot=slot,
        ports=tuple(ports),
        names=tuple(x.name for x in numbers),
        units=tuple(x.unit for x in numbers),
        starts=tuple(map(tuple, starts)) or (tuple(x.start for x in numbers),),
        low=tuple(x.low for x in numbers),
        high=tuple(x.high for x in numbers),
        make=make,
        factors=tuple(range(len(numbers))) if factors is None else tuple(factors),
        sparse=sparse,
    )


class PlantMachine(ABC):
    """A machine whose model is a tuple of effects beside what it is described to be.

    Args:
        name: in messages and results.
        effects: that the description has.
        known: standard deviations of single tolerances, see `with_known`.
        unexplained: share of a channel's movement that no such description explains.
    """

    ports: tuple[Port, ...]
    effects: ClassVar[tuple[type, ...]]  # that it computes

    def __init__(
        self,
        name: str,
        effects: Sequence[Any] = (),
        known: Mapping[str, float] | None = None,
        unexplained: float = 0.0,
    ) -> None:
        self.name, self.nominal = name, tuple(effects)
        self.known, self._unexplained = dict(known or {}), unexplained
        for effect in self.nominal:
            if not isinstance(effect, self.effects):
                kinds = ", ".join(cls.kind for cls in self.effects)  # type: ignore[attr-defined]
                raise ParameterError(f"effect {effect.kind}: {name} computes {kinds}")

    def passing(self, model: Effects) -> Effects:
        """Return the model: no port here differentiates."""
        return model

    def model(self, effects: Sequence[Any]) -> Effects:
        """Return the description with effects added."""
        return (*self.nominal, *effects)

    def unknowns(self, run: Run) -> Sequence[Nuisance]:
        """Return nothing: no drift is described."""
        return ()

    def rings(self, runs: Sequence[Run], frequency: float) -> bool:
        """Return False: there is no loop."""
        return False

    def floor(self, run: Run, port: str) -> Array:
        """Return (c,) standard deviation below which a residual of the port means nothing."""
        signal = run[self._port(port).signal]
        least = LEAST * np.maximum(np.asarray(signal.std(axis=-2)), 1e-12)
        moved = run.window.spectrum(signal)
        size = np.sqrt(np.square(np.abs(moved)).mean(axis=-2))
        return np.asarray(np.maximum(least, self._unexplained * size))

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of any description of such a machine."""
        return with_known(self.tolerances(), self.known)

    @abstractmethod
    def tolerances(self) -> list[Nuisance]:
        """Return the usual errors of such a description."""

    @abstractmethod
    def candidates(self) -> tuple[Candidate, ...]:
        """Return what may be missing."""

    @abstractmethod
    def residual(self, run: Run, port: str, effects: Effects) -> Array:
        """Return (..., T, c) measured less what the machine with these effects gives.

        Args:
            run: measured signals.
            port: name.
            effects: beside the description.
        """

    def residuals(
        self, run: Run, models: Sequence[Effects], ports: Sequence[str]
    ) -> dict[str, Array]:
        """Return (m, ..., T, c) per port, as `Machine.residuals`."""
        return {p: np.stack([self.residual(run, p, m) for m in models]) for p in ports}

    def _port(self, name: str) -> Port:
        return next(p for p in self.ports if p.name == name)


def of_kind(effects: Effects, cls: type) -> list[Any]:
    """Return those effects that are of a class."""
    return [e for e in effects if isinstance(e, cls)]
