"""`fit`: the numbers of some effects, together, that leave the least unexplained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import CLEAR
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.evidence import laplace
from ves_gym.diagnosis.inference.variance_groups import Solution, products, solve
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.system.effect import Effect

_STEP = 1e-3  # of differences, in parts of a number's usual size
_ROUNDS, _HALVINGS = 12, 4
_MORE, _FAR = 40, 10.0  # rounds of a fit whose last one gained so much in deviance
_UNSEEN = 1e-3  # of a whitened residual, by all of a number's range
_TORQUES = ("joint",)  # ports of a law that is a torque at joints, and no more
_REMEMBERED = 600  # residuals of a port
# What repeats turns and changes its curvature within any half a period: with a margin, so much
# of one tells it from curves that do neither, such as a spring that hardens.
_PERIODS = 2 / 3
_SHARES = tuple(0.7**k for k in range(1, 9))  # of a size that fits best
_TIMES = (2.0, 4.0, 8.0)  # a damping that fits best
_LITTLE = 0.25  # of its usual size: for what one is taken that fits best at none
_ENOUGH = 0.05  # gain in deviance that is not worth another round


@dataclass(frozen=True, eq=False)
class Fit:
    """Effects with their most probable numbers."""

    candidates: tuple[Candidate, ...]
    values: tuple[Array, ...]  # (k,) each
    deviance: float
    std: tuple[Array, ...]  # (k,) standard deviations
    size: Array  # (G,) mean square left in each group
    nuisances: Array  # (p,) in units of their usual size
    residual: Array  # (N,)
    tangents: Array  # (N, b + sum of k); other forms of the effects first
    forms: Array = field(default_factory=lambda: np.zeros(0))  # (b,) share of each other form
    evidence: float = np.inf  # -2 log p(data), the choice of names not counted

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects."""
        return tuple(c.effect(v) for c, v in zip(self.candidates, self.values, strict=True))

    def on_bound(self, i: int) -> bool:
        """Return True if a size of the effect in place i ended at the edge of its range.

        A part that a cause does not have is at zero, which is no edge of the cause; and where
        coordinates are chosen among several, those about which the runs say nothing are none
        of it.
        """
        c, at = self.candidates[i], list(self.candidates[i].factors)
        if c.sparse and not c.parts:
            at = [k for k in at if self.clear(i)[k]]
        v, low, high = self.values[i][at], np.array(c.low)[at], np.array(c.high)[at]
        least = v <= low
        absent = least & (low == 0) if c.parts and not least.all() else np.zeros_like(least)
        return bool(((least & ~absent) | (v >= high)).any())

    def is_told(self, i: int) -> bool:
        """Return True if the runs can tell the numbers of the effect in place i.

        No size ended at the edge of its range, and what repeats has been through so much of a
        period that it is not a part of any curve.
        """
        periods = self.candidates[i].periods
        return not self.on_bound(i) and (periods is None or periods(self.values[i]) >= _PERIODS)

    def clear(self, i: int) -> Array:
        """Return (k,) which numbers of the effect in place i are clearly not zero."""
        return np.asarray(np.abs(self.values[i]) > CLEAR * self.std[i])


