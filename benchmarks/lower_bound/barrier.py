"""The best potential for a query, by an interior-point method.

The bound is concave in (f, y, l, e) together, so the search for the best of it is a convex
problem: maximise f(0, start) - f(T, goal) - int e dt - J_R*(l) with the inequality of
`potential` at sampled configurations, as a logarithmic barrier, by Newton's method. Where the
answer breaks it between samples, samples are added. Nothing here has to be exact: what is
claimed is found again by `residual_floor`.
"""

from __future__ import annotations

import itertools

import numpy as np
import scipy.linalg
import scipy.ndimage

from benchmarks.lower_bound.potential import Potential, Setting
from ves_gym._util.params import Array

_ROUNDS = 6  # of adding samples
_LOOK = 11  # samples per joint where the answer is looked at
_ADDED = 40  # samples per slab and round, at most
_FIRST = 5  # samples per joint to begin with
_GAP = 0.015  # of the bound, that barrier and samples may cost


class Barrier:
    """The convex problem of one query; energies in units of `unit` [J]."""

    def __init__(self, setting: Setting, conjugate: Array, unit: float) -> None:
        self.s, self.unit = setting, unit
        self.root = setting.root / np.sqrt(unit)
        self.W = conjugate * unit
        n, d = len(setting.reach.speed), setting.shapes.count
        self.n, self.d, self.width = n, d, d + 6 + 6 * (n + 1)
        self.nodes = setting.slabs + 1
        self.size = self.width * self.nodes + setting.slabs
        values = setting.shapes.at(np.stack([setting.reach.start, setting.reach.goal]))[0]
        self.gain = np.zeros(self.size)  # minimised
        self.gain[:d] -= values[0]
        self.gain[self.width * setting.slabs :][:d] += values[1]
        self.gain[self.width * self.nodes :] = setting.step
        self.multipliers = np.concatenate(
            [np.arange(k * self.width + d, k * self.width + d + 6) for k in range(self.nodes)]
        )
        grid = np.array(list(itertools.product(np.linspace(0, 1, _FIRST), repeat=n)))
        self.points: list[Array] = []
        self.tables: list[tuple[Array, Array, Array]] = []
        for k in range(setting.slabs):
            low, high = setting.box(k)
            self.points.append(low + (high - low) * grid)
            self.tables.append(self._table(self.points[k]))

    def _table(self, q: Array) -> tuple[Array, Array, Array]:
        """Functions (P, d), g's rows (P, n, width) and y's affine functions (P, n + 1)."""
        value, slope, across, affine = self.s.shapes.at(q)
        turned = across @ self.root  # (P, n, 6)
        field = (turned[:, :, :, None] * affine[:, None, None, :]).reshape(len(q), self.n, -1)
        return value, np.concatenate([slope, across, field], axis=2), affine

    def _state(self, x: Array, k: int) -> tuple[Array, Array, Array]:
        """Of slab k: rate + e (P,), g (2, P, n), y (2, P, 6)."""
        value, rows, affine = self.tables[k]
        w, d = x[: self.width * self.nodes].reshape(self.nodes, self.width), self.d
        rate = value @ (w[k + 1, :d] - w[k, :d]) / self.s.step + x[self.width * self.nodes + k]
        g = np.stack([rows @ w[e] for e in (k, k + 1)])
        y = np.stack([affine @ w[e, d + 6 :].reshape(6, -1).T for e in (k, k + 1)])
        return rate, g, y

    def slack(self, x: Array, k: int, delta: float) -> Array:
        """Left side of the inequality, |g| made smooth from above: (2, P)."""
        rate, g, y = self._state(x, k)
        v = self.s.reach.speed
        return np.asarray(rate - 0.5 * (y**2).sum(axis=2) - np.sqrt(g**2 + delta**2) @ v)

    def loss(self, x: Array) -> float:
        """Minus the bound, in units."""
        lam = x[self.multipliers]
        return float(self.gain @ x + 0.5 * lam @ self.W @ lam)

    def merit(self, x: Array, mu: float, delta: float) -> float:
        """Loss with the barrier."""
        total = 0.0
        for k in range(self.s.slabs):
            c = self.slack(x, k, delta)
            if c.min() <= 0:
                return np.inf
            total += np.log(c).sum()
        return self.loss(x) - mu * total

    def _newton(self, x: Array, mu: float, delta: float) -> tuple[Array, float]:
        """Newton's step of the merit, and the decrease it promises."""
        v, h, d, width = self.s.reach.speed, self.s.step, self.d, self.width
        hess = np.zeros((self.size, self.size))
        grad = self.gain.copy()
        at = self.multipliers
        grad[at] += self.W @ x[at]
        hess[np.ix_(at, at)] += self.W
        for k in range(self.s.slabs):
            value, rows, affine = self.tables[k]
            rate, g, y = self._state(x, k)
            P = len(rate)
            for e in (0, 1):
                r = np.sqrt(g[e] ** 2 + delta**2)
                c = rate - 0.5 * (y[e] ** 2).sum(axis=1) - r @ v
                J = np.zeros((P, 2 * width + 1))
                J[:, :d], J[:, width : width + d] = -value / h, value / h
                mine = slice(e * width, (e + 1) * width)
                J[:, mine] -= np.einsum("pi,pij->pj", v * g[e] / r, rows)
                field = (y[e][:, :, None] * affine[:, None, :]).reshape(P, -1)
                J[:, e * width + d + 6 : (e + 1) * width] -= field
                J[:, -1] = 1.0
                weight = mu / c
                place = np.r_[k * width : (k + 2) * width, width * self.nodes + k]
                grad[place] -= J.T @ weight
                scaled = J * (np.sqrt(mu) / c)[:, None]
                hess[np.ix_(place, place)] += scaled.T @ scaled
                bend = np.sqrt(weight[:, None] * v * delta**2 / r**3)
                bent = (rows * bend[:, :, None]).reshape(-1, width)
                diagonal = slice((k + e) * width, (k + e + 1) * width)
                hess[diagonal, diagonal] += bent.T @ bent
                start = (k + e) * width + d + 6
                block = slice(start, start + 6 * (self.n + 1))
                hess[block, block] += np.kron(np.eye(6), affine.T @ (affine * weight[:, None]))
        hess[np.diag_indices(self.size)] += 1e-8
        scale = 1 / np.sqrt(np.diag(hess))
        factor = scipy.linalg.cho_factor(
            hess * scale[:, None] * scale + 1e-11 * np.eye(self.size), check_finite=False
        )
        step = -scale * scipy.linalg.cho_solve(factor, scale * grad)
        return step, float(-grad @ step)

    def centre(self, x: Array, mu: float, delta: float, most: int = 14) -> Array:
        """Follow Newton's steps to the barrier's minimum, nearly."""
        count = 2 * sum(len(q) for q in self.points)
        for _ in range(most):
            step, promise = self._newton(x, mu, delta)
            before, share = self.merit(x, mu, delta), 1.0
            while share > 1e-6 and not (
                self.merit(x + share * step, mu, delta) <= before - 1e-4 * share * promise
            ):
                share /= 2
            x = x + share * step
            if promise < 0.02 * count * mu:
                break
        return x

    def solve(self) -> Potential:
        """Return the best potential that was found."""
        x = np.zeros(self.size)
        errors = slice(self.width * self.nodes, self.size)
        mu, delta = 3e-3, 0.3
        x[errors] = 1.0 + 2 * delta * self.s.reach.speed.sum()
        for turn in range(_ROUNDS):
            goal = _GAP * (3.0 if turn == 0 else 1.0)
            while True:
                x = self.centre(x, mu, delta)
                value = max(-self.loss(x), 0.05)
                count = 2 * sum(len(q) for q in self.points)
                if mu * count < goal * value:
                    break
                mu, delta = 0.2 * mu, max(0.3 * delta, 2e-4)
            broken = self._add(x)
            if turn + 1 == _ROUNDS or broken.sum() * self.s.step < _GAP * value:
                break
            mu, delta = 5 * mu, 2 * delta
            x[errors] += 1.05 * broken + 1e-3 + delta * self.s.reach.speed.sum()
        return self.potential(x)

    def _add(self, x: Array) -> Array:
        """Add samples where the inequality is broken; by how much it is, per slab."""
        worst = np.zeros(self.s.slabs)
        p = self.potential(x)
        axes = np.array(list(itertools.product(np.linspace(0, 1, _LOOK), repeat=self.n)))
        for k in range(self.s.slabs):
            low, high = self.s.box(k)
            q = low + (high - low) * axes
            value = self.s.residual(p, k, q)[0] / self.unit + x[self.width * self.nodes + k]
            value = value.min(axis=0)
            worst[k] = max(0.0, -float(value.min()))
            cube = value.reshape((_LOOK,) * self.n)
            local = (cube == scipy.ndimage.minimum_filter(cube, 3)).ravel() & (value < 0)
            places = np.flatnonzero(local)
            places = places[np.argsort(value[places])][:_ADDED]
            if len(places):
                self.points[k] = np.vstack([self.points[k], q[places]])
                self.tables[k] = self._table(self.points[k])
        return worst

    def potential(self, x: Array) -> Potential:
        """In SI units."""
        w, d = x[: self.width * self.nodes].reshape(self.nodes, self.width), self.d
        y = w[:, d + 6 :].reshape(self.nodes, 6, -1) * np.sqrt(self.unit)
        return Potential(f=w[:, :d] * self.unit, y=y, l=w[:, d : d + 6] * self.unit)
