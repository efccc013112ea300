"""Sanity checks of a log: channels exchanged, late, with another sign or in another unit.

Such mistakes are no physics: no effect of the library is meant to explain them, and none may
be named for them. Each is tried, and asked about if the data then agree far better with the
description. Nothing is converted.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ves_gym._util.params import Array, ParameterError
from ves_gym.diagnosis.data.measured_run import Run
from ves_gym.diagnosis.machines.base import WRENCH, Machine, Port, testable
from ves_gym.mechanics.spatial import AXES

_BAD = 0.5  # of a channel's own movement: a residual that no effect of usual size makes
_BADLY = {"servo": 0.15}  # where nothing but a controller known to all is between the signals
_FAR = 0.2  # of it: what is left where a mistake is found
_GOOD = 0.3  # of a channel's movement: more is no agreement
_BETTER = {"admittance": 0.1}  # a computer's law on what it logs: it is right, or another is
_SPOILED = 1.2  # of a residual: others may not get worse
_NOISY = 2.0  # times noise drawn once, which scatters: what is below is no residual
_MOVING = 0.1  # of the largest movement of its kind
_HEARD = 3.0  # times the noise that a movement must have
_LEAST = 0.02  # of a channel's movement: better does not count
_SLOW = ("joint", "platform")  # ports that take a hundred times as long as others
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
_DEGREES, _STANDARD = np.pi / 180, 9.80665
_ANGLE = ((_DEGREES, "degrees, not rad"), (1 / _DEGREES, "rad twice converted from degrees"))
_LENGTH = ((1e-3, "millimetres, not m"), (1e3, "kilometres, not m"))
_FORCE = (
    (1e-3, "mN, not N"),
    (1e3, "kN, not N"),
    (_STANDARD, "kgf, not N"),
)
_TORQUE = (
    (1e-3, "N mm, not N m"),
    (1e-2, "N cm, not N m"),
    (1e3, "kN m, not N m"),
    (_STANDARD, "kgf m, not N m"),
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


@dataclass(frozen=True)
class Question:
    """A mistake that would explain a run."""

    run: str
    text: str  # "tau_1 exchanged with tau_2"
    port: str
    channel: str
    before: float  # residual, in parts of the channel's movement
    after: float

    @property
    def sentence(self) -> str:
        """The question."""
        return (
            f"{self.run}: {self.text}? At port {self.port}, {self.channel}, {self.before:.0%}"
            f" of the signal is not explained as logged, and {self.after:.1%} would not be so;"
            " correct the log or the description, or say --as-logged"
        )


@dataclass(frozen=True)
class _Mistake:
    text: str
    signals: frozenset[str]  # that it changes; none where it is in the description
    change: Change | None = None
    machine: Machine | None = None


def require_as_logged(
    machine: Machine, runs: Sequence[Run], others: Sequence[tuple[str, Machine]] = ()
) -> None:
    """Refuse runs that a mistake would explain far better, as a question.

    Args:
        others: mistakes in the description: what they are, and the machine without.

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
    """Return the mistake that explains a run best, if it does so far better than none.

    Args:
        machine: the description.
        run: as logged.
        others: usual mistakes in the description: wording, and the machine without it.

    Returns:
        The question to ask; None where no mistake stands out.
    """
    ports = testable(machine, [run])
    every = [p.name for p in ports]
    signals = {p.name: p.signal for p in ports}
    tells = {name: _tells(run, signal) for name, signal in signals.items()}
    noise = _noise(machine, run, ports)
    current = _sizes(machine, run, every, tells, noise)
    bad = {name: x > _BADLY.get(name, _BAD) for name, x in current.items()}
    if not any(flags.any() for flags in bad.values()):
        return None
    best: tuple[float, Question] | None = None
    lags = {abs(_lag(machine, run, p, tells[p.name])) for p in ports}
    for mistake in (*_mistakes(machine, run, others), *_late(run, lags)):
        touched = [p for p in ports if not mistake.signals or mistake.signals & set(p.needs)]
        names = [p.name for p in touched if mistake.signals or bad[p.name].any()]
        if not any(bad[name].any() for name in names):
            continue
        changed = run
        if mistake.change is not None:
            changed = run.with_signals(mistake.change(run))
        revised: dict[str, Array] = {}
        for name in sorted(names, key=_SLOW.__contains__):  # most are refuted by others
            revised |= _sizes(mistake.machine or machine, changed, [name], tells, noise)
            if spoiled := (revised[name] > np.maximum(_SPOILED * current[name], _GOOD)).any():
                break
        if spoiled:
            continue
        before, after = (
            np.concatenate([x[name] for name in names]) for x in (current, revised)
        )
        worst = np.concatenate([bad[name] for name in names])
        good = [np.full(len(bad[name]), _BETTER.get(name, _GOOD)) for name in names]
        # a channel that no longer stands out of its noise would agree with anything
        heard = np.concatenate([_tells(changed, signals[name]) for name in names])
        healed = worst & heard & (after < np.minimum(_FAR * before, np.concatenate(good)))
        if not healed.any():
            continue
        gain = float(np.log(np.maximum(before, _LEAST) / np.maximum(after, _LEAST)).sum())
        if best is None or gain > best[0] + 1e-9:
            k = int(np.argmax(np.where(healed, before / np.maximum(after, 1e-9), 0.0)))
            labels = [(p.name, c) for p in touched if p.name in names for c in p.channels]
            port, channel = labels[k]
            values = float(before[k]), float(after[k])
            best = gain, Question(run.name, mistake.text, port, channel, *values)
    return None if best is None else best[1]