def fit(
    residuals: WhitenedResiduals, candidates: Sequence[Candidate], start: Sequence[Array]
) -> Fit:
    """Fit effects by Gauss-Newton with halved steps, maximising the profile likelihood.

    Nuisances and the sizes of the groups are eliminated in every round.

    Args:
        residuals: whitened, N numbers.
        candidates: effects to fit together.
        start: (k,) numbers of each.
    """
    p = len(residuals.nuisances)
    if not candidates:
        none = np.zeros((residuals.length, 0))
        solution = solve(products(residuals, residuals.null, none), p)
        likely = laplace(solution.deviance, solution.covariance, solution.x, (), (), ())
        return Fit(
            *((), (), solution.deviance, (), solution.size, solution.x, residuals.null, none),
            evidence=likely,
        )
    low = np.concatenate([c.low for c in candidates])
    high = np.concatenate([c.high for c in candidates])
    usual = np.concatenate([np.abs(c.starts[0]) for c in candidates])
    step = _STEP * np.maximum(usual, 1e-12)
    edges = np.cumsum([c.k for c in candidates])[:-1]
    chosen = np.concatenate([np.full(c.k, c.sparse) for c in candidates])
    x = np.clip(np.concatenate(list(start)), low, high)
    spread: Array = np.diag(np.maximum(usual, 1e-12) ** 2)
    x = _feasible(candidates, x, spread)

    def residuals_at(points: Sequence[Array]) -> Array:
        return evaluate_residuals(residuals, candidates, [np.split(x, edges) for x in points])

    def blurs(x: Array, z: Array, before: Array | None = None) -> Array:
        return _changes_of_form(residuals, candidates, np.split(x, edges), z, before)

    def judged(x: Array, z: Array, B: Array) -> Solution:
        return solve(products(residuals, z, B), p + B.shape[1])

    def tangents(x: Array, z: Array, B: Array, share: Array) -> Array:
        ways = np.where(x + step > high, -step, step)  # differences stay inside
        moved = residuals_at(
            [x + way * unit for way, unit in zip(ways, np.eye(len(x)), strict=True)]
        )
        if share.any():  # a number acts through the forms that its effect has, too
            points = x + np.diag(ways)
            beside = [blurs(y, m, B) @ share for y, m in zip(points, moved, strict=True)]
            moved = moved + np.stack(beside)
        return np.asarray(((moved - z - B @ share) / ways[:, None]).T)

    z = residuals_at([x])[0]
    B = blurs(x, z)
    current = judged(x, z, B)
    for turn in range(_MORE):
        S = tangents(x, z, B, current.x[p:])
        b = p + B.shape[1]
        solution = solve(products(residuals, z, np.hstack([B, S])), b, low - x, high - x)
        toward = solution.x[b:]
        # directions that change nothing stay as described
        idle = chosen & (np.linalg.norm(S, axis=0) * np.abs(high - low) < _UNSEEN)
        toward = np.where(idle, np.clip(0.0, low, high) - x, toward)
        if any(c.feasible for c in candidates):
            goal = np.clip(x + toward, low, high)
            toward = _feasible(candidates, goal, solution.covariance[b:, b:]) - x
        better = None
        for halving in range(_HALVINGS):
            y = np.clip(x + toward / 2**halving, low, high)
            trial = residuals_at([y])[0]
            forms = blurs(y, trial, B if turn > 1 else None)
            proposed = judged(y, trial, forms)
            if proposed.misfit < current.misfit:
                better = y, trial, proposed, forms
                break
        if better is None:
            break
        gained = current.misfit - better[2].misfit
        x, z, current, B = better
        if gained < (_ENOUGH if turn + 1 < _ROUNDS else _FAR):
            break
    gentler = _gentler(candidates, x, low, high) if current.deviance > current.misfit else ()
    quieter = False
    for y in gentler:
        trial = residuals_at([y])[0]
        forms = blurs(y, trial)
        proposed = judged(y, trial, forms)
        if proposed.deviance < current.deviance:
            x, z, current, B, quieter = y, trial, proposed, forms, True
    if quieter:
        S = tangents(x, z, B, current.x[p:])
        solution = solve(products(residuals, z, np.hstack([B, S])), b, low - x, high - x)
    deviation = np.sqrt(np.maximum(np.diag(solution.covariance)[b:], 0.0))
    values, std = tuple(np.split(x, edges)), tuple(np.split(deviation, edges))
    return Fit(
        candidates=tuple(candidates),
        values=values,
        deviance=current.deviance,
        std=std,
        size=current.size,
        nuisances=current.x[:p],
        residual=z,
        tangents=np.hstack([B, S]),
        forms=current.x[p:],
        evidence=laplace(
            current.deviance, solution.covariance, current.x, candidates, values, std
        ),
    )


def _gentler(candidates: Sequence[Candidate], x: Array, low: Array, high: Array) -> list[Array]:
    """Return numbers by which effects pass on less noise than by those that fit best.

    Numbers are fitted to what comes on top of the noise, but no name is likelier by the noise
    that it makes. Of what sets in with the noise, such as play, these are smaller sizes. (Of a
    limit they are harder ones: the likeliest is kept, whichever it is.) A spring that swings in
    the band multiplies the noise of an angle, and logs hardly tell by how much it is damped:
    more damping leaves less.

    Args:
        candidates: effects.
        x: (sum of k,) numbers.
        low, high: (sum of k,) their bounds.
    """
    out, at = [], 0

    def add(k: int, value: float) -> None:
        y = x.copy()
        y[k] = np.clip(value, low[k], high[k])
        out.append(y)

    for c in candidates:
        if c.sets_in:
            for share in _SHARES:
                add(at, share * x[at])
        for k in c.quiets:
            for times in _TIMES:
                add(at + k, times * max(x[at + k], _LITTLE * c.starts[0][k]))
        at += c.k
    return out


def _feasible(candidates: Sequence[Candidate], x: Array, covariance: Array) -> Array:
    """Return the numbers with those of each candidate put to the nearest that can be.

    Args:
        candidates: effects.
        x: (sum of k,) numbers.
        covariance: (sum of k, sum of k).
    """
    out, at = x.copy(), 0
    for c in candidates:
        block = slice(at, at + c.k)
        if c.feasible is not None:
            precision = np.asarray(np.linalg.pinv(covariance[block, block]), float)
            out[block] = np.clip(c.feasible(x[block], precision), c.low, c.high)
        at += c.k
    return out


