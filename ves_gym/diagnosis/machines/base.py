"""A machine as parts that can each be run alone on measured input.

A *port* is a place where the log holds both what goes into a part and what comes out of it.
Its residual is what was measured there less what the part as described would have done with
the measured input, so that what one part does wrong shows at its own port, not at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ves_gym._util.params import Array
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.mechanics.spatial import WRENCH as WRENCH
from ves_gym.system.effect import Effect


@dataclass(frozen=True)
class Port:
    """A part of the machine between measured signals."""

    name: str
    title: str  # what its residual is, for people
    channels: tuple[str, ...]
    units: tuple[str, ...]
    needs: tuple[str, ...]  # signals of the log
    exact: tuple[str, ...] = ()  # those of them that are what the part was given, noise and all
    differentiates: bool = (
        False  # described numbers multiply noisy signals: errors in variables
    )
    answers: bool = False  # its noisy signals answer to the others, and are not their cause
    signal: str = ""  # that its residual is a part of


@dataclass(frozen=True)
class Nuisance:
    """A small error that any description has; it is allowed for, not named."""

    name: str
    ports: tuple[str, ...]
    model: Any  # the description with it, `step` large
    step: float
    std: float  # its usual size, in the unit of `step`
    scales: bool = True  # with the common scale of a description's errors


class Machine(Protocol):
    """Anything with ports. A model is its description with some effects, as it likes it."""

    name: str
    ports: tuple[Port, ...]
    nominal: Any

    @property
    def nuisances(self) -> Sequence[Nuisance]:
        """Tolerances."""

    def unknowns(self, run: Run) -> Sequence[Nuisance]:
        """Return what a description says may be, but not how it was in a run: stated drift."""
        return ()

    def model(self, effects: Sequence[Effect]) -> Any:
        """The description with effects."""

    def passing(self, model: Any) -> Any:
        """Return what of a model passes noise on at ports that differentiate.

        Friction turns with the noise of a joint at rest, where more noise on noisy angles is
        not what noise did, and of angles and rates there is less than of accelerations.
        """
        return model

    def residuals(
        self, run: Run, models: Sequence[Any], ports: Sequence[str]
    ) -> dict[str, Array]:
        """Return (m, ..., T, c) per port: the residual under each of m models."""

    def rings(self, runs: Sequence[Run], frequency: float) -> bool:
        """Return True if the machine as described rings at a frequency [Hz] by itself."""
        return False

    def floor(self, run: Run, port: str) -> Array:
        """Return (c,) standard deviation below which a residual of the port means nothing."""


def untestable(machine: Machine, runs: Sequence[Run]) -> dict[str, tuple[str, ...]]:
    """Return signals that some run lacks, by port."""
    out = {}
    for port in machine.ports:
        lacks = tuple(k for k in port.needs if not all(k in run for run in runs))
        if lacks:
            out[port.name] = lacks
    return out


def testable(machine: Machine, runs: Sequence[Run]) -> tuple[Port, ...]:
    """Return ports whose signals all runs hold."""
    lacking = untestable(machine, runs)
    return tuple(p for p in machine.ports if p.name not in lacking)