def _noise(machine: Machine, run: Run, ports: Sequence[Port]) -> dict[str, Array]:
    """Return (c,) per port: size of what noise as logged makes of the residual."""
    out, logged = {}, replace(run, by_log=True)
    for port in ports:
        copy = logged.with_noise(np.random.default_rng(0), 1, port.exact)
        noisy, plain = (
            machine.residuals(k, [machine.nominal], [port.name])[port.name][0]
            for k in (copy, logged)
        )
        out[port.name] = np.linalg.norm(run.window.spectrum(noisy[0] - plain)[1:], axis=0)
    return out


def _sizes(
    machine: Machine,
    run: Run,
    ports: Sequence[str],
    tells: Mapping[str, Array],
    noise: Mapping[str, Array],
) -> dict[str, Array]:
    """Return (c,) per port: size of the residual beyond its noise, over that of the channel's
    movement; 0 where a channel does not tell anything."""
    # a torque logged in another unit must not be told by what the controller asked
    residuals = machine.residuals(replace(run, by_log=True), [machine.nominal], ports)
    logged_as = {p.name: p.signal for p in machine.ports}
    out = {}
    for name in ports:
        residual_size, signal_size = (
            np.linalg.norm(run.window.spectrum(x)[1:], axis=0)
            for x in (residuals[name][0], _logged(run, logged_as[name]))
        )
        beyond = np.sqrt(np.maximum(residual_size**2 - (_NOISY * noise[name]) ** 2, 0.0))
        size = np.where(np.isfinite(beyond), beyond, np.inf) / np.maximum(signal_size, 1e-300)
        out[name] = np.where(tells[name], size, 0.0)
    return out


def _lag(machine: Machine, run: Run, port: Port, tells: Array) -> int:
    """Return the samples by which a port's signal comes after what it is predicted to be."""
    residual = machine.residuals(replace(run, by_log=True), [machine.nominal], [port.name])
    x = _logged(run, port.signal)
    most = min(round(_LATE[1] / run.dt), run.length // 4)
    likeness = np.zeros(2 * most + 1)
    for signal, left in zip(x.T[tells], residual[port.name][0].T[tells], strict=True):
        a, b = (k - k.mean() for k in (signal, signal - left))
        full = scipy.signal.correlate(a, b) / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-300)
        likeness += full[len(b) - 1 - most : len(b) + most]
    return int(np.argmax(likeness)) - most


