"""Randomisation as data: distributions of the effects' parameters, drawn for every episode."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ves_gym._util.params import Array, ParameterError, from_plain, require_one_of
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.spatial import matvec
from ves_gym.system.deviations import LoopParameters
from ves_gym.system.effect import EFFECTS, Effect
from ves_gym.system.effect_rows import EffectRows
from ves_gym.system.system import System

_TRIES = 5  # simulations with which effects are tried at once: more than any vector of three
_FAR = 5.0  # standard deviations: one number in two million is further from the mean
_ENDS = 2.0  # standard deviations from the mean that count as the ends of a normal
LAWS = ("uniform", "normal", "log_uniform")


@dataclass(frozen=True, kw_only=True)
class Range:
    """Distribution of one parameter of one effect; numbers or nested lists of its shape.

    Uniform between `low` and `high`; or `log_uniform` [low, high], both > 0; or `normal`
    [mean, spread] where `spread` is the standard deviation of each number, which is cut off
    at the parameter's bounds, or the covariance of a vector. With `shared` the spread is a
    matrix (size, m) that weighs m standard normal numbers, the same ones in every parameter
    that names the same source: so errors that stem from one calibration belong together.
    """

    effect: str
    parameter: str
    low: object = None
    high: object = None
    log_uniform: object = None
    normal: object = None
    shared: str | None = None

    def __post_init__(self) -> None:
        require_one_of("randomize: effect", self.effect, sorted(EFFECTS))
        names = [f.name for f in dataclasses.fields(EFFECTS[self.effect])]  # type: ignore[arg-type]
        if self.parameter not in names:
            raise ParameterError(
                f"randomize: {self.effect} has parameters {', '.join(names)}, got"
                f" {self.parameter!r}{did_you_mean(self.parameter, names)}"
            )
        (first, second), law = self._pair, self.law
        alike = first.shape == second.shape
        if law == "normal":
            size = first.size
            wide = second.ndim == 2 and len(second) == size
            if self.shared is not None:
                self._require(wide, "a matrix that has a row for each number", second.tolist())
            elif alike:
                self._require((second >= 0).all(), "standard deviations >= 0", second.tolist())
                low, high = self._bounds
                inside = ((first >= low) & (first <= high)).all()
                self._require(inside, f"a mean in [{low:g}, {high:g}]", first.tolist())
            else:
                square = wide and second.shape == (size, size) and (second == second.T).all()
                square = square and np.linalg.eigvalsh(second)[0] >= -1e-12 * second.max()
                what = "standard deviations of the mean's shape, or a covariance (symmetric,"
                self._require(square, f"{what} not negative)", second.tolist())
            self._require_inside()
            return
        self._require(self.shared is None, "no `shared`: only a normal has one", self.shared)
        what = "numbers low <= high of one shape"
        pair = f"{self._stated[0]} and {self._stated[1]}"
        if law == "log_uniform":
            what = f"log_uniform: 0 < {what[8:]}"
        fits = alike and (first <= second).all() and (law == "uniform" or (first > 0).all())
        self._require(fits, what, pair)

    @property
    def law(self) -> str:
        """One of LAWS."""
        return next((law for law in LAWS[1:] if getattr(self, law) is not None), LAWS[0])

    @property
    def _stated(self) -> tuple[Any, Any]:
        pair: Any = (self.low, self.high) if self.law == "uniform" else getattr(self, self.law)
        try:
            first, second = pair
        except (TypeError, ValueError):
            raise ParameterError(
                f"randomize: {self.label} must have two entries for {self.law}, got {pair!r}"
            ) from None
        return first, second

    @cached_property
    def _pair(self) -> tuple[Array, Array]:
        """Both numbers of the law; NaN, which no test lets pass, for what is no number."""
        pair = self._stated
        try:
            first, second = (np.asarray(x, float) for x in pair)
        except (TypeError, ValueError):
            return np.full(1, np.nan), np.full(1, np.nan)
        if np.isfinite(first).all() and np.isfinite(second).all():
            return first, second
        return np.full(1, np.nan), np.full(1, np.nan)

    def _require(self, fits: object, what: str, got: object) -> None:
        if not fits:
            raise ParameterError(f"randomize: {self.label} needs {what}, got {got}")

    @property
    def _bounds(self) -> tuple[float, float]:
        fields = {f.name: f for f in dataclasses.fields(EFFECTS[self.effect])}  # type: ignore[arg-type]
        low, high = fields[self.parameter].metadata["bounds"]
        return float(low), float(high)

    def _require_inside(self) -> None:
        """Bounds may cut off no more of a normal whose numbers belong together than this."""
        (mean, spread), (low, high) = self._pair, self._bounds
        if self.shared is None and mean.shape == spread.shape:
            return
        reach = _FAR * self._deviation
        self._require(
            ((mean - reach >= low) & (mean + reach <= high)).all(),
            f"{_FAR:g} standard deviations within [{low:g}, {high:g}]",
            f"deviations up to {self._deviation.max():.3g}",
        )

    @property
    def _deviation(self) -> Array:
        """Standard deviation of a normal, in the mean's shape."""
        mean, spread = self._pair
        if self.shared is not None:
            return np.sqrt(np.sum(spread**2, axis=1)).reshape(mean.shape)
        if mean.shape == spread.shape:
            return spread
        return np.sqrt(np.diag(spread)).reshape(mean.shape)

    @cached_property
    def _weights(self) -> Array:
        """(size, draws) of standard normal numbers."""
        _, spread = self._pair
        if self.shared is not None:
            return spread
        parts, axes = np.linalg.eigh(spread)  # a covariance may have no inverse
        root = (axes * np.sqrt(np.clip(parts, 0.0, None))) @ axes.T  # unique: axes have no sign
        return np.asarray(root, dtype=np.float64)

    @property
    def label(self) -> str:
        """place/name.parameter."""
        return f"{self.effect}.{self.parameter}"

    @property
    def size(self) -> int:
        """Numbers of the parameter."""
        return self._pair[0].size

    @property
    def draws(self) -> int:
        """Uniform numbers that `values` takes."""
        return self._pair[1].shape[1] if self.shared is not None else self.size

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lowest and highest value; of a normal two standard deviations from its mean."""
        if self.law != "normal":
            return self._pair
        mean, reach = self._pair[0], _ENDS * self._deviation
        low, high = self._bounds
        return np.maximum(mean - reach, low), np.minimum(mean + reach, high)

    @cached_property
    def _varies(self) -> npt.NDArray[np.bool_]:
        """(size,) numbers that differ from draw to draw."""
        low, high = self.ends
        return np.asarray(low != high).ravel()

    @property
    def entries(self) -> int:
        """Numbers that differ from draw to draw."""
        return int(self._varies.sum())

    def context(self, values: Array) -> Array:
        """(k, entries) of values (k, size): -1 at the low end, 1 at the high one."""
        low, high = (end.ravel()[self._varies] for end in self.ends)
        return np.asarray((values[:, self._varies] - (low + high) / 2) / ((high - low) / 2))

    def check(self, system: System) -> None:
        """Raise ParameterError where the effect does not act in a system."""
        EFFECTS[self.effect].require_mode(system.mode)

    def __str__(self) -> str:
        first, second = (_brief(x) for x in self._pair)
        if self.law == "normal":
            spread = f"+- {_brief(self._deviation)}"
            others = f", together with others of {self.shared}" if self.shared else ""
            return f"{self.label} normal, {first} {spread}{others}"
        law = "" if self.law == "uniform" else f"{self.law} "
        return f"{self.label} {law}in [{first}, {second}]"

    def values(self, u: Array) -> Array:
        """The parameter (k, ...) from uniform numbers (k, draws)."""
        first, second = self._pair
        if self.law == "uniform":
            share = u.reshape(len(u), *first.shape)
            return np.asarray(first + (second - first) * share, dtype=np.float64)
        if self.law == "log_uniform":
            exponent = np.log(first) + np.log(second / first) * u.reshape(len(u), *first.shape)
            # one by one: a vector loop might round by the place in the batch
            flat = np.array([math.exp(x) for x in exponent.ravel().tolist()])
            return np.clip(flat.reshape(exponent.shape), first, second)
        from scipy.special import ndtr, ndtri

        if self.shared is None and first.shape == second.shape:
            low, high = self._bounds
            divisor = np.where(second > 0, second, 1.0)
            least, most = ndtr((low - first) / divisor), ndtr((high - first) / divisor)
            share = least + (most - least) * u.reshape(len(u), *first.shape)
            return np.clip(first + second * _normal(ndtri, share), low, high)
        out: Array = first.ravel() + matvec(self._weights, _normal(ndtri, u))
        return np.clip(out, *self._bounds).reshape(len(u), *first.shape)


def _brief(numbers: Array) -> str:
    """Numbers in a line: one where they are alike, the extremes of a matrix."""
    flat = np.unique(numbers)
    if len(flat) == 1:
        return f"{flat[0]:g}"
    if numbers.ndim > 1 or numbers.size > 6:
        return f"{flat[0]:.2g} to {flat[-1]:.2g}"
    return f"({', '.join(f'{x:.3g}' for x in numbers)})"


def _normal(ndtri: Any, u: Array) -> Array:
    """Standard normal numbers from uniform ones; of none smaller than their own spacing."""
    return ndtri(np.maximum(u, 2.0**-54))


def ranges_of(spec: Mapping[str, Mapping[str, Any]]) -> tuple[Range, ...]:
    """Distributions from what a user writes: {effect: {parameter: law}}.

    A law is (low, high), {"uniform": (low, high)}, {"log_uniform": (low, high)} or
    {"normal": (mean, spread)}, the latter with "shared": a name (`Range`).
    """
    if not isinstance(spec, Mapping):
        raise ParameterError(
            f"randomize must map effects to their parameters, got {str(spec)[:80]!r}"
        )
    out = []
    for effect, parameters in spec.items():
        if not isinstance(parameters, Mapping):
            raise ParameterError(
                f"randomize[{effect!r}] must map parameters to (low, high), got {parameters!r}"
            )
        for name, law in parameters.items():
            out.append(_range(effect, name, law))
    return tuple(out)


def _range(effect: str, name: str, law: Any) -> Range:
    where = f"randomize[{effect!r}][{name!r}]"
    if isinstance(law, Mapping):
        entries = dict(law)
        shared = entries.pop("shared", None)
        kind = next(iter(entries), "")
        if len(entries) != 1 or kind not in LAWS:
            raise ParameterError(
                f"{where} must name one law of {', '.join(LAWS)}, got"
                f" {', '.join(map(str, entries)) or 'none'}{did_you_mean(kind, LAWS)}"
            )
        if shared is not None and not isinstance(shared, str):
            raise ParameterError(f"{where}: shared must be a name, got {shared!r}")
        if kind != "uniform":
            pair: dict[str, Any] = {kind: entries[kind]}
            return Range(effect=effect, parameter=name, shared=shared, **pair)
        law = entries[kind]
    try:
        low, high = law
    except (TypeError, ValueError):
        raise ParameterError(f"{where} must be (low, high), got {law!r}") from None
    return Range(effect=effect, parameter=name, low=low, high=high)


def _places(ranges: tuple[Range, ...]) -> tuple[list[slice], int]:
    """Uniform numbers that each range takes, in order; those of one source only once."""
    out: list[slice] = []
    end, sources = 0, dict[str | None, slice]()
    for spread in ranges:
        if spread.shared in sources:
            place = sources[spread.shared]
            if place.stop - place.start != spread.draws:
                raise ParameterError(
                    f"randomize: {spread.label} needs a matrix with {place.stop - place.start}"
                    f" columns, as the others that share {spread.shared!r}, got {spread.draws}"
                )
        else:
            place = slice(end, end := end + spread.draws)
            if spread.shared is not None:
                sources[spread.shared] = place
        out.append(place)
    return out, end


def _effects(values: Mapping[tuple[str, str], Array]) -> tuple[Effect, ...]:
    """Effects with the given values (...), checked."""
    effects = []
    for kind in dict.fromkeys(kind for kind, _ in values):
        plain = {name: v.tolist() for (k, name), v in values.items() if k == kind}
        effects.append(from_plain(EFFECTS[kind], plain, f"randomize.{kind}"))
    return tuple(effects)


def effect_at(ranges: tuple[Range, ...], end: int) -> Effect:
    """The effect whose parameters these are, all at their low (0) or high (1) end."""
    return _effects({(r.effect, r.parameter): r.ends[end] for r in ranges})[0]


class Draws:
    """Randomised effects of a system: rows of values from rows of uniform numbers.

    Args:
        system: before the randomised effects.
        ranges: what is drawn.
    """

    def __init__(self, system: System, ranges: tuple[Range, ...]) -> None:
        self.ranges, self.system = ranges, template(system, ranges)
        self._where, self.size = _places(ranges)
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
        values = {
            (self._place[r.effect], r.parameter): r.values(u[:, where])
            for r, where in zip(self.ranges, self._where, strict=True)
        }
        return EffectRows(self.system, values, self._at_once)


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
    ends = {(r.effect, r.parameter): r.ends for r in ranges}
    _effects({name: low for name, (low, _) in ends.items()})  # refused where out of bounds
    # not a zero where any other value is possible: what is zero there stays zero (`assign`)
    other = {name: np.where(high != 0, high, low) for name, (low, high) in ends.items()}
    return system.replace(effects=(*system.effects, *_effects(other)))
