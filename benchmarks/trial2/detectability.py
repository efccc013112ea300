"""How far an effect stands out of noise and tolerances, for the best reader there could be.

A case is sized by its noise alone. Whoever reads it does not know the machine's own numbers
either, and what those may imitate cannot be told from an effect. Here the reader knows the
effect's form and size, and everything about the machine but its tolerances, noise is white and
channels are independent: nobody who reads the logs can do better. With s the change of all
logged numbers by the effect, and J their changes by one standard deviation of each tolerance,
both over the noise, the deviance that the truth gains is on average

    d^2 = s's - s'J (1 + J'J)^-1 J's,

a matched filter with Gaussian priors (derived in docs/diagnosis-benchmark.md). Everything comes
from the generator's own simulation; the diagnosis has no part in it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.trial2.arm import Array
from benchmarks.trial2.cases import RUNS, draw, machine_off, noise_std
from benchmarks.trial2.write import Setting, add_effect, play, setting

UNIFORM = 3**0.5  # half-widths in a standard deviation
CHANNELS = ("q", "v", "tau", "y", "y_cmd", "w", "wg")  # as gaps are measured by
FITTED = RUNS - 1  # the last run is held back


@dataclass(frozen=True)
class Detectability:
    """Deviance that the truth gains: over noise alone, and beside the tolerances."""

    noise: float
    tolerances: float
    unknown: int  # tolerances


def _one_off(k: int) -> tuple[Any, list[int]]:
    """Return a draw that is zero but for the k-th number, and the count of numbers drawn."""
    drawn = [0]

    def take(half: float, size: int | None) -> Any:
        here = k - drawn[0]
        drawn[0] += 1 if size is None else size
        if size is None:
            return half / UNIFORM if here == 0 else 0.0
        out = np.zeros(size)
        if 0 <= here < size:
            out[here] = half / UNIFORM
        return out

    return take, drawn


def _machines(at: Setting) -> Iterator[Setting]:
    """The machine as described, then off by one standard deviation of each tolerance."""
    k, count = -1, 0
    while k < count:
        take, drawn = _one_off(k)
        plant, servo, clock = machine_off(at.case, at.description, take)
        count = drawn[0] - 1  # the clock comes last, and is left out: it moves no sample
        if k < count:
            yield replace(at, plant=plant, servo=servo, clock=clock)
        k += 1


def _readings(at: Setting) -> Array:
    """Return every logged number over its noise, runs and channels one after another."""
    std, out = noise_std(at.case.arm), []
    for run in range(FITTED):
        logged = play(at, at.plant, run)
        rows = [(name, getattr(logged, name)) for name in CHANNELS]
        out += [(values / std[name]).ravel() for name, values in rows if values is not None]
    return np.concatenate(out)


def beside(s: Array, J: Array) -> float:
    """Return the deviance that a change s (N,) gains beside tolerances of changes J (N, p)."""
    across = J.T @ s
    inside = J.T @ J + np.eye(J.shape[1])
    return float(s @ s - across @ np.linalg.solve(inside, across))


def detectability(secret: str, label: dict[str, Any]) -> list[Detectability]:
    """Return that of each effect of a case, the others absent.

    Args:
        secret: of the set.
        label: of the case, for the sizes of its effects.
    """
    case = draw(secret, label["index"])
    described, *off = _machines(setting(secret, case))
    nominal = _readings(described)
    peaks = np.max([np.abs(play(described, described.plant, r).tau).max(0) for r in (0, 1)], 0)
    J = np.stack([_readings(machine) - nominal for machine in off], axis=1)
    out = []
    for which, effect in enumerate(label["effects"]):
        plant = described.plant.copy()
        plant.peaks = peaks
        add_effect(plant, case, which, effect["size"])
        s = _readings(replace(described, plant=plant)) - nominal
        out.append(Detectability(float(s @ s), beside(s, J), J.shape[1]))
    return out
