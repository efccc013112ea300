"""Randomisation as data: ranges of the effects' parameters, drawn anew for every episode."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array, ParameterError, from_plain
from ves_gym._util.suggest import did_you_mean
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import EFFECTS, Effect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System

_TRIES = 5  # simulations with which effects are tried at once: more than any vector of three


@dataclass(frozen=True, kw_only=True)
class Range:
    """One parameter of one effect, uniform between `low` and `high` (number or nested list)."""

    effect: str
    parameter: str
    low: object
    high: object

    def __post_init__(self) -> None:
        if self.effect not in EFFECTS:
            raise ParameterError(
                f"randomize: effect must be one of {', '.join(sorted(EFFECTS))}, got"
                f" {self.effect!r}{did_you_mean(self.effect, EFFECTS)}"
            )
        names = [f.name for f in dataclasses.fields(EFFECTS[self.effect])]  # type: ignore[arg-type]
        if self.parameter not in names:
            raise ParameterError(
                f"randomize: {self.effect} has parameters {', '.join(names)}, got"
                f" {self.parameter!r}{did_you_mean(self.parameter, names)}"
            )
        try:
            low, high = np.asarray(self.low, float), np.asarray(self.high, float)
        except (TypeError, ValueError):
            low, high = np.full(1, np.nan), np.full(1, np.nan)
        if low.shape != high.shape or not (low <= high).all():
            raise ParameterError(
                f"randomize: {self.effect}.{self.parameter} needs numbers low <= high of one"
                f" shape, got {self.low} and {self.high}"
            )

    @property
    def label(self) -> str:
        """place/name.parameter."""
        return f"{self.effect}.{self.parameter}"

    @property
    def size(self) -> int:
        """Numbers drawn per episode."""
        return np.asarray(self.low, float).size

    def check(self, system: System) -> None:
        """Raise ParameterError where the effect does not act in a system."""
        modes = EFFECTS[self.effect].modes
        if system.mode not in modes:
            raise ParameterError(
                f"randomize: effect {self.effect} acts in mode {', '.join(modes)}, got"
                f" {system.mode}"
            )

    def values(self, u: Array) -> Array:
        """The parameter (k, ...) from uniform numbers (k, size)."""
        low, high = np.asarray(self.low, float), np.asarray(self.high, float)
        share = u.reshape(len(u), *low.shape)
        return np.asarray(low + (high - low) * share, dtype=np.float64)


def draw(ranges: tuple[Range, ...], u: Array) -> dict[tuple[str, str], Array]:
    """Values (k, ...) by effect and parameter, of uniform numbers (k, sum of sizes)."""
    values, at = {}, 0
    for spread in ranges:
        values[spread.effect, spread.parameter] = spread.values(u[:, at : at + spread.size])
        at += spread.size
    return values


def _effects(ranges: tuple[Range, ...], u: Array) -> tuple[Effect, ...]:
    """One draw's effects, of uniform numbers (sum of sizes,); checked."""
    values, effects = draw(ranges, u[None]), []
    for kind in dict.fromkeys(r.effect for r in ranges):
        plain = {name: v[0].tolist() for (k, name), v in values.items() if k == kind}
        effects.append(from_plain(EFFECTS[kind], plain, f"randomize.{kind}"))
    return tuple(effects)


class Draws:
    """Randomised effects of a system: rows of values from rows of uniform numbers.

    Args:
        system: before the randomised effects.
        ranges: what is drawn.
    """

    def __init__(self, system: System, ranges: tuple[Range, ...]) -> None:
        self.ranges, self.system = ranges, template(system, ranges)
        self.size = sum(r.size for r in ranges)
        self._place = {e.kind: i for i, e in enumerate(self.system.effects)}
        self._at_once = False
        if ranges:
            start = None
            if self.system.mode == "emulated":
                settings = self.system.emulator_settings
                start = LoopParameters.nominal(self.system.arm, settings, 1)
            tries = np.random.default_rng(0).random((_TRIES, self.size))
            self._at_once = self.rows(tries).together(start)

    def rows(self, u: Array) -> EffectRows:
        """Effects of k simulations from uniform numbers (k, size)."""
        values = draw(self.ranges, u)
        by_place = {(self._place[kind], name): v for (kind, name), v in values.items()}
        return EffectRows(self.system, by_place, self._at_once)


def template(system: System, ranges: tuple[Range, ...]) -> System:
    """The system with every randomised effect at an end of its range."""
    if not ranges:
        return system
    kinds = {r.effect for r in ranges}
    clash = [e.kind for e in system.effects if e.kind in kinds]
    if clash:
        raise ParameterError(
            f"randomize: effect {clash[0]} is already in the system; randomise it or set it"
        )
    _effects(ranges, np.zeros(sum(r.size for r in ranges)))  # refuses a lower end out of bounds
    # not a zero where any other value is possible: what is zero there stays zero (`assign`)
    ends = np.concatenate([np.asarray(r.high, float).ravel() != 0 for r in ranges])
    return system.replace(effects=(*system.effects, *_effects(ranges, ends.astype(float))))
