"""A machine of one's own: a residual function, its parameters, its channels.

The function is pure, residual(p, run) -> {port: (T, c)}: what was measured less what the
machine with these parameters would have given on the measured input. Every parameter says by
how much a description is usually off and by how much it may be; what may be off is a candidate.
A parameter that does nothing at its nominal value is an optional law: a delay of 0 s, the gain
of a mode that nobody described.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ves_gym._util.own import require_free
from ves_gym._util.params import Array, ParameterError, finite, require_one_of
from ves_gym._util.signals import SensorNoiseModel, SpectralWindow
from ves_gym.diagnosis.data.measured_run import Run, cached
from ves_gym.diagnosis.machines.base import Machine, Nuisance, Port
from ves_gym.diagnosis.machines.tolerances import LEAST, with_known
from ves_gym.system.candidate import Candidate

Values = Mapping[str, Any]  # float, or (k,) where a parameter has several numbers
Residual = Callable[[Values, Run], Mapping[str, Array]]
T = TypeVar("T", bound=type)
_FEWEST = 8  # samples without a clock
_STEP = 0.1  # s: stands for the clock that there is not
_SHARE = 0.1  # of the usual error: step of differences of a tolerance


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number of a description, or several alike."""

    unit: str | tuple[str, ...]  # of all numbers, or of each
    usual: Any  # error that it may well have; of one number, each, or of a run (`per_run`)
    nominal: float | tuple[float, ...] | None = 0.0  # None: shape of a law that is not there
    tolerance: float | tuple[float, ...] = 0.0  # of the description, standard deviation
    low: float = -1e9
    high: float = 1e9
    entries: tuple[str, ...] = ()  # names of several numbers
    cause: str = ""  # parameters of one cause are off together; default the parameter's name
    each: bool = False  # several numbers, each of which may be off by itself
    starts: tuple[float, ...] = ()  # of a shape: where fits begin
    per_run: bool = False  # every run has its own, which nobody knows
    ports: tuple[str, ...] = ()  # at which it shows; (): all

    def __post_init__(self) -> None:
        size = 0 if self.nominal is None or not self.entries else np.size(self.nominal)
        if size != len(self.entries):
            raise ParameterError(f"{len(self.entries)} entries need as many nominal values")
        if self.nominal is None and not self.starts:
            raise ParameterError("a shape (nominal None) needs starts")


@dataclass(frozen=True)
class Changed:
    """Numbers of a machine that are other than nominal: (parameter, entry, by how much).

    Of a shape it is the number itself.
    """

    kind: str
    values: tuple[tuple[str, int, float], ...]
    run: str = ""  # in which alone


@dataclass(frozen=True)
class _Number:
    """One entry of a parameter."""

    key: str
    entry: int
    name: str
    unit: str
    of: Parameter
    usual: float
    std: float

    @property
    def value(self) -> float:
        """Nominal value; of a shape 0, as its changes are the number itself."""
        return float(np.ravel(0.0 if self.of.nominal is None else self.of.nominal)[self.entry])


