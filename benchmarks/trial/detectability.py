"""How far an effect stands out of noise and tolerances, for the best reader there could be.

A case is sized by its noise alone. Whoever reads it does not know the machine's own numbers
either, and what those may imitate cannot be told from an effect. Here the reader knows the
effect's form and size, and everything about the machine but its tolerances: nobody who reads
the logs can do better. With s the change of all logged numbers by the effect, and J their
changes by one standard deviation of each tolerance, both over the noise, the deviance that the
truth gains is on average

    d^2 = s's - s'J (1 + J'J)^-1 J's,

a matched filter with Gaussian priors (derived in docs/diagnosis-trial.md). That takes every
change for linear. A vehicle whose damping is 28 % less is not: what is curved in s no straight
J reaches, though a tolerance of the damping does all of it. So the tolerances x that imitate
the effect best are found by simulating machines that are off by them, and

    d^2 = min_x |s - r(x) + r(0)|^2 + |x|^2.

Noise is that of the case's family: slow noise is whitened by its covariance, and five degrees
of freedom tell 1.25 times as much as Gaussian noise of the same size (Fisher information of
Student's t). Rounding is left out. In the laboratory the platform goes where the computer sent
it, whatever the reading was, and the log tells where that is: so the commands are held, and
what the sensor's noise does to the vehicle is no part of an effect. Only what is wrong with the
vehicle in the computer is told by its commands. Everything comes from the generator's own
simulation; the diagnosis has no part in it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.linalg as sla

from benchmarks.trial import noise
from benchmarks.trial.arm import Array, arm_bodies
from benchmarks.trial.cases import RUNS, draw, machine_off, noise_std
from benchmarks.trial.hidden import Signals
from benchmarks.trial.imitation import UNIFORM, most_gained, places
from benchmarks.trial.laboratory import estimated_weight
from benchmarks.trial.space import Run
from benchmarks.trial.write import Setting, add_effect, play, setting

CHANNELS = ("q", "v", "tau", "y", "y_cmd", "w")  # the weight's estimate is seen in w - wg
HEAVY = 1.25  # Fisher information of the heavy noise, that of Gaussian noise being 1
FITTED = RUNS - 1  # the last run is held back
WEIGHTS = 40  # instants at which the noise of a weight is drawn
_ROUNDS, _HALVINGS = 6, 3
_ENOUGH = 0.02  # of what is left: a round that takes less off is the last


@dataclass(frozen=True)
class Detectability:
    """Deviance that the truth gains: over noise alone, and beside the tolerances."""

    noise: float
    tolerances: float
    most: float  # that any runs could show, see `imitation`
    unknown: int  # tolerances


def off_by(at: Setting, x: Array) -> Setting:
    """Return a machine that is off by x (p,) standard deviations of its tolerances.

    The clock comes after them, and is left out: it moves no sample.
    """
    drawn = [0]

    def take(half: float, size: int | None) -> Any:
        count = 1 if size is None else size
        here = np.zeros(count)
        mine = x[drawn[0] : drawn[0] + count]
        here[: len(mine)] = mine
        drawn[0] += count
        out = half / UNIFORM * here
        return out if size is not None else float(out[0])

    plant, servo, clock = machine_off(at.case, at.description, take)
    return replace(at, plant=plant, servo=servo, clock=clock)


class Reader:
    """What a case's logs say of a machine, over their noise.

    Args:
        described: the machine.
        held: in the laboratory the platform goes where it was sent on this machine.
    """

    def __init__(self, described: Setting, held: bool) -> None:
        logs = [play(described, described.plant, run) for run in range(FITTED)]
        self.led = logs if held else [None] * FITTED
        self.weight = [weight_noise(described, k) if k.wg is not None else None for k in logs]

    def __call__(self, at: Setting) -> Array:
        """Return every logged number over its noise, runs and channels one after another."""
        std, out = noise_std(at.case.arm), []
        for run, (led, weight) in enumerate(zip(self.led, self.weight, strict=True)):
            logged = play(at, at.plant, run, led=led)
            rows = [(getattr(logged, name), std[name]) for name in CHANNELS]
            if logged.wg is not None and weight is not None:
                rows.append((logged.w - logged.wg, weight))
            dt = float(logged.t[1] - logged.t[0])
            out += [
                whitened(at.case.noise, values / size, dt).ravel()
                for values, size in rows
                if values is not None
            ]
        return np.concatenate(out)


class Sensitivity:
    """What the tolerances of a machine do to its logs.

    Args:
        described: the machine.
        held: see `Reader`.
        p: count of its tolerances.
    """

    def __init__(self, described: Setting, held: bool, p: int) -> None:
        self.described, self.read = described, Reader(described, held)
        self.nominal = self.read(described)
        self.J = np.stack([self.changed(x) for x in np.eye(p)], axis=1)

    def changed(self, x: Array) -> Array:
        """Return the change (N,) by tolerances x (p,), in standard deviations each."""
        return self.read(off_by(self.described, x)) - self.nominal


def weight_noise(at: Setting, run: Run) -> Array:
    """Return (6,) what the noise of angles and pose makes of the weight they lead to [N, N m].

    Args:
        at: the machine.
        run: without noise.
    """
    arm, std = arm_bodies(at.description["arm"]), noise_std(at.case.arm)
    rng = np.random.default_rng(0)
    rows = []
    for k in np.linspace(0, len(run.t) - 1, WEIGHTS).astype(int):
        q, y = run.q[k], run.y[k]
        other = (x + rng.standard_normal(len(x)) * s for x, s in ((q, std["q"]), (y, std["y"])))
        plain, noisy = (
            estimated_weight(arm, *pose, Signals()) for pose in ((q, y), tuple(other))
        )
        rows.append(noisy - plain)
    return np.asarray(np.sqrt(np.mean(np.square(rows), axis=0)) + 1e-3 * std["w"])


def whitened(family: str, x: Array, dt: float) -> Array:
    """Return channels (T, c) over noise of unit size so that the noise is white.

    Args:
        family: of the noise.
        x: over the noise's standard deviation.
        dt: s between samples.
    """
    if family == "heavy":
        return x * np.sqrt(HEAVY)
    if family != "slow":
        return x
    return np.asarray(sla.solve_triangular(_root(len(x), round(dt, 9)), x, lower=True))


@lru_cache(maxsize=4)
def _root(length: int, dt: float) -> Array:
    """Return the lower root (T, T) of the covariance of slow noise of unit size."""
    apart = dt * np.arange(length)
    covariance = sum(share * np.exp(-apart / time) for time, share in noise.SLOW)
    return np.asarray(np.linalg.cholesky(sla.toeplitz(covariance)))


def beside(s: Array, J: Array, changed: Callable[[Array], Array] | None = None) -> float:
    """Return the deviance that a change gains beside tolerances.

    Args:
        s: (N,) change by the effect.
        J: (N, p) changes by one standard deviation of each tolerance.
        changed: gives the change (N,) by tolerances x (p,) as it is; None: J x.
    """
    change = changed or (lambda x: J @ x)
    inner = J.T @ J + np.eye(J.shape[1])
    best, left, least = np.zeros(J.shape[1]), s, float(s @ s)
    for _ in range(_ROUNDS):  # with the first J all along
        step = np.linalg.solve(inner, J.T @ left - best)
        before = least
        for halving in range(_HALVINGS):
            tried = best + step / 2**halving
            over = s - change(tried)
            cost = float(over @ over + tried @ tried)
            if cost < least:
                best, left, least = tried, over, cost
                break
        if before - least < _ENOUGH * least:
            break
    return least


def detectability(secret: str, label: dict[str, Any]) -> list[Detectability]:
    """Return that of each effect of a case, the others absent.

    Args:
        secret: of the set.
        label: of the case, for the sizes of its effects.
    """
    case = draw(secret, label["index"])
    described = setting(secret, case)
    p = places(described.plant.joints)["end"]
    described = off_by(described, np.zeros(p))
    peaks = np.max([np.abs(play(described, described.plant, r).tau).max(0) for r in (0, 1)], 0)
    sensitivity = lru_cache(lambda held: Sensitivity(described, held, p))
    out = []
    for which, effect in enumerate(label["effects"]):
        in_computer = case.kinds[which].startswith("base/")
        known = sensitivity(case.mode == "emulated" and not in_computer)
        plant = described.plant.copy()
        plant.peaks = peaks
        add_effect(plant, case, which, effect["size"])
        s = known.read(replace(described, plant=plant)) - known.nominal
        gained = beside(s, known.J, known.changed)
        out.append(
            Detectability(float(s @ s), gained, most_gained(case, which, effect["size"]), p)
        )
    return out