def columns_of(residuals: WhitenedResiduals, candidate: Candidate) -> Array:
    """Return (N, k): what 1 of each number of a candidate adds to whitened residuals.

    Args:
        residuals: of the description.
        candidate: whose effect is linear in its numbers.
    """
    models = [residuals.machine.model([candidate.effect(x)]) for x in np.eye(candidate.k)]
    return (residuals.under(models, candidate.ports) - residuals.null).T


def linearised(
    residuals: WhitenedResiduals, candidates: Sequence[Candidate], values: Sequence[Array]
) -> tuple[Array, Array]:
    """Return the residual under effects, and its tangents as `Fit` has them.

    Args:
        residuals: whitened, N numbers.
        candidates: effects.
        values: (k,) numbers of each.

    Returns:
        (N,) and (N, b + sum of k).
    """
    z = evaluate_residuals(residuals, candidates, [values])[0]
    columns = list(_changes_of_form(residuals, candidates, values, z).T)
    for k, c in enumerate(candidates):
        for i in range(c.k):
            step = _STEP * max(abs(c.starts[0][i]), 1e-12)
            way = -step if values[k][i] + step > c.high[i] else step
            moved = [np.array(v, float) for v in values]
            moved[k][i] += way
            columns.append((evaluate_residuals(residuals, candidates, [moved])[0] - z) / way)
    return z, np.stack(columns, axis=1) if columns else np.zeros((len(z), 0))


def _changes_of_form(
    residuals: WhitenedResiduals,
    candidates: Sequence[Candidate],
    values: Sequence[Array],
    z: Array,
    before: Array | None = None,
) -> Array:
    """Return (N, b) changes by another form of each effect; each may be there in part.

    Those of what sets in or moves links take long, and change little: they are as `before`, if
    it is given.
    """
    forms = [(k, blur) for k, c in enumerate(candidates) for blur in c.blurs]
    if not forms:
        return np.zeros((len(z), 0))
    columns = [
        before[:, j]
        if before is not None and (candidates[k].sets_in or candidates[k].ports != _TORQUES)
        else _residual_of_form(residuals, candidates, values, k, blur) - z
        for j, (k, blur) in enumerate(forms)
    ]
    return np.stack(columns, axis=1)


def _residual_of_form(
    residuals: WhitenedResiduals,
    candidates: Sequence[Candidate],
    values: Sequence[Array],
    k: int,
    blur: Callable[[Any], Any],
) -> Array:
    """Return (N,) residual with the k-th effect in another form."""
    effects = [c.effect(v) for c, v in zip(candidates, values, strict=True)]
    out = evaluate_residuals(residuals, candidates, [values])[0]
    for port in (p.name for p in residuals.ports if p.name in candidates[k].ports):
        at_port = [
            blur(e) if j == k else e
            for j, (c, e) in enumerate(zip(candidates, effects, strict=True))
            if port in c.ports
        ]
        out[residuals.span(port)] = _evaluate_port(residuals, port, [tuple(at_port)])[0]
    return out


def evaluate_residuals(
    residuals: WhitenedResiduals,
    candidates: Sequence[Candidate],
    points: Sequence[Sequence[Array]],
) -> Array:
    """Return whitened residuals under sets of numbers; a port sees its own effects only.

    Args:
        residuals: of the description.
        candidates: effects.
        points: m times the numbers (k,) of each.

    Returns:
        (m, N).
    """
    out = np.tile(residuals.null, (len(points), 1))
    effects = [
        [c.effect(v) for c, v in zip(candidates, values, strict=True)] for values in points
    ]
    for port in (p.name for p in residuals.ports):
        active = [k for k, c in enumerate(candidates) if port in c.ports]
        if active:
            sets = [tuple(row[k] for k in active) for row in effects]
            out[:, residuals.span(port)] = _evaluate_port(residuals, port, sets)
    return out


def _evaluate_port(
    residuals: WhitenedResiduals, port: str, sets: Sequence[tuple[Effect, ...]]
) -> Array:
    """Return residuals of a port, each set of effects evaluated once for all fits."""
    memory = residuals.memory
    missing = [k for k in dict.fromkeys(sets) if (port, k) not in memory]
    if missing:
        models = [residuals.machine.model(k) for k in missing]
        for key, row in zip(missing, residuals.at_port(port, models), strict=True):
            memory[port, key] = row
    out = np.stack([memory[port, k] for k in sets])
    while len(memory) > _REMEMBERED:
        memory.pop(next(iter(memory)))
    return out


def fit_residual(residuals: WhitenedResiduals, f: Fit, fitted: bool) -> Array:
    """Return what a fit leaves of residuals, tolerances and forms of its laws as it has them.

    Args:
        residuals: of the runs fitted, or of others.
        f: fit.
        fitted: on these runs; else what single runs have of their own is fitted to them.

    Returns:
        (N,) whitened.
    """
    z = evaluate_residuals(residuals, f.candidates, [f.values])[0]
    if len(f.forms):
        z = z + _changes_of_form(residuals, f.candidates, f.values, z) @ f.forms
    return residuals.less_nuisances(z, f.nuisances, fitted)
