"""What others would do with the same evidence: baselines of the blind benchmark.

They fit the signatures of a bank to the whitened residuals by plain least squares, without
sizes of groups or a threshold for the whole library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.signatures import Bank, Shape
from ves_gym.diagnosis.inference.variance_groups import Products, solve
from ves_gym.diagnosis.inference.whitened_residuals import Evidence

MOST = 3  # effects


@dataclass(frozen=True)
class Named:
    """A candidate with its numbers (k,)."""

    candidate: Candidate
    values: Array


class Baselines:
    """Least squares of the residual under the nominal description.

    With `tolerances`, small errors of the description are fitted along, at a unit prior each.
    """

    def __init__(self, evidence: Evidence, bank: Bank, tolerances: bool = False) -> None:
        self._bank, self._n = bank, evidence.size
        z, X = evidence.null, bank.columns
        self._zz = float(z @ z)
        self._xz = np.asarray(X.T @ z.astype(X.dtype), float)
        self._xx = np.asarray(X.T @ X, float)
        if tolerances:
            J = evidence.slopes
            xj = np.asarray(X.T @ J.astype(X.dtype), float)
            inside, jz = J.T @ J + np.eye(J.shape[1]), J.T @ z
            self._zz -= float(jz @ np.linalg.solve(inside, jz))
            self._xz -= xj @ np.linalg.solve(inside, jz)
            self._xx -= xj @ np.linalg.solve(inside, xj.T)

    def smallest_error(self) -> tuple[Named, ...]:
        """The one candidate that leaves the least error; there always is one."""
        fits = [(self._fit((shape,)), shape) for shape in self._bank.shapes]
        (_, x), shape = min(fits, key=lambda f: f[0][0])
        return self._named((shape,), x)

    def stepwise(self) -> tuple[Named, ...]:
        """Forward selection while n log(error) + k log(n) falls, up to three effects."""
        chosen: tuple[Shape, ...] = ()
        best = self._criterion(self._zz, 0)
        values = np.zeros(0)
        while len(chosen) < MOST:
            taken = {s.candidate for s in chosen}
            tried = []
            for shape in self._bank.shapes:
                if shape.candidate not in taken:
                    some = (*chosen, shape)
                    error, x = self._fit(some)
                    k = sum(self._bank.candidates[s.candidate].k for s in some)
                    tried.append((self._criterion(error, k), some, x))
            if not tried:
                break
            now = min(tried, key=lambda t: t[0])
            if now[0] >= best:
                break
            best, chosen, values = now
        return self._named(chosen, values)

    def _criterion(self, error: float, k: int) -> float:
        return self._n * math.log(max(error, 1e-300)) + k * math.log(self._n)

    def _fit(self, shapes: tuple[Shape, ...]) -> tuple[float, Array]:
        """Sum of squares left, and the numbers, kept within their ranges."""
        at = [c for s in shapes for c in s.columns]
        bounds = [(self._bank.candidates[s.candidate], i) for s in shapes for i in s.free]
        low = np.array([c.low[i] for c, i in bounds])
        high = np.array([c.high[i] for c, i in bounds])
        whole = Products(
            np.array([float(self._n)]),
            np.array([self._zz]),
            self._xz[None, at],
            self._xx[np.ix_(at, at)][None],
        )
        found = solve(whole, 0, low, high)
        return float(found.size[0]) * self._n, found.x

    def _named(self, shapes: tuple[Shape, ...], x: Array) -> tuple[Named, ...]:
        out, k = [], 0
        for shape in shapes:
            values = np.array(shape.values)
            values[list(shape.free)] = x[k : k + len(shape.free)]
            k += len(shape.free)
            out.append(Named(self._bank.candidates[shape.candidate], values))
        return tuple(out)
