"""`fit`: the numbers of some effects, together, that leave the least unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym.core.effect import Effect
from ves_gym.core.params import Array
from ves_gym.discrepancy.candidates import Candidate
from ves_gym.discrepancy.evidence import Evidence
from ves_gym.discrepancy.groups import Solution, products, solve

_STEP = 1e-3  # of differences, in parts of a number's usual size
_ROUNDS, _HALVINGS = 12, 4
_REMEMBERED = 600  # residuals of a port
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
    tangents: Array  # (N, sum of k)

    @property
    def k(self) -> int:
        """Free numbers in all."""
        return sum(c.k for c in self.candidates)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects."""
        return tuple(c.effect(v) for c, v in zip(self.candidates, self.values, strict=True))

    @property
    def on_bound(self) -> bool:
        """Whether a number ended at the edge of its range."""
        return any(
            bool(((v <= np.array(c.low)) | (v >= np.array(c.high))).any())
            for c, v in zip(self.candidates, self.values, strict=True)
        )


def fit(evidence: Evidence, candidates: Sequence[Candidate], start: Sequence[Array]) -> Fit:
    """Gauss-Newton with halved steps, nuisances and group sizes eliminated in every round."""
    p = len(evidence.nuisances)
    if not candidates:
        none = np.zeros((evidence.size, 0))
        found = solve(products(evidence, evidence.null, none), p)
        return Fit((), (), found.deviance, (), found.size, found.x, evidence.null, none)
    low = np.concatenate([c.low for c in candidates])
    high = np.concatenate([c.high for c in candidates])
    usual = np.concatenate([np.abs(c.starts[0]) for c in candidates])
    step = _STEP * np.maximum(usual, 1e-12)
    edges = np.cumsum([c.k for c in candidates])[:-1]
    x = np.clip(np.concatenate(list(start)), low, high)

    def residuals(points: Sequence[Array]) -> Array:
        return residuals_of(evidence, candidates, [np.split(x, edges) for x in points])

    def judged(z: Array) -> Solution:
        return solve(products(evidence, z, np.zeros((len(z), 0))), p)

    z = residuals([x])[0]
    now = judged(z)
    for _ in range(_ROUNDS):
        ways = np.where(x + step > high, -step, step)  # differences stay inside
        moved = residuals(
            [x + way * unit for way, unit in zip(ways, np.eye(len(x)), strict=True)]
        )
        S = ((moved - z) / ways[:, None]).T
        found = solve(products(evidence, z, S), p, low - x, high - x)
        toward = found.x[p:]
        better = None
        for halving in range(_HALVINGS):
            y = np.clip(x + toward / 2**halving, low, high)
            tried = residuals([y])[0]
            then = judged(tried)
            if then.deviance < now.deviance:
                better = y, tried, then
                break
        if better is None:
            break
        gained = now.deviance - better[2].deviance
        x, z, now = better
        if gained < _ENOUGH:
            break
    deviation = np.sqrt(np.maximum(np.diag(found.covariance)[p:], 0.0))
    return Fit(
        candidates=tuple(candidates),
        values=tuple(np.split(x, edges)),
        deviance=now.deviance,
        std=tuple(np.split(deviation, edges)),
        size=now.size,
        nuisances=now.x,
        residual=z,
        tangents=S,
    )


def residuals_of(
    evidence: Evidence, candidates: Sequence[Candidate], points: Sequence[Sequence[Array]]
) -> Array:
    """(m, N) residuals under m sets of numbers; a port is asked about its own effects only."""
    out = np.tile(evidence.null, (len(points), 1))
    effects = [
        [c.effect(v) for c, v in zip(candidates, values, strict=True)] for values in points
    ]
    for port in (p.name for p in evidence.ports):
        here = [k for k, c in enumerate(candidates) if port in c.ports]
        if here:
            sets = [tuple(row[k] for k in here) for row in effects]
            out[:, evidence.part(port)] = _residuals_at(evidence, port, sets)
    return out


def _residuals_at(evidence: Evidence, port: str, sets: Sequence[tuple[Effect, ...]]) -> Array:
    """Residuals of a port, each set of effects evaluated once for all fits."""
    memory = evidence.memory
    missing = [k for k in dict.fromkeys(sets) if (port, k) not in memory]
    if missing:
        models = [evidence.machine.model(k) for k in missing]
        for key, row in zip(missing, evidence.residual_at(port, models), strict=True):
            memory[port, key] = row
    out = np.stack([memory[port, k] for k in sets])
    while len(memory) > _REMEMBERED:
        memory.pop(next(iter(memory)))
    return out
