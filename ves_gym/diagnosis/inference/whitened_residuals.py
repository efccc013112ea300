"""Residual whitening: numbers that are independent and of unit size under noise alone.

Residuals go through a window into the frequency domain, where noise of neighbouring
frequencies is independent; there they are divided by what the measured noise becomes at the
port. They are sorted into groups, a channel in a range of frequencies over all runs, because
a description is never equally good everywhere: each group's size is estimated
(`variance_groups.py`).

A port that multiplies described numbers with noisy signals (a mass with a pose differentiated
twice) passes more or less noise on under other numbers. There every change of the residual is
also taken on copies of the runs with more noise of the same kind, and its noise stands beside
it in the long vector: least squares alone would take a lighter base for a better one.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym._util.signals import SensorNoiseModel, SpectralWindow
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.base import Machine, Nuisance, Port, testable

_DRAWS = 12  # of the noise, to learn what it becomes at a port
_SHAPES = 400  # draws of slow noise, to learn how it falls with the frequency
_COPIES = 4  # of the noise, to learn what a change of the numbers makes of it
_FAINT = 0.3  # of noise: what a run may have had of its own that is not worth a number
_POOL = 6  # neighbouring frequencies on either side that are taken together
_EDGES = (0.0, 0.1, 0.3, 1.0)  # of the ranges of frequencies, in parts of the band


@dataclass(frozen=True)
class Wander:
    """Noise that wanders beside the noise that shows above the motion.

    Of first order; the part that changes from sample to sample stands for 1 in power.
    """

    share: float  # of the variance
    memory: float  # s

    def excess(self, window: SpectralWindow) -> Array:
        """Return (K,) the power of all noise, in that without it."""
        return np.asarray(1 + self.share * wander_shape(window, self.memory))


@cache
def wander_shape(window: SpectralWindow, memory: float) -> Array:
    """Return (K,) the mean power of wandering noise, white noise of its variance having 1.

    Args:
        window: of a run.
        memory: s.
    """
    a = np.full(1, np.exp(-window.dt / memory))
    drawn = SensorNoiseModel(np.ones(1), a).draw(
        np.random.default_rng(0), _SHAPES, window.length
    )
    white = SensorNoiseModel(np.ones(1), np.zeros(1)).draw(
        np.random.default_rng(1), _SHAPES, window.length
    )
    power = [np.square(np.abs(window.spectrum(x)[..., 0])).mean(axis=0) for x in (drawn, white)]
    return np.asarray(power[0] / power[1].mean())


Model = Any  # a machine's own: the description with some effects


@dataclass(frozen=True)
class VarianceGroup:
    """A channel of a port in a range of frequencies."""

    port: str
    channel: int
    low: float  # Hz
    high: float
    part: slice  # of the long vector
    runs: tuple[slice, ...]  # of the long vector, run by run
    copies: tuple[slice, ...] = ()  # of it: the same numbers of noise alone, draw by draw
    floor: float = 0.0  # mean square below which they mean nothing, in that of the noise
    priced: bool = True  # noise passed on enlarged costs density; else it is that of an answer

    @property
    def n(self) -> int:
        """Count of numbers."""
        return self.part.stop - self.part.start


class WhitenedResiduals:
    """Whitened residuals of several runs of one machine.

    Args:
        machine: the description.
        runs: all with the same ports.
        seed: of the noise draws.
        slow: port -> how much its noise wanders beside that.
    """

    def __init__(
        self,
        machine: Machine,
        runs: Sequence[Run],
        seed: int = 0,
        slow: Mapping[str, Wander] | None = None,
    ) -> None:
        self.machine, self.runs, self.seed = machine, list(runs), seed
        self.slow = dict(slow or {})
        self._copies: dict[Any, Run] = {}  # runs with noise to pass on
        self.ports: tuple[Port, ...] = testable(machine, runs)
        names = [p.name for p in self.ports]
        self._spans: dict[str, slice] = {}  # port -> numbers and copies
        self.groups, self._rows = self._layout()
        self.size = sum(g.n for g in self.groups)  # numbers that are measured
        self.length = max(s.stop for s in self._spans.values())  # with those of the copies
        self.memory: dict[Any, Array] = {}  # residuals already asked for, by port and effects
        raw = [machine.residuals(run, [machine.nominal], names) for run in self.runs]
        self.scale = 1.0  # of the jitter that is stated
        self._noise = [self._noises(i, raw[i]) for i in range(len(self.runs))]
        self._whiten = self._stated = self._whitening()  # (K, c, c) of each run and port
        self.groups = self._with_floors()
        self.null = np.zeros(self.length)
        for port in self.ports:
            nominal = [r[port.name] for r in raw]
            self.null[self.span(port.name)] = self._with_copies(
                port, nominal, [machine.nominal]
            )[0]
        tested = set(names)
        shared = [k for k in machine.nuisances if tested & set(k.ports)]
        per_run = [k for run in runs for k in machine.unknowns(run) if tested & set(k.ports)]
        own_slopes = self._slopes_of(per_run)
        shows = np.linalg.norm(own_slopes, axis=0) > _FAINT
        self.shared = len(shared)  # nuisances of the machine; the others are of single runs
        self.nuisances = [
            *shared,
            *(k for k, visible in zip(per_run, shows, strict=True) if visible),
        ]
        self.slopes = np.concatenate([self._slopes_of(shared), own_slopes[:, shows]], axis=1)
        parts = [self.slopes[g.part] for g in self.groups]
        self.gram = np.stack([J.T @ J for J in parts])  # (G, p, p)
        self.noise_gram = np.stack([self.noise_product(g, self.slopes) for g in self.groups])

    def _noises(self, i: int, raw: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """Return (K, c, c) covariances of a run's noise at each port: all but its jitter, and
        that."""
        run, rng, out = self.runs[i], np.random.default_rng([self.seed, i]), {}
        for exact in sorted({p.exact for p in self.ports}):
            names = [p.name for p in self.ports if p.exact == exact]

            def drawn(
                exact: tuple[str, ...] = exact, names: list[str] = names, **which: bool
            ) -> dict[str, Array]:
                copies = run.with_noise(rng, _DRAWS, exact, **which)
                noisy = self.machine.residuals(copies, [self.machine.nominal], names)
                spectra = {k: run.window.spectrum(x[0] - raw[k][0]) for k, x in noisy.items()}
                return {k: _pooled(x) for k, x in spectra.items()}

            fixed = drawn(jitter=False)
            shaken = (
                drawn(sensors=False) if run.jitter else {k: 0 * x for k, x in fixed.items()}
            )
            for name in names:
                if name in self.slow:
                    fixed[name] *= self.slow[name].excess(run.window)[:, None, None]
                floor = np.diag(self.machine.floor(run, name) ** 2)
                out[name] = fixed[name] + floor, shaken[name]
        return out

    def _whitening(self) -> list[dict[str, Array]]:
        square = self.scale**2
        return [
            {
                port: _inverse_root(fixed + square * shaken)
                for port, (fixed, shaken) in k.items()
            }
            for k in self._noise
        ]

    def _with_floors(self) -> list[VarianceGroup]:
        """Return the groups with the share that each machine's floor has in its noise."""
        sums: dict[int, float] = {}  # by where their numbers begin
        for run, rows, whiten in zip(self.runs, self._rows, self._whiten, strict=True):
            for port, parts in rows.items():
                floor = self.machine.floor(run, port) ** 2
                share = np.einsum("kij,j->ki", np.abs(whiten[port]) ** 2, floor)
                for take, part, channel in parts:
                    sums[part.start] = 2 * float(share[take, channel].sum())
        return [
            replace(g, floor=sum(sums[part.start] for part in g.runs) / max(g.n, 1))
            for g in self.groups
        ]

    def _slopes_of(self, nuisances: Sequence[Nuisance]) -> Array:
        """Return (N, p) whitened residuals per usual size of nuisances."""
        out = np.zeros((self.length, len(nuisances)))
        for ports in dict.fromkeys(k.ports for k in nuisances):
            alike = [j for j, k in enumerate(nuisances) if k.ports == ports]
            moved = self.under([nuisances[j].model for j in alike], ports) - self.null
            for j, change in zip(alike, moved, strict=True):
                out[:, j] = change * (nuisances[j].std / nuisances[j].step)
        return out

    def with_tolerances(self, factor: float) -> WhitenedResiduals:
        """Return the same residuals with tolerances and jitter a factor as large."""
        scale = np.where([k.scales for k in self.nuisances], factor, 1.0)
        out = copy.copy(self)
        out.nuisances = [
            replace(k, std=k.std * s) for k, s in zip(self.nuisances, scale, strict=True)
        ]
        out.slopes = self.slopes * scale
        both = np.outer(scale, scale)
        out.gram, out.noise_gram = self.gram * both, self.noise_gram * both
        if any(run.jitter for run in self.runs):
            out.scale, out.memory = self.scale * factor, {}
            out._whiten = out._whitening()
            out.groups = out._with_floors()
            out.null = out.rewhitened(self.null[:, None], self)[:, 0]
            out.slopes = out.rewhitened(out.slopes, self)
            out.gram = np.stack([out.slopes[g.part].T @ out.slopes[g.part] for g in out.groups])
        return out

    def rewhitened(self, x: Array, other: WhitenedResiduals) -> Array:
        """Return columns (N, m) that other residuals whiten as these do, copies as they are."""
        out = x.copy()
        for rows, new, old in zip(self._rows, self._whiten, other._whiten, strict=True):
            for port, parts in rows.items():
                if new[port] is old[port]:
                    continue
                z = np.zeros((*new[port].shape[:2], x.shape[1]), complex)
                for take, part, channel in parts:
                    real, imag = x[part].reshape(2, -1, x.shape[1])
                    z[take, channel] = real + 1j * imag
                z = new[port] @ np.linalg.solve(old[port], z)
                for take, part, channel in parts:
                    out[part] = np.concatenate([z[take, channel].real, z[take, channel].imag])
        return out

    @property
    def density(self) -> float:
        """Log determinant of the noise's covariance, as it counts in a deviance."""
        every = [w for port in self._whiten for w in port.values()]
        return -4 * sum(float(np.linalg.slogdet(w)[1].sum()) for w in every)

    def less_nuisances(self, z: Array, x: Array, fitted: bool) -> Array:
        """Return a residual (N,) less what nuisances do.

        Args:
            z: (N,).
            x: (p,) nuisances in units of their usual size.
            fitted: they were found on these runs; else those of the machine are taken over,
                and those of single runs found here.
        """
        if fitted:
            return np.asarray(z + self.slopes @ x)
        m = self.shared
        z = z + self.slopes[:, :m] @ x[:m]
        per_run, weight = self.slopes[:, m:], np.zeros(self.length)
        for g in self.groups:
            weight[g.part] = 1 / max(float(np.mean(z[g.part] ** 2)), 1.0)
        weighted = per_run.T * weight
        x_run = np.linalg.solve(weighted @ per_run + np.eye(per_run.shape[1]), weighted @ z)
        return np.asarray(z - per_run @ x_run)

    def _layout(
        self,
    ) -> tuple[list[VarianceGroup], list[dict[str, list[tuple[Index, slice, int]]]]]:
        """Return groups, and per run and port (frequencies taken, place, channel)."""
        groups: list[VarianceGroup] = []
        rows: list[dict[str, list[tuple[Index, slice, int]]]] = [
            {p.name: [] for p in self.ports} for _ in self.runs
        ]
        at = 0
        for port in self.ports:
            first, mine = at, len(groups)
            for channel in range(len(port.channels)):
                for low, high in itertools.pairwise(_EDGES):
                    begin, parts = at, []
                    for run, row in zip(self.runs, rows, strict=True):
                        f = run.window.frequencies / run.band
                        take = np.flatnonzero((f >= low) & (f < high + (high == 1.0)))
                        parts.append(slice(at, at + 2 * len(take)))
                        row[port.name].append((take, parts[-1], channel))
                        at += 2 * len(take)
                    top = self.runs[0].band
                    groups.append(
                        VarianceGroup(
                            port.name,
                            channel,
                            low * top,
                            high * top,
                            slice(begin, at),
                            tuple(parts),
                            priced=not port.answers,
                        )
                    )
            n = at - first
            for k in range(mine, len(groups) if port.differentiates else mine):
                part = groups[k].part
                shifts = [n * (j + 1) for j in range(_COPIES)]
                copies = tuple(slice(part.start + s, part.stop + s) for s in shifts)
                groups[k] = replace(groups[k], copies=copies)
            at += n * _COPIES if port.differentiates else 0
            self._spans[port.name] = slice(first, at)
        return groups, rows

    def lowest(self, port: str, z: Array) -> list[tuple[Array, Array]]:
        """Return frequencies and power of a port at its lowest frequencies, run by run.

        Channels are taken as they are: whitening mixes a little of one into the others, and
        what is large in one would show in all.

        Args:
            port: name.
            z: (N,) whitened.

        Returns:
            (m,) places in the run's window, and (m, c) in mean squares of the noise.
        """
        out = []
        for rows, whiten in zip(self._rows, self._whiten, strict=True):
            lowest = {c: (take, part) for take, part, c in reversed(rows[port])}
            take = lowest[0][0]
            parts = [z[lowest[c][1]].reshape(2, -1) for c in sorted(lowest)]
            both = np.stack([(real + 1j * imag) / np.sqrt(2) for real, imag in parts], axis=-1)
            root = np.linalg.inv(whiten[port][take])
            noise = np.einsum("kij,kij->ki", root, root.conj()).real
            x = np.einsum("kij,kj->ki", root, both)
            out.append((take, np.abs(x) ** 2 / noise))
        return out

    def part(self, port: str) -> slice:
        """Return the place of a port's numbers in the long vector."""
        mine = [g.part for g in self.groups if g.port == port]
        return slice(mine[0].start, mine[-1].stop)

    def span(self, port: str) -> slice:
        """Return the place of a port's numbers and of their copies in the long vector."""
        return self._spans[port]

    @property
    def measured(self) -> Index:
        """(size,) places of what is measured, not of copies."""
        return np.r_[*(g.part for g in self.groups)]

    def noise_product(self, group: VarianceGroup, a: Array, b: Array | None = None) -> Array:
        """Return what noise alone adds to the product of two sets of columns in a group.

        Args:
            group: of numbers.
            a: (N, i).
            b: (N, j); a itself by default.

        Returns:
            (i, j), the mean over the draws; zero where the port does not differentiate.
        """
        b = a if b is None else b
        out = np.zeros((a.shape[1], b.shape[1]))
        for part in group.copies:
            out += a[part].T @ b[part] / len(group.copies)
        return out

    def at_port(self, port: str, models: Sequence[Model]) -> Array:
        """Return whitened residuals of one port, and what noise alone adds to them.

        Args:
            port: name.
            models: m.

        Returns:
            (m, n), n that of the port's `span`.
        """
        by_run = [self.machine.residuals(run, models, [port]) for run in self.runs]
        chosen_port = next(p for p in self.ports if p.name == port)
        return self._with_copies(chosen_port, [k[port] for k in by_run], models)

    def _with_copies(
        self, port: Port, by_run: Sequence[Array], models: Sequence[Model]
    ) -> Array:
        """Return (m, n) numbers of a port, and behind them what noise adds in each copy.

        Copies have the noise that is stated, and are whitened by it.
        """
        out = [self.whitened(port.name, by_run)]
        if port.differentiates:
            passing = [self.machine.passing(m) for m in models]
            ways = [k for i, k in enumerate(passing) if k not in passing[:i]]
            of = [ways.index(k) for k in passing]
            if ways != list(models):
                by_run = [
                    self.machine.residuals(run, ways, [port.name])[port.name][of]
                    for run in self.runs
                ]
            plain = self.whitened(port.name, by_run, self._stated)
            noisy = [
                self.machine.residuals(copy, ways, [port.name])[port.name]
                for copy in (self._copy(i, port.exact) for i in range(len(self.runs)))
            ]
            samples = [x[of].reshape(-1, *x.shape[2:]) for x in noisy]  # model by model
            copies = self.whitened(port.name, samples, self._stated)
            added = copies.reshape(len(models), _COPIES, -1) - plain[:, None]
            out.append(added.reshape(len(models), -1))
        return np.concatenate(out, axis=1)

    def _copy(self, i: int, exact: tuple[str, ...]) -> Run:
        """Return a run with draws of its noise on top, the same whenever asked for."""
        key = i, exact
        if key not in self._copies:
            rng = np.random.default_rng([self.seed, i, 1])
            self._copies[key] = self.runs[i].with_noise(rng, _COPIES, exact)
        return self._copies[key]

    def under(self, models: Sequence[Model], ports: Sequence[str]) -> Array:
        """Return whitened residuals; those of ports not named are the nominal ones.

        Args:
            models: m.
            ports: names.

        Returns:
            (m, N).
        """
        out = np.tile(self.null, (len(models), 1))
        for port in (p.name for p in self.ports if p.name in ports):
            out[:, self.span(port)] = self.at_port(port, models)
        return out

    def acts(self, model: Model, ports: Sequence[str]) -> float:
        """Return the time in which a model differs from the description at some ports.

        Args:
            model: the description with effects.
            ports: names.

        Returns:
            Seconds, over all runs.
        """
        out = 0.0
        for run in self.runs:
            port_names = [p.name for p in self.ports if p.name in ports]
            residuals = self.machine.residuals(run, [model, self.machine.nominal], port_names)
            differs = [(k[0] != k[1]).any(axis=-1) for k in residuals.values()]
            out += run.dt * float(np.count_nonzero(np.any(differs, axis=0)))
        return out

    def whitened(
        self,
        port: str,
        by_run: Sequence[Array],
        whitening: Sequence[Mapping[str, Array]] | None = None,
    ) -> Array:
        """Return (m, n) numbers of a port from residuals (m, T, c) of every run.

        Args:
            port: name.
            by_run: residuals.
            whitening: (K, c, c) of each run and port; that of these residuals by default.
        """
        whitening = self._whiten if whitening is None else whitening
        span = self.part(port)
        out = np.empty((len(by_run[0]), span.stop - span.start))
        for run, rows, whiten, residual in zip(
            self.runs, self._rows, whitening, by_run, strict=True
        ):
            x = run.window.spectrum(residual)  # (m, K, c)
            z = np.sqrt(2) * np.moveaxis(whiten[port] @ np.moveaxis(x, 0, -1), -1, 0)
            for take, part, channel in rows[port]:
                selected = z[:, take, channel]
                at = slice(part.start - span.start, part.stop - span.start)
                out[:, at] = np.concatenate([selected.real, selected.imag], axis=1)
        return out


def _pooled(spectra: Array) -> Array:
    """(K, c, c) cross-spectra of draws (D, K, c), neighbouring frequencies taken together."""
    draws, K, _ = spectra.shape
    cross = np.einsum("dki,dkj->kij", spectra, spectra.conj()) / draws
    reach = np.abs(np.arange(K)[:, None] - np.arange(K)) <= _POOL
    return np.asarray(np.einsum("kl,lij->kij", reach / reach.sum(axis=1, keepdims=True), cross))


def _inverse_root(covariance: Array) -> Array:
    """Return (K, c, c) symmetric roots: every number stays with the channel it comes from."""
    value, vector = np.linalg.eigh(covariance)
    return np.asarray((vector / np.sqrt(value)[:, None, :]) @ np.conj(vector.swapaxes(-1, -2)))
