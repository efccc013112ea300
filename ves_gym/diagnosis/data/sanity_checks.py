"""Sanity checks of a log: channels exchanged, late, with another sign or in another unit.

Such mistakes are no physics: no effect of the library is meant to explain them, and none may
be named for them. Each is tried, and asked about if the data then agree far better with the
description. Nothing is converted.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy
from scipy.constants import degree, g

from ves_gym._util.params import Array, ParameterError
from ves_gym.diagnosis.data.measured_run import Run, require_steady
from ves_gym.diagnosis.machines.base import WRENCH, Machine, Port, testable
from ves_gym.mechanics.spatial import AXES
from ves_gym.system.runlog import RunLog
from ves_gym.system.system import System

_BAD = 0.5  # of a channel's own movement: a residual that no effect of usual size makes
_BADLY = {"servo": 0.15}  # where nothing but a controller known to all is between the signals
_FAR = 0.2  # of it: what is left where a mistake is found
_GOOD = 0.3  # of a channel's movement: more is no agreement
_BETTER = {"admittance": 0.1}  # a computer's law on what it logs: it is right, or another is
_SHIFTED = 0.1  # of a channel's movement: what a late recorder leaves of slow motion
_FALLEN = 0.5  # of a residual with its noise: what is left where a mistake was
_SPOILED = 1.2  # of a residual: others may not get worse
_NOISY = 2.0  # times noise drawn once, which scatters: what is below is no residual
_MOVING = 0.1  # of the largest movement of its kind
_HEARD = 3.0  # times the noise that a movement must have
_LEAST = 0.02  # of a channel's movement: better does not count
_TIE = 1e-6  # of the logarithm by which residuals fall
_UNITS = (  # signal, what no such machine reaches, unit expected, unit it may be in
    ("q", 13.0, "rad", "degrees"),
    ("q_cmd", 13.0, "rad", "degrees"),
    ("y", 5.0, "m", "millimetres"),
    ("y", 3.2, "rad", "degrees"),
    ("y_cmd", 5.0, "m", "millimetres"),
    ("y_cmd", 3.2, "rad", "degrees"),
)
_TURNED = 0.5  # rad: by which a jump may differ from a turn
_SLOW = ("joint", "servo", "wrench", "platform")  # ports that take 100 times as long as others
_LATE = (0.04, 0.5)  # s; what a machine itself is late by is shorter, and an effect
_RECORDED = (  # signals that one recorder reads, and their name
    (("q", "v"), "q"),
    (("q_cmd", "v_cmd"), "q_cmd"),
    (("tau",), "tau"),
    (("y", "yd"), "y"),
    (("y_cmd",), "y_cmd"),
    (("w", "weight"), "w"),
)
_OF_A_BODY = ("w", "wg", "weight", "y")  # three channels along axes, three about them
_ANGLE = ((degree, "degrees, not rad"), (1 / degree, "rad twice converted from degrees"))
_LENGTH = ((1e-3, "millimetres, not m"), (1e3, "kilometres, not m"))
_FORCE = (
    (1e-3, "mN, not N"),
    (1e3, "kN, not N"),
    (g, "kgf, not N"),
)
_TORQUE = (
    (1e-3, "N mm, not N m"),
    (1e-2, "N cm, not N m"),
    (1e3, "kN m, not N m"),
    (g, "kgf m, not N m"),
)
_JOINT = ("q", "v", "q_cmd", "v_cmd", "tau")
_TOGETHER = (  # signals that one cable or one file mixes up together, and their name
    (("q", "v"), "q"),
    (("q_cmd", "v_cmd"), "q_cmd"),
    (("tau",), "tau"),
    (("v",), "v"),
    (_JOINT, "joint"),
)

Change = Callable[[Run], Mapping[str, Array]]


def require_plausible(log: RunLog, system: System, name: str) -> None:
    """Refuse a log that cannot be of this system as it stands, and ask why.

    Raises:
        ParameterError: another number of joints, gaps in the clock, or numbers so large that
            they look like another unit.
    """
    if log.n_joints != system.arm.n:
        raise ParameterError(
            f"{name}: has {log.n_joints} joints, {system.arm.name} has {system.arm.n}"
        )
    require_steady(log.t, name)
    for key, most, expected, suspected in _UNITS:
        x = getattr(log, key)
        if x is None:
            continue
        columns = x[:, 3:] if expected == "rad" and key.startswith("y") else x
        columns = x[:, :3] if expected == "m" else columns
        far = float(np.abs(columns).max())
        if far > most:
            raise ParameterError(
                f"{name}: {key} reaches {far:.4g}; is it in {suspected}? {expected} is expected"
            )
    for key in ("q", "q_cmd"):
        x = getattr(log, key)
        jumps = np.zeros((1, 1)) if x is None else np.abs(np.diff(x, axis=0))
        row, i = np.unravel_index(np.argmax(jumps), jumps.shape)
        if abs(jumps[row, i] - 2 * np.pi) < _TURNED:
            raise ParameterError(
                f"{name}: row {row + 2}: {key}_{i + 1} jumps by {jumps[row, i]:.3g} rad; is it"
                " wrapped into a turn? angles that go on are expected"
            )


@dataclass(frozen=True)
class Question:
    """A mistake that would explain a run."""

    run: str
    text: str  # "tau_1 exchanged with tau_2"
    port: str
    channel: str
    before: float  # residual, in parts of the channel's movement
    after: float
    # "tau_1" and "tau" -> as the file says
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """The question."""
        names = {k: f"{k} ({name})" for k, name in self.columns.items()}
        text = re.sub(r"\w+", lambda k: names.get(k[0], k[0]), self.text)
        return (
            f"{self.run}: {text}? At port {self.port}, {self.channel}, {self.before:.0%}"
            f" of the signal is not explained as logged, and {self.after:.1%} would not be so;"
            " correct the log or the description, or say --as-logged"
        )


@dataclass(frozen=True)
class _Mistake:
    text: str
    signals: frozenset[str] = frozenset()  # that it changes; none: it is in the description
    change: Change | None = None
    machine: Machine | None = None
    late: bool = False


def require_as_logged(
    machine: Machine, runs: Sequence[Run], others: Sequence[tuple[str, Machine]] = ()
) -> None:
    """Refuse runs that a mistake would explain far better, as a question.

    Raises:
        ParameterError: the question.
    """
    for run in runs:
        question = suspected_mistake(machine, run, others)
        if question is not None:
            raise ParameterError(question.sentence)


def suspected_mistake(
    machine: Machine, run: Run, others: Sequence[tuple[str, Machine]] = ()
) -> Question | None:
    """Return the question about what explains a run best, if it does so far better.

    A mistake elsewhere that explains it as well is asked about with it.
    `others` are usual mistakes in the description: wording, and the machine without it.
    """
    check = _Look(machine, run)
    columns = run.meta.get("columns", {})
    if dead := check.dead():
        return replace(dead, columns=columns)
    lags = {abs(check.lag(p)) for p in check.ports}
    late = list(_late(run, [k for k in lags if k * run.dt >= _LATE[0]]))
    usual = _mistakes(machine, run, others) if check.disagrees(_BAD) else ()
    judged = [(*k, m) for m in (*usual, *late) if (k := check.judged(m))]
    if not judged:
        return None
    gain, question, best = max(judged, key=lambda k: k[0])
    equal = (m.text for k, _, m in judged if k > gain - _TIE and m.signals != best.signals)
    text = ", or ".join([question.text, *itertools.islice(equal, 1)])
    return replace(question, text=text, columns=columns)


class _Look:
    """A run beside its description: what each channel leaves, in parts of its movement."""

    def __init__(self, machine: Machine, run: Run) -> None:
        self.machine, self.run = machine, replace(run, by_log=True)
        # a torque logged in another unit must not be told by what the controller asked
        self.ports = testable(machine, [run])
        self.heard = {p.name: _tells(run, p.signal) for p in self.ports}
        self._noise = {p.name: self._of_noise(p) for p in self.ports}
        self._raw = {p.name: self._left(p, machine, self.run) for p in self.ports}
        self.logged = {p.name: self.size(p, self.run, self._raw[p.name]) for p in self.ports}

    def _of_noise(self, port: Port) -> Array:
        """Size (c,) of what noise as logged makes of a residual."""
        copy = self.run.with_noise(np.random.default_rng(0), 1, port.exact)
        noisy, plain = (self._residual(port, self.machine, k) for k in (copy, self.run))
        return _size(self.run, noisy[0] - plain)

    def _residual(self, port: Port, machine: Machine, run: Run) -> Array:
        return machine.residuals(run, [machine.nominal], [port.name])[port.name][0]

    def _left(self, port: Port, machine: Machine, run: Run) -> Array:
        """Return (c,) size of the residual, noise and all."""
        return _size(run, self._residual(port, machine, run))

    def size(self, port: Port, run: Run, residual: Array) -> Array:
        """Return (c,) size of a residual beyond its noise, over that of the movement.

        It is 0 where a channel does not tell anything.
        """
        signal = _size(run, _logged(run, port.signal))
        noise = _NOISY * self._noise[port.name]
        beyond = np.sqrt(np.maximum(residual**2 - noise**2, 0.0))
        size = np.where(np.isfinite(beyond), beyond, np.inf) / np.maximum(signal, 1e-300)
        return np.where(self.heard[port.name], size, 0.0)

    def disagrees(self, least: float) -> bool:
        """Return True if a channel leaves more than a part of its movement, or a port's own."""
        return any((x > _BADLY.get(k, least)).any() for k, x in self.logged.items())

    def dead(self) -> Question | None:
        """Return the channel that stands still to the last digit where it must move."""
        run = self.run
        for port in self.ports:
            size = self._raw[port.name]
            moved = _size(run, _logged(run, port.signal)).max()
            least = np.maximum(_MOVING * moved, _NOISY * self._noise[port.name])
            for signal in {port.signal} | ({"q"} if port.name == "velocity" else set()):
                x = _logged(run, signal)
                still = (np.ptp(x, axis=0) <= 1e-12 * np.abs(x).max()) & (size > least)
                for i in np.flatnonzero(still):
                    channel = port.channels[i]
                    axis = channel if signal in _OF_A_BODY else str(i + 1)
                    label = f"{signal} {axis}" if signal in _OF_A_BODY else f"{signal}_{axis}"
                    text = f"is {label} dead, {x[0, i]:g} all the time"
                    return Question(run.name, text, port.name, channel, 1.0, 0.0)
        return None

    def lag(self, port: Port) -> int:
        """Return the samples by which a port's signal comes after what is predicted."""
        run, heard = self.run, self.heard[port.name]
        x, residual = _logged(run, port.signal), self._residual(port, self.machine, run)
        most = min(round(_LATE[1] / run.dt), run.length // 4)
        likeness, ones = np.zeros(2 * most + 1), np.ones(run.length)
        inner = slice(run.length - 1 - most, run.length + most)
        for signal, left in zip(x.T[heard], residual.T[heard], strict=True):
            a, b = (k - k.mean() for k in (signal, signal - left))
            shared, *sizes = (
                scipy.signal.correlate(*k)[inner] for k in ((a, b), (a**2, ones), (ones, b**2))
            )
            likeness += shared / np.sqrt(np.maximum(sizes[0] * sizes[1], 1e-300))
        return int(np.argmax(likeness)) - most

    def judged(self, mistake: _Mistake) -> tuple[float, Question] | None:
        """Return how much better a run is without a mistake, and the question, if it is."""
        badly = {} if mistake.late else _BADLY
        least = _SHIFTED if mistake.late else _BAD
        bad = {k: x > badly.get(k, least) for k, x in self.logged.items()}
        keys = mistake.signals
        touched = [
            p for p in self.ports if (keys & set(p.needs) if keys else bad[p.name].any())
        ]
        # most are refuted by ports that take no time
        touched.sort(key=lambda p: (p.name in _SLOW, not bad[p.name].any()))
        run = self.run
        if mistake.change is not None and any(bad[p.name].any() for p in touched):
            run = run.with_signals(mistake.change(run))
        gain, best, question = 0.0, 1.0, None
        for i, port in enumerate(touched):
            name, before = port.name, self.logged[port.name]
            if not question and not any(bad[p.name].any() for p in touched[i:]):
                return None
            left = self._left(port, mistake.machine or self.machine, run)
            after = self.size(port, run, left)
            allowed = _LEAST if mistake.late else _GOOD
            if (after > np.maximum(_SPOILED * before, allowed)).any():
                return None
            # a channel that no longer stands out of its noise would agree with anything
            better = after < np.minimum(_FAR * before, _BETTER.get(name, _GOOD))
            better &= left < _FALLEN * self._raw[name]
            healed = np.logical_and.reduce([bad[name], _tells(run, port.signal), better])
            ratio = np.maximum(before, _LEAST) / np.maximum(after, _LEAST)
            gain += float(np.log(ratio).sum())
            for k in np.flatnonzero(healed):
                value = float(before[k] / max(after[k], 1e-9))
                if question is None or value > best:
                    at = (mistake.text, name, port.channels[k], float(before[k]))
                    best, question = value, Question(self.run.name, *at, float(after[k]))
        return (gain, question) if question else None


def _late(run: Run, lags: Collection[int]) -> Iterator[_Mistake]:
    """Yield each recorder that may be as late, or as early, as a port's signal seems to be."""
    for (keys, name), lag in itertools.product(_RECORDED, sorted(lags)):
        have = tuple(k for k in keys if k in run)
        for word, way in (("late", lag), ("early", -lag)) if have else ():
            text = f"is {name} {1e3 * lag * run.dt:.3g} ms {word}"
            yield _Mistake(text, frozenset(have), _put_off(have, way), late=True)


def _put_off(keys: tuple[str, ...], lag: int) -> Change:
    """Return all signals, those of a recorder `lag` samples earlier against the others."""
    early, late = (
        (slice(lag, None), slice(None, -lag))
        if lag > 0
        else (slice(None, lag), slice(-lag, None))
    )
    return lambda run: {k: x[early if k in keys else late] for k, x in run.signals.items()}


def _size(run: Run, x: Array) -> Array:
    """Return (c,) size of signals (T, c) in the band, their level left out."""
    return np.linalg.norm(run.window.spectrum(x)[1:], axis=0)


def _tells(run: Run, signal: str) -> Array:
    """Return (c,) True for channels of a signal, as logged, that stand out of their noise, and
    do not hardly move beside their kind."""
    x = _logged(run, signal)
    size = _size(run, x)
    out = np.ones(len(size), bool)
    if signal in run.noise:  # white, as large as all of it: more than what is in the band
        out &= size > _HEARD * run.noise[signal].std * np.sqrt(len(run.window.frequencies))
    if signal in _OF_A_BODY:
        most = np.repeat(size.reshape(2, 3).max(axis=1), 3)
        out &= size >= _MOVING * most
    return out


# --------------------------------------------------------------------------- mistakes


def _mistakes(
    machine: Machine, run: Run, others: Sequence[tuple[str, Machine]]
) -> Iterator[_Mistake]:
    for text, other in others:
        yield _Mistake(text, machine=other)
    for pairs in ((("q", "q_cmd"), ("v", "v_cmd")), (("y", "y_cmd"),)):
        if all(a in run and b in run for a, b in pairs):
            ways = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
            text = f"are {pairs[0][0]} and {pairs[0][1]} exchanged"
            yield _Mistake(text, frozenset(ways), partial(_exchanged, ways))
    n = run["q"].shape[1] if "q" in run else 0
    for keys, name in _TOGETHER:
        have = tuple(k for k in keys if k in run)
        all_joints = name == "joint"
        if not have or not (all_joints or name in have):
            continue
        labels = [f"joint {i + 1}" if all_joints else f"{name}_{i + 1}" for i in range(n)]
        yield from _orders(have, labels, [range(n)])
        units = _TORQUE + _FORCE[:2] if name == "tau" else _ANGLE + _LENGTH
        yield from _units(have, slice(None), f"is {name}", () if all_joints else units)
        for i in range(n) if n > 1 and not all_joints else ():
            yield from _units(have, slice(i, i + 1), f"is {labels[i]}", units)
    if "q" in run and "v" in run:
        yield from _units(("q",), slice(None), "is q, without its rate,", _ANGLE)
    angles = tuple(k for k in _JOINT[:4] if k in run)
    yield from _units(angles, slice(None), "are all joint angles", _ANGLE if angles else ())
    first, last = slice(0, 3), slice(3, 6)
    for keys, name in ((("y",), "y"), (("y_cmd",), "y_cmd"), (("y", "y_cmd"), "y and y_cmd")):
        if all(k in run for k in keys):
            yield from _orders(keys, [f"{name} {a}" for a in AXES], [range(3), range(3, 6)])
            yield from _units(keys, first, f"is the position in {name}", _LENGTH)
            yield from _units(keys, last, f"are the angles in {name}", _ANGLE)
    for keys, name in ((("w", "wg"), "w and wg"), (("w",), "w"), (("wg",), "wg")):
        if "w" in run and ("wg" not in keys or "weight" in run):
            yield from _orders(keys, [f"{name} {a}" for a in WRENCH], [range(3), range(3, 6)])
            halves = _picked(keys, np.eye(6)[[3, 4, 5, 0, 1, 2]])
            text = f"are forces and moments of {name} exchanged"
            yield _Mistake(text, _changed(keys), halves)
            yield from _units(keys, first, f"are the forces in {name}", _FORCE)
            yield from _units(keys, last, f"are the moments in {name}", _TORQUE)


def _exchanged(ways: Mapping[str, str], run: Run) -> dict[str, Array]:
    return {a: run[b] for a, b in ways.items()}


def _orders(
    keys: tuple[str, ...], labels: Sequence[str], kinds: Sequence[range]
) -> Iterator[_Mistake]:
    """Yield one channel with the other sign, and two of a kind exchanged."""
    size = len(labels)
    for i in range(size):
        flip = np.eye(size)
        flip[i, i] = -1.0
        text = f"has {labels[i]} the other sign"
        yield _Mistake(text, _changed(keys), _picked(keys, flip))
    for kind in kinds:
        for i, j in itertools.combinations(kind, 2):
            order = np.eye(size)[[j if k == i else i if k == j else k for k in range(size)]]
            text = f"is {labels[i]} exchanged with {labels[j]}"
            yield _Mistake(text, _changed(keys), _picked(keys, order))


def _units(
    keys: tuple[str, ...], part: slice, what: str, units: Sequence[tuple[float, str]]
) -> Iterator[_Mistake]:
    """Yield some channels in each of other units."""

    def change(factor: float, run: Run) -> Mapping[str, Array]:
        scale = np.ones(_logged(run, keys[0]).shape[-1])
        scale[part] = factor
        return _picked(keys, np.diag(scale))(run)

    for factor, wording in units:
        yield _Mistake(f"{what} in {wording}", _changed(keys), partial(change, factor))


def _picked(keys: tuple[str, ...], matrix: Array) -> Callable[[Run], dict[str, Array]]:
    """Return signals under a matrix; `weight`, part of w, follows w and wg."""

    def change(run: Run) -> dict[str, Array]:
        new: dict[str, Any] = {k: _logged(run, k) @ matrix.T for k in keys}
        if "weight" in run and ("w" in new or "wg" in new):
            new["weight"] = new.get("w", run["w"]) - new.pop("wg", _logged(run, "wg"))
        return new

    return change


def _logged(run: Run, key: str) -> Array:
    return run["w"] - run["weight"] if key == "wg" else run[key]


def _changed(keys: tuple[str, ...]) -> frozenset[str]:
    return frozenset(keys) | ({"weight"} if "w" in keys or "wg" in keys else set())