@dataclass(eq=False)
class ResidualMachine(Machine):
    """A machine by its residual function.

    Raises:
        ParameterError: a tolerance of nothing.
    """

    name: str
    residual: Residual  # parameters by name, a run whose signals are (T, c) -> (T, c) by port
    ports: tuple[Port, ...]  # each with the signal of the run that its channels are of
    parameters: Mapping[str, Parameter]
    tolerance: Mapping[str, float] = field(
        default_factory=dict
    )  # "gain F_x", "gain *"; 0: exact
    unexplained: float = 0.0  # share of a channel's movement that no description explains
    nominal: Any = field(default=(), init=False)  # no changes

    def __post_init__(self) -> None:
        _ = self.nuisances  # a tolerance of nothing is refused here

    @cached_property
    def _numbers(self) -> list[_Number]:
        return [k for key, p in self.parameters.items() for k in _numbers(key, p)]

    def at(self, values: Values) -> ResidualMachine:
        """Return the machine with other nominal values; a law with values is there.

        Raises:
            ParameterError: unknown parameters, other counts of numbers.
        """
        parameters = dict(self.parameters)
        for key, value in values.items():
            require_one_of("parameter", key, parameters)
            p = parameters[key]
            stated = finite(value, (len(p.entries),) if p.entries else (), key)
            nominal = tuple(stated.tolist()) if p.entries else float(stated)
            parameters[key] = replace(p, nominal=nominal)
        return replace(self, parameters=parameters)

    def values(self, model: Sequence[Changed], run: str = "") -> dict[str, Any]:
        """Return the parameters under changes.

        Args:
            model: changes.
            run: whose own parameters they are.
        """
        out: dict[str, Any] = {}
        for key, p in self.parameters.items():
            start = p.starts[0] if p.nominal is None else p.nominal
            out[key] = np.array(start, float) if p.entries else start
        for change in (c for c in model if c.run in ("", run)):
            for key, entry, number in change.values:
                p = self.parameters[key]
                if p.entries:
                    out[key][entry] += number
                else:
                    out[key] = number + (0.0 if p.nominal is None else out[key])
        return out

    def better(self, effects: Sequence[Changed]) -> dict[str, Any]:
        """Return the parameters that effects change, as plain numbers and lists."""
        values = self.values(self.model(effects))
        changed = dict.fromkeys(key for e in effects for key, _, _ in e.values)
        return {key: np.asarray(values[key], float).tolist() for key in changed}

    # ------------------------------------------------------------- `Machine`

    def model(self, effects: Sequence[Any]) -> tuple[Changed, ...]:
        """Return the description with changes."""
        return tuple(effects)

    @cached_property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Small errors of all parameters that are not of single runs."""
        shared = [k for k in self._numbers if not k.of.per_run and k.of.nominal is not None]
        usual = (self._nuisance(k, _SHARE * k.usual, k.std) for k in shared)
        return with_known(usual, self.tolerance)

    def unknowns(self, run: Run) -> Sequence[Nuisance]:
        """Return the parameters that the run has of its own."""
        out = []
        for k in (k for k in self._numbers if k.of.per_run):
            usual = k.of.usual(run) if callable(k.of.usual) else k.of.usual
            size = float(np.broadcast_to(usual, max(len(k.of.entries), 1))[k.entry])
            out.append(self._nuisance(k, size, size, run.name))
        return out

    def candidates(self) -> tuple[Candidate, ...]:
        """Return what may be off: causes by name, in the order of their parameters."""
        causes: dict[tuple[str, str], list[_Number]] = {}
        for k in (k for k in self._numbers if not k.of.per_run):
            slot = k.of.entries[k.entry] if k.of.each else ""
            causes.setdefault((k.of.cause or k.key, slot), []).append(k)
        return tuple(self._candidate(*place, numbers) for place, numbers in causes.items())

    def floor(self, run: Run, port: str) -> Array:
        """Return (c,) standard deviation below which a residual of the port means nothing."""
        signal = run[next(p.signal for p in self.ports if p.name == port)]
        least = LEAST * np.maximum(np.asarray(signal.std(axis=-2)), 1e-12)
        power = np.square(np.abs(run.window.spectrum(signal))).mean(axis=-2)
        return np.asarray(np.maximum(least, self.unexplained * np.sqrt(power)))

    def residuals(
        self, run: Run, models: Sequence[Any], ports: Sequence[str]
    ) -> dict[str, Array]:
        """Return (m, ..., T, c) per port, as `Machine.residuals`.

        Raises:
            ParameterError: noise that nobody stated; a residual of another shape.
        """
        every = [
            cached(run.memory, self, m, lambda m=m: self._residual(run, m))  # type: ignore[misc]
            for m in models
        ]
        return {name: np.stack([r[name] for r in every]) for name in ports}

    # ---------------------------------------------------------------- inside

    def _residual(self, run: Run, model: Sequence[Changed]) -> dict[str, Array]:
        values = self.values(model, run.name)
        by_copy = [self.residual(values, copy) for copy in self._copies(run)]
        shape = next(iter(run.signals.values())).shape[:-1]
        out = {}
        for port in (p for p in self.ports if all(k in run for k in p.needs)):
            parts = [np.asarray(r[port.name], float) for r in by_copy]
            expected = (shape[-1], len(port.channels))
            for part in parts:
                if part.shape != expected or not np.isfinite(part).all():
                    raise ParameterError(
                        f"{self.name}: residual of port {port.name} must be {expected} finite"
                        f" numbers, got {part.shape} with {dict(values)}"
                    )
            out[port.name] = np.stack(parts).reshape(*shape, -1)
        return out

    def _copies(self, run: Run) -> list[Run]:
        """The run, or its copies with noise one by one: their signals are (T, c)."""
        if "copies" not in run.memory:
            self._require_noise(run)
            flat = {k: x.reshape(-1, *x.shape[-2:]) for k, x in run.signals.items()}
            count = len(next(iter(flat.values())))
            single = all(x.ndim == 2 for x in run.signals.values())
            every = [{k: x[i] for k, x in flat.items()} for i in range(count)]
            run.memory["copies"] = [run] if single else [run.with_signals(x) for x in every]
        return list(run.memory["copies"])

    def _require_noise(self, run: Run) -> None:
        """Refuse a run of unknown noise: what modes leave would be taken for it."""
        stated = run.meta.get("noise_std", {})
        needed = {k for p in self.ports for k in set(p.needs) - set(p.exact) if k in run}
        if lacks := sorted(needed - set(stated)):
            raise ParameterError(
                f"{run.name}: the noise of {', '.join(lacks)} is not known: state its standard"
                " deviations (noise), or say when nothing moves (rest)"
            )

    def _nuisance(self, k: _Number, step: float, std: float, run: str = "") -> Nuisance:
        change = Changed(k.key, ((k.key, k.entry, step),), run)
        name = f"{k.name} in {run}" if run else k.name
        return Nuisance(name, self._shows(k), self.model([change]), step, std)

    def _shows(self, k: _Number) -> tuple[str, ...]:
        return k.of.ports or tuple(p.name for p in self.ports)

    def _candidate(self, kind: str, slot: str, numbers: Sequence[_Number]) -> Candidate:
        shapes = [k.of.nominal is None for k in numbers]
        grid = [
            k.of.starts if shape else (k.usual,)
            for k, shape in zip(numbers, shapes, strict=True)
        ]

        def make(x: Array) -> Changed:
            values = zip(numbers, x, strict=True)
            return Changed(kind, tuple((k.key, k.entry, float(v)) for k, v in values))

        return Candidate(
            kind=kind,
            slot=slot,
            ports=tuple(dict.fromkeys(p for k in numbers for p in self._shows(k))),
            names=tuple(k.key if slot else k.name.removeprefix(f"{kind} ") for k in numbers),
            units=tuple(k.unit for k in numbers),
            starts=tuple(itertools.product(*grid)),
            low=tuple(k.of.low - k.value for k in numbers),
            high=tuple(k.of.high - k.value for k in numbers),
            make=make,
            factors=tuple(i for i, shape in enumerate(shapes) if not shape),
            sparse=len(numbers) > 1 and not any(shapes),
        )


def _numbers(key: str, p: Parameter) -> list[_Number]:
    names = [f"{key} {entry}" for entry in p.entries] or [key]
    usual = np.broadcast_to(1.0 if callable(p.usual) else p.usual, len(names))
    std = np.broadcast_to(p.tolerance, len(names))
    units = [p.unit] * len(names) if isinstance(p.unit, str) else list(p.unit)
    every = zip(names, units, usual.tolist(), std.tolist(), strict=True)
    return [
        _Number(key, i, name, symbol, p, size, deviation)
        for i, (name, symbol, size, deviation) in enumerate(every)
    ]


# ------------------------------------------------------------- samples without a clock


@dataclass(frozen=True)
class SampleWindow(SpectralWindow):
    """Samples in place of frequencies: every one counts, spread over the band by its number."""

    @property
    def frequencies(self) -> Array:
        """(K,) from 0 to the top, two samples each."""
        return np.linspace(0.0, self.top, (self.length + 1) // 2)

    def spectrum(self, x: Array) -> Array:
        """Return (..., K, c): two samples in one number, |.|^2 = s^2 for noise of variance s^2.

        Args:
            x: (..., T, c).
        """
        if x.shape[-2] % 2:
            x = np.concatenate([x, np.zeros_like(x[..., :1, :])], axis=-2)
        return np.asarray((x[..., ::2, :] + 1j * x[..., 1::2, :]) / np.sqrt(2))


@dataclass(frozen=True, eq=False)
class SampleRun(Run):
    """Samples without a clock, such as poses at rest: their noises are independent."""

    @property
    def window(self) -> SampleWindow:
        """The samples that are compared."""
        return SampleWindow(self.length, self.dt, self.band, 0)


def samples(
    name: str, signals: Mapping[str, Array], noise: Mapping[str, float | Sequence[float]]
) -> SampleRun:
    """Return samples without a clock as a run.

    Args:
        name: of the run.
        signals: (T, c) each.
        noise: standard deviations of each signal, one or (c,); 0 where it is exact.

    Raises:
        ParameterError: too few samples, or signals of different lengths.
    """
    lengths = {len(x) for x in signals.values()}
    if len(lengths) != 1 or min(lengths) < _FEWEST:
        raise ParameterError(
            f"{name}: needs at least {_FEWEST} samples of every signal, got"
            f" {', '.join(f'{len(x)} of {k}' for k, x in signals.items())}"
        )
    arrays = {k: np.asarray(x, float) for k, x in signals.items()}
    white = {}
    for key, std in noise.items():
        require_one_of("noise", key, arrays)
        size = np.broadcast_to(np.asarray(std, float), arrays[key].shape[1]).copy()
        white[key] = SensorNoiseModel(size, np.zeros(len(size)))
    return SampleRun(name, _STEP, arrays, white, {"noise_std": dict(noise)}, 1.0)


# ------------------------------------------------------------------------ by name

MACHINES: dict[str, Any] = {}  # name -> dataclass with `machine(folder)`


def register_machine(name: str) -> Callable[[T], T]:
    """File a description, so that mapping files can name its machine.

    Args:
        name: as a mapping file says it.

    Returns:
        A decorator for a frozen dataclass whose `machine(folder)` returns a `ResidualMachine`;
        its fields are the keys of `[description]`, `folder` is that of the mapping file.

    Raises:
        ParameterError: the name is taken.
    """

    def register(cls: T) -> T:
        if not (dataclasses.is_dataclass(cls) and hasattr(cls, "machine")):
            raise ParameterError(f"{cls.__name__} must be a dataclass with machine(folder)")
        require_free(name, "machine", cls, MACHINES.get(name))
        MACHINES[name] = cls
        return cls

    return register
