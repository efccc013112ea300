"""Law of the best gain that a whole library has from noise and tolerances alone.

A parametric bootstrap of the null hypothesis, per case. To first order a candidate's score is
linear in the whitened residual, so a residual drawn under the fitted null model (noise of the
sizes that the groups have, tolerances by their priors) need not be drawn at all: scores are
normal, with a covariance that follows from the products of the signatures. A draw of all scores
costs a matrix product, and of each the least tail probability of any candidate is kept: the law
of what is best among everything that was looked at, correlations and grids of shapes included
(Westfall and Young, Resampling-Based Multiple Testing, 1993: single-step min P).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.signatures import Signatures

_DRAWS = 2000
_TAIL = 20  # draws below which the tail goes on as that of independent tests
_UNSEEN = 1e-5  # of a signature's square that tolerances leave: single precision holds no less
_NOTHING = 1e-6  # variances of noise: what an effect of its usual size must do to be looked at
_JITTER = 1e-5


@dataclass(frozen=True)
class NullLaw:
    """Law of the least tail probability of any candidate where nothing is missing."""

    tests: int  # scores that were looked at
    least: tuple[float, ...] = ()  # of each draw, ascending; none: tests as if independent

    def chance(self, gain: float, candidate: Candidate) -> float:
        """Return the chance that the best of the library gains as much from noise.

        Args:
            gain: of the candidate, in deviance.
            candidate: that gains it; more free numbers gain more from noise.
        """
        a = _tail(candidate) * float(scipy.stats.chi2.sf(max(gain, 0.0), _numbers(candidate)))
        edge, alike = self._edge()
        if a <= edge:
            p = min(-np.expm1(alike * np.log1p(-min(a, 1 - 1e-16))), self.tests * a)
        else:
            p = (np.searchsorted(self.least, a, side="right") + 1) / (len(self.least) + 1)
        return float(min(p, 1.0))

    def _edge(self) -> tuple[float, float]:
        """Tail probability where the draws get few, and independent tests that have as many."""
        if len(self.least) <= _TAIL:
            return 1.0, float(self.tests)
        edge = min(max(self.least[_TAIL - 1], 1e-300), 0.5)
        return edge, float(np.log1p(-_TAIL / len(self.least)) / np.log1p(-edge))


def null_law(
    signatures: Signatures, size: Array, seed: int = 0, draws: int = _DRAWS
) -> NullLaw:
    """Return the law of the best gain of a library on the runs of its signatures.

    Args:
        signatures: of the library.
        size: (G,) mean squares of the groups under the null model.
        seed: of the draws.
        draws: scores drawn.
    """
    curvature, covariance = signatures.score_law(size)
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    square = np.diag(curvature)
    beyond = square > _UNSEEN * signatures.squares(size)
    observable = np.flatnonzero(beyond & (square * signatures.usual**2 > _NOTHING))
    if not len(observable):
        return NullLaw(max(len(signatures.blocks), 1))
    C = covariance[np.ix_(observable, observable)] / np.outer(
        scale[observable], scale[observable]
    )
    value, vector = np.linalg.eigh(C)
    root = vector * np.sqrt(np.maximum(value, _JITTER * value[-1]))
    rng = np.random.default_rng([seed, 5])
    g = np.zeros((len(scale), draws))
    g[observable] = (root @ rng.standard_normal((len(observable), draws))) * scale[
        observable, None
    ]
    least = np.ones(draws)
    tests = 0
    visible = set(observable.tolist())
    for block in signatures.blocks:
        at = [c for c in block.columns if c in visible]
        if not at:
            continue
        tests += 1
        candidate = signatures.candidates[block.candidate]
        if _tail(candidate) < 1:  # a size that has one sign
            way = 1.0 if candidate.sets_in or candidate.low[block.free[0]] >= 0 else -1.0
            gain = np.maximum(-way * g[at[0]], 0.0) ** 2 / curvature[at[0], at[0]]
        else:
            A = curvature[np.ix_(at, at)]
            A = A + 1e-9 * np.diag(np.diag(A))
            gain = np.einsum("id,id->d", g[at], np.linalg.solve(A, g[at]))
        tail = _tail(candidate) * scipy.stats.chi2.sf(gain, _numbers(candidate))
        least = np.minimum(least, np.where(gain > 0, tail, 1.0))
    return NullLaw(tests, tuple(np.sort(least).tolist()))


def _numbers(candidate: Candidate) -> int:
    """Count of numbers that a score chooses; a search over shapes is in the law."""
    return 1 if candidate.sets_in else max(len(candidate.factors), 1)


def _tail(candidate: Candidate) -> float:
    """One half where the only size has one sign: noise asks for the other as often."""
    if candidate.sets_in:
        return 0.5
    if len(candidate.factors) != 1:
        return 1.0
    k = candidate.factors[0]
    return 0.5 if candidate.low[k] >= 0 or candidate.high[k] <= 0 else 1.0