def _late(run: Run, lags: Collection[int]) -> Iterator[_Mistake]:
    """Yield each recorder that may be as late, or as early, as a port's signal seems to be."""
    for (keys, name), lag in itertools.product(_RECORDED, sorted(lags)):
        have = tuple(k for k in keys if k in run)
        if not have or lag * run.dt < _LATE[0]:
            continue
        late = f"is {name} {1e3 * lag * run.dt:.3g} ms late"
        yield _Mistake(late, frozenset(have), _put_off(have, lag))
        yield _Mistake(late.replace("late", "early"), frozenset(have), _put_off(have, -lag))


def _put_off(keys: tuple[str, ...], lag: int) -> Change:
    """Return all signals, those of a recorder `lag` samples earlier against the others."""
    early, late = (
        (slice(lag, None), slice(None, -lag))
        if lag > 0
        else (slice(None, lag), slice(-lag, None))
    )
    return lambda run: {k: x[early if k in keys else late] for k, x in run.signals.items()}


def _tells(run: Run, signal: str) -> Array:
    """Return (c,) True for channels of a signal, as logged, that stand out of their noise, and
    do not hardly move beside their kind."""
    x = _logged(run, signal)
    size = np.linalg.norm(run.window.spectrum(x)[1:], axis=0)
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
        yield _Mistake(text, frozenset(), machine=other)
    n = run["q"].shape[1] if "q" in run else 0
    for keys, name in _TOGETHER:
        have = tuple(k for k in keys if k in run)
        if not have or (name != "joint" and name not in have):
            continue
        all_joints = name == "joint"
        labels = [f"joint {i + 1}" if all_joints else f"{name}_{i + 1}" for i in range(n)]
        yield from _orders(have, labels, [range(n)])
        units = (
            _TORQUE + _FORCE[:2] if name == "tau" else () if all_joints else _ANGLE + _LENGTH
        )
        for factor, wording in units:
            yield _scaled(have, slice(None), factor, f"is {name} in {wording}")
            for i in range(n) if n > 1 else ():
                yield _scaled(have, slice(i, i + 1), factor, f"is {labels[i]} in {wording}")
    angles = tuple(k for k in _JOINT[:4] if k in run)
    for factor, wording in _ANGLE if angles else ():
        yield _scaled(angles, slice(None), factor, f"are all joint angles in {wording}")
    for keys, name in ((("y",), "y"), (("y_cmd",), "y_cmd"), (("y", "y_cmd"), "y and y_cmd")):
        if not all(k in run for k in keys):
            continue
        yield from _orders(keys, [f"{name} {a}" for a in AXES], [range(3), range(3, 6)])
        for factor, wording in _LENGTH:
            yield _scaled(keys, slice(0, 3), factor, f"is the position in {name} in {wording}")
        for factor, wording in _ANGLE:
            yield _scaled(keys, slice(3, 6), factor, f"are the angles in {name} in {wording}")
    for keys, name in ((("w",), "w"), (("wg",), "wg"), (("w", "wg"), "w and wg")):
        if "w" not in run or ("wg" in keys and "weight" not in run):
            continue
        yield from _orders(keys, [f"{name} {a}" for a in WRENCH], [range(3), range(3, 6)])
        swapped = [3, 4, 5, 0, 1, 2]
        yield _Mistake(
            f"are forces and moments of {name} exchanged",
            _changed(keys),
            _picked(keys, np.eye(6)[swapped]),
        )
        for factor, wording in _FORCE:
            yield _scaled(keys, slice(0, 3), factor, f"are the forces in {name} in {wording}")
        for factor, wording in _TORQUE:
            yield _scaled(keys, slice(3, 6), factor, f"are the moments in {name} in {wording}")


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


def _scaled(keys: tuple[str, ...], part: slice, factor: float, text: str) -> _Mistake:
    def change(run: Run) -> dict[str, Array]:
        width = _logged(run, keys[0]).shape[-1]
        scale = np.ones(width)
        scale[part] = factor
        return _picked(keys, np.diag(scale))(run)

    return _Mistake(text, _changed(keys), change)


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
