"""Profile likelihood with a variance floor: fits of a residual by columns, in groups whose size
is unknown but at least that of noise.

With |z_g|^2 / n_g = s_g^2 after the fit, twice the negative log-likelihood of group g is
n_g s_g^2 where the residual is no larger than noise, and n_g (1 + log s_g^2) where it is
larger: its most probable size is then s_g^2 (derived in docs/diagnosis.md). Whatever stays
unexplained in a group thereby weakens, by itself, the weight of that group.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals

_PASSES = 6  # of reweighting
_RIDGE = 1e-10
_FARTHEST = 5.0  # standard deviations: farther off it is no tolerance any more


@dataclass(frozen=True)
class InnerProducts:
    """Inner products of columns and residual, group by group."""

    n: Array  # (G,)
    zz: Array  # (G,)
    xz: Array  # (G, c)
    xx: Array  # (G, c, c)


@dataclass(frozen=True)
class Solution:
    """A fit z ~ -X x with unknown group sizes."""

    x: Array  # (c,)
    deviance: float
    size: Array  # (G,) s_g^2 left
    covariance: Array  # (c, c)


def products(
    residuals: WhitenedResiduals, z: Array, X: Array, scale: Array | None = None
) -> InnerProducts:
    """Return products of a residual and columns, after those of the nuisances.

    Args:
        residuals: whose groups and nuisances count.
        z: (N,) residual.
        X: (N, c) columns.
        scale: (N,) size of the noise, where it is not 1.
    """
    p, c = residuals.slopes.shape[1], X.shape[1]
    groups = residuals.groups
    xz, xx = np.empty((len(groups), p + c)), np.empty((len(groups), p + c, p + c))
    xx[:, :p, :p] = residuals.gram
    zz = np.empty(len(groups))
    for k, g in enumerate(groups):
        a, J, x = z[g.part], residuals.slopes[g.part], X[g.part]
        if scale is not None and (scale[g.part] != 1).any():
            weight = 1 / scale[g.part]
            a, J, x = a * weight, J * weight[:, None], x * weight[:, None]
            xx[k, :p, :p] = J.T @ J
        zz[k] = a @ a
        xz[k, :p], xz[k, p:] = J.T @ a, x.T @ a
        xx[k, p:, :p] = x.T @ J
        xx[k, :p, p:] = xx[k, p:, :p].T
        xx[k, p:, p:] = x.T @ x
    return InnerProducts(np.array([g.n for g in groups], float), zz, xz, xx)


def solve(
    p: InnerProducts, nuisances: int, low: Array | None = None, high: Array | None = None
) -> Solution:
    """Return the most probable x by iterated reweighting.

    Args:
        p: products of c columns.
        nuisances: the first so many columns have a unit normal prior, cut off far out.
        low, high: (c - nuisances,) bounds of the others.
    """
    c = p.xz.shape[1]
    prior = np.zeros(c)
    prior[:nuisances] = 1.0
    highs = np.full(c, np.inf)
    highs[:nuisances] = _FARTHEST
    lows = -highs
    if low is not None and high is not None:
        lows[nuisances:], highs[nuisances:] = low, high
    x = np.zeros(c)
    size = np.maximum(p.zz / p.n, 1e-12)
    A = np.eye(c)
    for _ in range(_PASSES):
        weight = 1 / np.maximum(size, 1.0)
        A = np.einsum("g,gij->ij", weight, p.xx) + np.diag(prior)
        A = A + _RIDGE * np.diag(np.diag(A) + 1e-30)
        b = -weight @ p.xz
        x = _within(A, b, np.linalg.solve(A, b), lows, highs)
        remaining = p.zz + 2 * p.xz @ x + np.einsum("i,gij,j->g", x, p.xx, x)
        size = np.maximum(remaining / p.n, 1e-12)
    return Solution(
        x, deviance(p.n, size) + float(prior @ x**2), size, np.asarray(np.linalg.inv(A), float)
    )


def deviance(n: Array, size: Array) -> float:
    """Return the profile deviance: twice the negative log-likelihood, group sizes eliminated.

    Args:
        n: (G,) numbers in each group.
        size: (G,) mean squares.
    """
    return float((n * np.where(size > 1, 1 + np.log(np.maximum(size, 1.0)), size)).sum())


def _within(A: Array, b: Array, x: Array, low: Array, high: Array) -> Array:
    """Return the minimum of x^T A x / 2 - b x inside bounds, by active sets."""
    fixed = np.zeros(len(x), bool)
    at = np.zeros(len(x))
    for _ in range(len(x) + 1):
        out = (x < low) | (x > high)
        if not (out & ~fixed).any():
            break
        at = np.where(out & ~fixed, np.clip(x, low, high), at)
        fixed |= out
        x = at.copy()
        open_ = ~fixed
        rhs = b[open_] - A[np.ix_(open_, fixed)] @ at[fixed]
        x[open_] = np.linalg.solve(A[np.ix_(open_, open_)], rhs)
    return np.asarray(x)
