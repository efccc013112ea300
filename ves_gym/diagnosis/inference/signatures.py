"""`Bank`: the signature of every candidate, and all their inner products.

A signature is the change of the whitened residual per number of the effect. With the
products at hand, scoring a candidate, alone or beside others, and asking which candidates
these data cannot tell apart, are small linear problems.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.variance_groups import Products, solve
from ves_gym.diagnosis.inference.whitened_residuals import Evidence

_CHUNK = 24  # models evaluated at once
_EXACT = 30  # shapes whose score is worth the exact sizes of the groups


@dataclass(frozen=True)
class Shape:
    """A candidate with the numbers held fast that do not enter as a factor."""

    candidate: int
    columns: tuple[int, ...]  # of the bank
    values: tuple[float, ...]  # (k,) at which the columns were taken
    free: tuple[int, ...]  # which of the k numbers the columns stand for


@dataclass(frozen=True)
class Score:
    """What a candidate explains of a residual."""

    candidate: int
    deviance: float
    values: Array  # (k,)


class Bank:
    """Signatures (N, M) of candidates and their products."""

    def __init__(
        self,
        evidence: Evidence,
        candidates: Sequence[Candidate],
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.evidence, self.candidates = evidence, tuple(candidates)
        self.shapes: list[Shape] = []
        jobs: dict[tuple[str, ...], list[tuple[int, Candidate, Array, float]]] = {}
        at = 0
        for i, candidate in enumerate(self.candidates):
            for start in candidate.starts:
                factors = candidate.factors
                for j, k in enumerate(factors):
                    values = np.array(start)
                    values[[m for m in factors if m != k]] = 0.0
                    job = (at + j, candidate, values, start[k])
                    jobs.setdefault(candidate.ports, []).append(job)
                columns = tuple(range(at, at + len(factors)))
                self.shapes.append(Shape(i, columns, start, factors))
                at += len(factors)
        p = self._p = evidence.slopes.shape[1]
        self._whole = np.zeros((evidence.size, p + at), np.float32)
        self._whole[:, :p] = evidence.slopes
        self.columns = self._whole[:, p:]
        done = 0
        for ports, mine in jobs.items():
            for some in (mine[k : k + _CHUNK] for k in range(0, len(mine), _CHUNK)):
                models = [evidence.machine.model([c.effect(v)]) for _, c, v, _ in some]
                moved = evidence.residual(models, ports) - evidence.null
                for row, (column, _, _, size) in zip(moved, some, strict=True):
                    self.columns[:, column] = row / size
                done += len(some)
                if progress is not None:
                    progress(done / at)
        parts = [self._whole[g.part] for g in evidence.groups]
        self._xx = np.stack([x.T @ x for x in parts])
        self._n = np.array([g.n for g in evidence.groups], float)
        everything = self._xx.sum(axis=0).astype(float)
        J, S = slice(None, p), slice(p, None)
        inside = everything[J, J] + np.eye(p)
        self.inner = everything[S, S] - everything[S, J] @ np.linalg.solve(
            inside, everything[J, S]
        )

    # --------------------------------------------------------------- scoring

    def scores(self, z: Array, beside: Array, size: Array) -> list[Score]:
        """Best score of each candidate on a residual z (N,), refitted together with nuisances
        and the tangents `beside` (N, r) of what has been found already.

        A first pass takes the groups' mean squares `size` (G,) as they are; those that do well
        in it are scored again with the sizes that they leave.
        """
        groups, p, r = self.evidence.groups, self._p, beside.shape[1]
        zz = np.array([z[g.part] @ z[g.part] for g in groups])
        xz = np.stack([self._whole[g.part].T @ z[g.part] for g in groups])
        bz = np.stack([beside[g.part].T @ z[g.part] for g in groups])
        bb = np.stack([beside[g.part].T @ beside[g.part] for g in groups])
        bx = np.stack([beside[g.part].T @ self._whole[g.part] for g in groups])
        first = self._first_pass(1 / np.maximum(size, 1.0), xz, bz, bb, bx)
        best: dict[int, Score] = {}
        for rank, s in enumerate(np.argsort(-first)):
            shape = self.shapes[int(s)]
            candidate = self.candidates[shape.candidate]
            if rank >= _EXACT:
                worst = Score(shape.candidate, np.inf, np.array(shape.values))
                best.setdefault(shape.candidate, worst)
                continue
            at = [*range(p), *(p + c for c in shape.columns)]
            k = len(at)
            xx = np.empty((len(groups), k + r, k + r))
            xx[:, :k, :k] = self._xx[:, at][:, :, at]
            xx[:, :p, :p] = self.evidence.gram  # as exact as in a full fit
            xx[:, k:, k:] = bb
            xx[:, k:, :k] = bx[:, :, at]
            xx[:, :k, k:] = bx[:, :, at].swapaxes(1, 2)
            low = np.array([candidate.low[i] for i in shape.free] + [-np.inf] * r)
            high = np.array([candidate.high[i] for i in shape.free] + [np.inf] * r)
            if candidate.sets_in:  # as much as the start has, or twice that
                low[0], high[0] = 0.0, 2 * shape.values[0]
            both = Products(self._n, zz, np.concatenate([xz[:, at], bz], axis=1), xx)
            found = solve(both, p, low, high)
            now = best.get(shape.candidate)
            if now is None or found.deviance < now.deviance:
                values = np.array(shape.values)
                if not candidate.sets_in:
                    values[list(shape.free)] = found.x[p : p + len(shape.free)]
                best[shape.candidate] = Score(shape.candidate, found.deviance, values)
        return [best[i] for i in range(len(self.candidates))]

    def _first_pass(self, weight: Array, xz: Array, bz: Array, bb: Array, bx: Array) -> Array:
        """(shapes,) gain of each shape with the groups' weights held."""
        p, r = self._p, bz.shape[1]
        xx = np.einsum("g,gij->ij", weight, self._xx, dtype=float)
        x, b = weight @ xz, weight @ bz
        cross = np.einsum("g,gij->ij", weight, bx)  # (r, p + M)
        inside = np.zeros((p + r, p + r))
        inside[:p, :p] = xx[:p, :p] + np.eye(p)
        inside[p:, p:] = np.einsum("g,gij->ij", weight, bb)
        inside[p:, :p], inside[:p, p:] = cross[:, :p], cross[:, :p].T
        inside += 1e-10 * np.diag(np.diag(inside) + 1e-30)
        known = np.concatenate([xx[:p], cross])  # (p + r, p + M)
        solved = np.linalg.solve(inside, np.column_stack([known, np.r_[x[:p], b]]))
        G = (xx - known.T @ solved[:, :-1])[p:, p:]
        g = (x - known.T @ solved[:, -1])[p:]
        out = np.empty(len(self.shapes))
        for i, shape in enumerate(self.shapes):
            at = list(shape.columns)
            A = G[np.ix_(at, at)]
            A = A + 1e-9 * np.diag(np.diag(A) + 1e-30)
            out[i] = float(g[at] @ np.linalg.solve(A, g[at]))
        return out

    # ------------------------------------------- what these data can tell at all

    def likeness(self, i: int, j: int) -> float:
        """How well candidate j can imitate candidate i at its usual size, 0 to 1.

        The cosine between the signature of i and the nearest of j's, nuisances projected out.
        """
        a = next(s for s in self.shapes if s.candidate == i)
        at = list(a.columns)
        usual = np.array(a.values)[list(a.free)]
        own = float(usual @ self.inner[np.ix_(at, at)] @ usual)
        best = 0.0
        for s in (s for s in self.shapes if s.candidate == j):
            other = list(s.columns)
            cross = self.inner[np.ix_(other, at)] @ usual
            A = self.inner[np.ix_(other, other)]
            A = A + 1e-9 * np.diag(np.diag(A) + 1e-300)
            best = max(best, float(cross @ np.linalg.solve(A, cross)))
        return float(np.sqrt(np.clip(best / own, 0.0, 1.0))) if own > 0 else 0.0

    def visible(self, i: int) -> float:
        """Standard deviations by which candidate i at its usual size stands out of noise."""
        found = 0.0
        for s in (s for s in self.shapes if s.candidate == i):
            at = list(s.columns)
            usual = np.array(s.values)[list(s.free)]
            found = max(found, float(usual @ self.inner[np.ix_(at, at)] @ usual))
        return float(np.sqrt(found))
