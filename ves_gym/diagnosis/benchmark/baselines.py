"""Simpler methods on the same residuals: baselines of the blind benchmark.

They fit the signatures to the whitened residuals by plain least squares, without sizes of
groups or a threshold for the whole library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.signatures import SignatureBlock, Signatures
from ves_gym.diagnosis.inference.variance_groups import InnerProducts, solve
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

MOST = 3  # effects


@dataclass(frozen=True)
class BaselineEffect:
    """A candidate with its numbers (k,)."""

    candidate: Candidate
    values: Array


class Baselines:
    """Least squares of the residual under the nominal description.

    With `tolerances`, small errors of the description are fitted along, at a unit prior each.
    """

    def __init__(
        self, residuals: WhitenedResiduals, signatures: Signatures, tolerances: bool = False
    ) -> None:
        self._signatures, self._n = signatures, residuals.size
        rows = residuals.measured
        z, X = residuals.null[rows], signatures.columns[rows]
        self._zz = float(z @ z)
        self._xz = np.asarray(X.T @ z.astype(X.dtype), float)
        self._xx = np.asarray(X.T @ X, float)
        if tolerances:
            J = residuals.slopes[rows]
            xj = np.asarray(X.T @ J.astype(X.dtype), float)
            inside, jz = J.T @ J + np.eye(J.shape[1]), J.T @ z
            self._zz -= float(jz @ np.linalg.solve(inside, jz))
            self._xz -= xj @ np.linalg.solve(inside, jz)
            self._xx -= xj @ np.linalg.solve(inside, xj.T)

    def smallest_error(self) -> tuple[BaselineEffect, ...]:
        """Return the one candidate that leaves the least error; there always is one."""
        fits = [(self._fit((block,)), block) for block in self._signatures.blocks]
        (_, x), block = min(fits, key=lambda f: f[0][0])
        return self._named((block,), x)

    def stepwise(self) -> tuple[BaselineEffect, ...]:
        """Select forward while n log(error) + k log(n) falls, up to three effects."""
        chosen: tuple[SignatureBlock, ...] = ()
        best = self._criterion(self._zz, 0)
        values = np.zeros(0)
        while len(chosen) < MOST:
            taken = {s.candidate for s in chosen}
            tried = []
            for block in self._signatures.blocks:
                if block.candidate not in taken:
                    extended = (*chosen, block)
                    error, x = self._fit(extended)
                    k = sum(self._signatures.candidates[s.candidate].k for s in extended)
                    tried.append((self._criterion(error, k), extended, x))
            if not tried:
                break
            cheapest = min(tried, key=lambda t: t[0])
            if cheapest[0] >= best:
                break
            best, chosen, values = cheapest
        return self._named(chosen, values)

    def _criterion(self, error: float, k: int) -> float:
        return self._n * math.log(max(error, 1e-300)) + k * math.log(self._n)

    def _fit(self, blocks: tuple[SignatureBlock, ...]) -> tuple[float, Array]:
        """Return the sum of squares left, and the numbers within their ranges."""
        at = [c for s in blocks for c in s.columns]
        bounds = [(self._signatures.candidates[s.candidate], i) for s in blocks for i in s.free]
        low = np.array([c.low[i] for c, i in bounds])
        high = np.array([c.high[i] for c, i in bounds])
        products = InnerProducts(
            np.array([float(self._n)]),
            np.array([self._zz]),
            self._xz[None, at],
            self._xx[np.ix_(at, at)][None],
        )
        solution = solve(products, 0, low, high)
        return float(solution.size[0]) * self._n, solution.x

    def _named(
        self, blocks: tuple[SignatureBlock, ...], x: Array
    ) -> tuple[BaselineEffect, ...]:
        out, k = [], 0
        for block in blocks:
            values = np.array(block.values)
            values[list(block.free)] = x[k : k + len(block.free)]
            k += len(block.free)
            out.append(BaselineEffect(self._signatures.candidates[block.candidate], values))
        return tuple(out)
