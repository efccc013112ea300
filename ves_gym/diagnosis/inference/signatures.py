"""`Signatures`: of every candidate its signature, and all their inner products.

A signature is the change of the whitened residual per number of the effect. With the
products at hand, scoring a candidate, alone or beside others, and asking which candidates
these data cannot distinguish, are small linear problems.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import QUIETEST
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.variance_groups import InnerProducts, limits_of, solve
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

_CHUNK = 24  # models evaluated at once
_EXACT = 30  # shapes whose score is worth the exact sizes of the groups
_DELICATE = 1e-4  # of a signature's square beyond tolerances: single precision tells too little


@dataclass(frozen=True)
class SignatureBlock:
    """A candidate with the numbers held fast that do not enter as a factor."""

    candidate: int
    columns: tuple[int, ...]  # of the signatures
    values: tuple[float, ...]  # (k,) at which the columns were taken
    free: tuple[int, ...]  # which of the k numbers the columns stand for


@dataclass(frozen=True)
class Score:
    """Deviance left by a candidate, by its linear score."""

    candidate: int
    deviance: float
    values: Array  # (k,)


class Signatures:
    """Signatures (N, M) of candidates and their inner products.

    Args:
        residuals: under the description, N numbers.
        candidates: the library.
        progress: called with the fraction done.
    """

    def __init__(
        self,
        residuals: WhitenedResiduals,
        candidates: Sequence[Candidate],
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.residuals, self.candidates = residuals, tuple(candidates)
        self.blocks: list[SignatureBlock] = []
        usual: list[float] = []
        queue: dict[tuple[str, ...], list[tuple[int, Candidate, Array, float]]] = {}
        at = 0
        for i, candidate in enumerate(self.candidates):
            for start in candidate.starts:
                factors = candidate.factors
                for j, k in enumerate(factors):
                    values = np.array(start)
                    values[[m for m in factors if m != k]] = 0.0
                    entry = (at + j, candidate, values, start[k])
                    queue.setdefault(candidate.ports, []).append(entry)
                    usual.append(start[k])
                columns = tuple(range(at, at + len(factors)))
                self.blocks.append(SignatureBlock(i, columns, start, factors))
                at += len(factors)
        self.usual = np.array(usual)  # (M,) sizes of the numbers that the columns stand for
        p = self._p = residuals.slopes.shape[1]
        self._all_columns = np.zeros((residuals.length, p + at), np.float32)
        self._all_columns[:, :p] = residuals.slopes
        self.columns = self._all_columns[:, p:]
        done = 0
        for ports, entries in queue.items():
            for chunk in (entries[k : k + _CHUNK] for k in range(0, len(entries), _CHUNK)):
                models = [residuals.machine.model([c.effect(v)]) for _, c, v, _ in chunk]
                moved = residuals.under(models, ports) - residuals.null
                for row, (column, _, _, size) in zip(moved, chunk, strict=True):
                    self.columns[:, column] = row / size
                done += len(chunk)
                if progress is not None:
                    progress(done / at)
        self._xx = self._group_products()
        self._noisy = [k for k, g in enumerate(residuals.groups) if g.copies]
        self._noise_xx = [
            residuals.noise_product(residuals.groups[k], self._all_columns) for k in self._noisy
        ]
        self._n = np.array([g.n for g in residuals.groups], float)
        self._most, self._least = limits_of(residuals.groups)
        self.rows = residuals.measured  # that are looked at
        self._set_beside_tolerances()

    def _group_products(self) -> Array:
        """Return (G, p + M, p + M) products of all columns."""
        parts = [self._all_columns[g.part] for g in self.residuals.groups]
        return np.stack([x.T @ x for x in parts])

    def _set_beside_tolerances(self) -> None:
        """Products (M, M) of the signatures, what tolerances imitate taken off."""
        p, everything = self._p, self._xx.sum(axis=0).astype(float)
        J, S = slice(None, p), slice(p, None)
        inside = everything[J, J] + np.eye(p)
        self.inner = everything[S, S] - everything[S, J] @ np.linalg.solve(
            inside, everything[J, S]
        )
        delicate = np.diag(self.inner) < _DELICATE * np.diag(everything)[p:]
        self._delicate = [bool(delicate[list(block.columns)].any()) for block in self.blocks]
        self._exact: dict[int, Array] = {}  # block -> (G, p + k, k) products of its columns

    def with_tolerances(self, residuals: WhitenedResiduals) -> Signatures:
        """Return the same signatures beside tolerances of other sizes.

        Args:
            residuals: the same, `with_tolerances` of other sizes.
        """
        out, p = copy.copy(self), self._p
        out.residuals = residuals
        out._all_columns = self._all_columns.copy()
        out._all_columns[:, :p] = residuals.slopes
        out.columns = out._all_columns[:, p:]
        old, new = (np.array([k.std for k in r.nuisances]) for r in (self.residuals, residuals))
        scale = np.ones(out._all_columns.shape[1], np.float32)
        scale[:p] = new / old
        both = np.outer(scale, scale)
        out._xx = self._xx * both
        out._noise_xx = [k * both for k in self._noise_xx]
        if residuals.scale != self.residuals.scale:
            out._all_columns = residuals.rewhitened(
                self._all_columns.astype(float) * scale, self.residuals
            ).astype(np.float32)
            out.columns = out._all_columns[:, p:]
            out._xx = out._group_products()
            out._most, out._least = limits_of(residuals.groups)
        out._set_beside_tolerances()
        return out

    # --------------------------------------------------------------- scoring

    def scores(self, z: Array, beside: Array, size: Array) -> list[Score]:
        """Return the best score of each candidate, nuisances and accepted effects refitted.

        A first pass takes the groups' sizes as they are; candidates that do well in it are
        scored again with the sizes that they leave.

        Args:
            z: (N,) residual.
            beside: (N, r) tangents of the effects accepted already.
            size: (G,) mean squares of the groups.
        """
        p, r, first = self._p, beside.shape[1], self._p + len(self.usual)
        zz, cross = self._crossed(z, beside)
        noise_zz, noise = self._noise_crossed(z, beside)
        share = np.minimum(size, 1.0)[:, None]  # of the noise expected that is there
        seen = np.concatenate([cross[:, :1] - share[:, None] * noise[:, :1], cross[:, 1:]], 1)
        gains = self._first_pass(1 / np.maximum(size, 1.0), seen)
        best: dict[int, Score] = {}
        for rank, s in enumerate(np.argsort(-gains)):
            block = self.blocks[int(s)]
            candidate = self.candidates[block.candidate]
            if rank >= _EXACT and not self._delicate[int(s)]:
                worst = Score(block.candidate, np.inf, np.array(block.values))
                best.setdefault(block.candidate, worst)
                continue
            every = [*range(p), *(p + c for c in block.columns), *range(first, first + r)]
            k, at = len(every) - r, every[: len(every) - r]
            xx = np.empty((len(zz), k + r, k + r))
            xx[:, :p, :p] = self.residuals.gram  # as exact as in a full fit
            xx[:, :k, p:k] = self._products(int(s))
            xx[:, p:k, :p] = xx[:, :p, p:k].swapaxes(1, 2)
            noise_xx = np.zeros_like(xx)
            for g, products in zip(self._noisy, self._noise_xx, strict=True):
                noise_xx[g, :k, :k] = products[np.ix_(at, at)]
            for square, rows in ((xx, cross), (noise_xx, noise)):
                square[:, k:] = rows[:, 1:, every]
                square[:, :k, k:] = square[:, k:, :k].swapaxes(1, 2)
            low = np.array([candidate.low[i] for i in block.free] + [-np.inf] * r)
            high = np.array([candidate.high[i] for i in block.free] + [np.inf] * r)
            if candidate.sets_in:  # as much as the start has, or twice that
                low[0], high[0] = 0.0, 2 * block.values[0]
            both = InnerProducts(
                self._n,
                zz,
                cross[:, 0, every],
                xx,
                noise_zz,
                noise[:, 0, every],
                noise_xx,
                self._most,
                self._least,
            )
            solution = solve(both, p, low, high)
            previous = best.get(block.candidate)
            if previous is None or solution.deviance < previous.deviance:
                values = np.array(block.values)
                if not candidate.sets_in:
                    values[list(block.free)] = solution.x[p : p + len(block.free)]
                best[block.candidate] = Score(block.candidate, solution.deviance, values)
        return [best[i] for i in range(len(self.candidates))]

    def _products(self, s: int) -> Array:
        """Products (G, p + k, k) of a block's k columns with tolerances and each other."""
        if s not in self._exact:
            columns = self.columns[:, list(self.blocks[s].columns)].astype(float)
            both = np.hstack([self.residuals.slopes, columns])
            groups = self.residuals.groups
            self._exact[s] = np.stack([both[g.part].T @ columns[g.part] for g in groups])
        return self._exact[s]

    def _crossed(self, z: Array, beside: Array) -> tuple[Array, Array]:
        """Return products by group: of z (N,) with itself (G,), and (G, 1 + r, p + M + r) of z
        and tangents (N, r) with tolerances, signatures and tangents."""
        both, parts = np.column_stack([z, beside]), [g.part for g in self.residuals.groups]
        inner = np.stack([both[x].T @ both[x] for x in parts])
        across = np.stack([both[x].T @ self._all_columns[x] for x in parts])
        # a weight that is stated may be off by a million times its noise, and is a tolerance
        across[..., : self._p] = [both[x].T @ self.residuals.slopes[x] for x in parts]
        return inner[:, 0, 0], np.concatenate([across, inner[..., 1:]], axis=2)

    def _noise_crossed(self, z: Array, beside: Array) -> tuple[Array, Array]:
        """Return what noise alone adds to the products of `_crossed`."""
        both, usual = np.column_stack([z, beside]), self.residuals.null[:, None]
        r = beside.shape[1]
        zz = self._n.copy()
        cross = np.zeros((len(zz), 1 + r, self._all_columns.shape[1] + r))
        product = self.residuals.noise_product
        for k in self._noisy:
            group = self.residuals.groups[k]
            inner = product(group, both)
            zz[k] += inner[0, 0] - product(group, usual)[0, 0]
            across = product(group, both, self._all_columns)
            cross[k] = np.concatenate([across, inner[:, 1:]], axis=1)
        return zz, cross

    def _first_pass(self, weight: Array, cross: Array) -> Array:
        """Return (blocks,) gain of each block with the groups' weights held."""
        p, m = self._p, self._all_columns.shape[1]
        xx = np.einsum("g,gij->ij", weight, self._xx, dtype=float)
        xx[:p, :p] = np.einsum("g,gij->ij", weight, self.residuals.gram)
        x, *beside = np.einsum("g,gij->ij", weight, cross)
        rows = np.reshape(beside, (-1, len(x)))  # (r, p + M + r)
        fitted = np.concatenate([xx[:p], rows[:, :m]])  # (p + r, p + M)
        inside = np.hstack([fitted[:, :p], np.concatenate([rows[:, :p].T, rows[:, m:]])])
        inside[:p, :p] += np.eye(p)
        inside += 1e-10 * np.diag(np.diag(inside) + 1e-30)
        solved = np.linalg.solve(inside, np.column_stack([fitted, np.r_[x[:p], x[m:]]]))
        G = (xx - fitted.T @ solved[:, :-1])[p:, p:]
        g = (x[:m] - fitted.T @ solved[:, -1])[p:]
        out = np.empty(len(self.blocks))
        for i, block in enumerate(self.blocks):
            at = list(block.columns)
            A = G[np.ix_(at, at)]
            A = A + 1e-9 * np.diag(np.diag(A) + 1e-30)
            out[i] = float(g[at] @ np.linalg.solve(A, g[at]))
        return out

    def score_law(self, size: Array) -> tuple[Array, Array]:
        """Return the curvature of the scores, and their covariance under noise and tolerances.

        Args:
            size: (G,) mean squares of the groups.

        Returns:
            (M, M) each, of all signatures; the same where no group is quieter than its noise.
        """
        p, weight = self._p, 1 / np.maximum(size, 1.0)
        xx = np.einsum("g,gij->ij", weight, self._xx, dtype=float)
        noise = np.einsum("g,gij->ij", weight**2 * size, self._xx, dtype=float)
        slopes = -np.linalg.solve(xx[:p, :p] + np.eye(p), xx[:p, p:])
        T = np.vstack([slopes, np.eye(xx.shape[0] - p)])
        curvature = xx[p:, p:] + xx[p:, :p] @ slopes
        drawn = xx[:p] @ T
        return curvature, T.T @ noise @ T + drawn.T @ drawn

    def squares(self, size: Array) -> Array:
        """Return the sum of squares (M,) of each signature, tolerances left in.

        Args:
            size: (G,) mean squares of the groups.
        """
        diagonals = np.stack([np.diag(x)[self._p :] for x in self._xx])
        return np.asarray((1 / np.maximum(size, 1.0)) @ diagonals, float)

    # ------------------------------------------- what these data can tell at all

    def likeness(self, i: int, j: int) -> float:
        """Return how well candidate j can imitate candidate i at its usual size.

        Args:
            i, j: indices of candidates.

        Returns:
            Cosine between the signature of i and the nearest of j's, nuisances projected out.
        """
        a = next(s for s in self.blocks if s.candidate == i)
        at = list(a.columns)
        usual = np.array(a.values)[list(a.free)]
        self_product = float(usual @ self.inner[np.ix_(at, at)] @ usual)
        best = 0.0
        for s in (s for s in self.blocks if s.candidate == j):
            other = list(s.columns)
            cross = self.inner[np.ix_(other, at)] @ usual
            A = self.inner[np.ix_(other, other)]
            A = A + 1e-9 * np.diag(np.diag(A) + 1e-300)
            best = max(best, float(cross @ np.linalg.solve(A, cross)))
        return (
            float(np.sqrt(np.clip(best / self_product, 0.0, 1.0))) if self_product > 0 else 0.0
        )

    def visible(self, i: int) -> float:
        """Return the standard deviations by which candidate i, of usual size, exceeds noise."""
        return self._stands_out(i, np.ones(len(self.rows)))

    def visible_above(self, i: int, size: Array) -> float:
        """Return the standard deviations by which candidate i exceeds what is left in a fit.

        A group that is left quieter than its noise was estimated has less noise than that: a
        loop that rings is taken for a noisy one.

        Args:
            i: index of the candidate.
            size: (G,) mean squares that a fit leaves.
        """
        weight = np.empty(self.residuals.length)
        for group, s in zip(self.residuals.groups, size, strict=True):
            weight[group.part] = 1 / np.clip(s, QUIETEST, 1.0)
        return self._stands_out(i, weight[self.rows])

    def _stands_out(self, i: int, weight: Array) -> float:
        """Size of candidate i beyond what tolerances imitate, rows having weights (rows,).

        In double precision: what is all but a tolerance may stand far out of its noise.
        """
        slopes = self.residuals.slopes[self.rows]
        weighted = slopes.T * weight
        inside, largest = weighted @ slopes + np.eye(self._p), 0.0
        for block in (s for s in self.blocks if s.candidate == i):
            usual = np.array(block.values)[list(block.free)]
            changed = self.columns[np.ix_(self.rows, np.array(block.columns))] @ usual
            across = weighted @ changed
            alone = float(weight @ changed**2)
            largest = max(largest, alone - float(across @ np.linalg.solve(inside, across)))
        return float(np.sqrt(largest))
