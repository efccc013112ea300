"""Tolerances of a description, and facts that are better or worse than the usual ones."""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from ves_gym._util.params import ParameterError, require_positive, unit
from ves_gym._util.suggest import did_you_mean
from ves_gym.diagnosis.data.measured_run import MEASURED
from ves_gym.diagnosis.machines.base import Nuisance
from ves_gym.diagnosis.machines.clocks import ClockTolerance

SCHEMA = "ves-tolerances/1"
LEAST = 1e-3  # of a channel's own movement: no description is better


@dataclass(frozen=True)
class Tolerance:
    """Usual errors of a careful description of joints, standard deviations."""

    inertia: float = unit("1", default=0.006)
    centre: float = unit("m", default=0.0)  # of mass of every body; 0: as good as inertia
    gain: float = unit("1", default=0.0006)  # of motor forces and of measured rates
    friction: float = unit("N m", default=0.03)  # at the pinion; per rad/s for viscous
    unexplained: float = unit("1", default=0.0)  # of a channel's movement: no law is better

    def __post_init__(self) -> None:
        require_positive(self, "inertia", "gain", "friction")
        for name in ("centre", "unexplained"):
            if not getattr(self, name) >= 0:
                raise ParameterError(
                    f"tolerance {name} must be >= 0, got {getattr(self, name)}"
                )


@dataclass(frozen=True)
class StatedErrors:
    """Errors of a `System`'s description and measurement, where not the usual ones."""

    schema: str = SCHEMA
    scale: float = 1.0  # of all tolerances
    known: dict[str, float] = field(default_factory=dict)  # tolerance -> standard deviation
    noise: dict[str, float] = field(default_factory=dict)  # signal of the log -> the same
    clocks: ClockTolerance = field(default_factory=ClockTolerance)

    def __post_init__(self) -> None:
        if self.schema != SCHEMA:
            raise ParameterError(f"schema must be {SCHEMA!r}, got {self.schema!r}")
        require_positive(self, "scale")
        for name, std in self.noise.items():
            if name not in MEASURED or not std > 0:
                raise ParameterError(
                    f"noise: expected one of {', '.join(MEASURED)} and a number > 0, got"
                    f" {name} = {std}"
                )


def with_known(
    nuisances: Iterable[Nuisance], known: Mapping[str, float], scale: float = 1.0
) -> tuple[Nuisance, ...]:
    """Return tolerances with the sizes that are stated for some of them.

    Args:
        nuisances: usual ones.
        known: name, or a pattern such as "mass of link *", -> standard deviation in the
            nuisance's unit; 0 if it is exact.
        scale: factor of all the others.

    Raises:
        ParameterError: a name that no tolerance has, or a negative size.
    """
    every = list(nuisances)
    names = [k.name for k in every]
    sizes: dict[str, float] = {}
    for pattern, std in known.items():
        matches = [name for name in names if fnmatch.fnmatchcase(name, pattern)]
        if not matches:
            raise ParameterError(
                f"known: no tolerance {pattern!r}; there are {', '.join(dict.fromkeys(names))}"
                f"{did_you_mean(pattern, names)}"
            )
        if not std >= 0:
            raise ParameterError(f"known: {pattern!r} must be >= 0, got {std}")
        sizes |= dict.fromkeys(matches, std)
    out = (
        dataclasses.replace(k, std=sizes[k.name] if k.name in sizes else scale * k.std)
        for k in every
    )
    return tuple(k for k in out if k.std > 0)
