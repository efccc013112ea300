"""Profile likelihood with a variance floor: fits of a residual by columns, in groups whose size
is unknown but at least that of noise.

With |z_g|^2 / n_g = s_g^2 after the fit, twice the negative log-likelihood of group g is
n_g s_g^2 where the residual is no larger than noise, and n_g (1 + log s_g^2) where it is
larger: its most probable size is then s_g^2 (derived in docs/diagnosis.md). Whatever stays
unexplained in a group thereby weakens, by itself, the weight of that group.

Where columns hold noise themselves (a mass times a pose differentiated twice), the noise in
z + X x depends on x. With its mean square V_g(x) / n_g, from draws, the residual's sum of
squares R_g(x) is compared with V_g(x) instead of n_g: s_g^2 = R_g / V_g where it is no larger,
and 1 + (R_g - V_g) / n_g where it is: the misfit comes on top of the noise. At the true x the
expected slope of R_g - V_g is zero, so noise pulls no number to one side, as it does in least
squares (Carroll et al., Measurement Error in Nonlinear Models, 2006, ch. 7: corrected scores).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import QUIETEST
from ves_gym.diagnosis.inference.whitened_residuals import VarianceGroup, WhitenedResiduals

_PASSES = 6  # of reweighting
_RIDGE = 1e-10
SAFE = 0.8  # of the noise in columns that steps take off: all of it may leave no curvature
_HALF = 0.5  # of a combination's square: with more noise than that it is mostly noise
FARTHEST = 5.0  # standard deviations: farther off it is no tolerance any more


@dataclass(frozen=True)
class InnerProducts:
    """Inner products of columns and residual, group by group."""

    n: Array  # (G,)
    zz: Array  # (G,)
    xz: Array  # (G, c)
    xx: Array  # (G, c, c)
    noise: Array | None = None  # (G,) sum of squares of noise expected in z; n where None
    noise_xz: Array | None = None  # (G, c) the same of the products; zero where None
    noise_xx: Array | None = None  # (G, c, c)
    most: Array | None = None  # (G,) of the noise that costs no density; n where None
    least: Array | None = (
        None  # (G,) size below which a residual means nothing; zero where None
    )


@dataclass(frozen=True)
class Solution:
    """A fit z ~ -X x with unknown group sizes."""

    x: Array  # (c,)
    deviance: float
    misfit: float  # the same without the price of noise passed on: what numbers are fitted to
    size: Array  # (G,) s_g^2 left
    covariance: Array  # (c, c)


def products(residuals: WhitenedResiduals, z: Array, X: Array) -> InnerProducts:
    """Return products of a residual and columns, after those of the nuisances.

    Args:
        residuals: whose groups and nuisances count.
        z: (N,) residual and its copies.
        X: (N, c) columns.
    """
    p, c = residuals.slopes.shape[1], X.shape[1]
    groups = residuals.groups
    xz, xx = np.zeros((len(groups), p + c)), np.zeros((len(groups), p + c, p + c))
    xx[:, :p, :p] = residuals.gram
    zz = np.empty(len(groups))
    n = np.array([g.n for g in groups], float)
    noise, noise_xz, noise_xx = n.copy(), np.zeros_like(xz), np.zeros_like(xx)
    noise_xx[:, :p, :p] = residuals.noise_gram
    for k, g in enumerate(groups):
        a, J, every = z[g.part], residuals.slopes[g.part], X[g.part]
        zz[k], xz[k, :p] = a @ a, J.T @ a
        there = np.flatnonzero(every.any(axis=0))  # nothing of what acts elsewhere
        at, x = p + there, every[:, there]
        across, inside = np.ix_([k], at, range(p)), np.ix_([k], at, at)
        xz[k, at], xx[across], xx[inside] = x.T @ a, x.T @ J, x.T @ x
        for part in g.copies:
            e, J, x = z[part], residuals.slopes[part], X[part][:, there]
            usual, share = residuals.null[part], 1 / len(g.copies)
            noise[k] += share * float(e @ e - usual @ usual)
            noise_xz[k, :p] += share * (J.T @ e)
            noise_xz[k, at] += share * (x.T @ e)
            noise_xx[across] += share * (x.T @ J)
            noise_xx[inside] += share * (x.T @ x)
        for both in (xx, noise_xx):
            both[k, :p, p:] = both[k, p:, :p].T
    return InnerProducts(n, zz, xz, xx, noise, noise_xz, noise_xx, *limits_of(groups))


def scaled(inner: InnerProducts, scale: Array) -> InnerProducts:
    """Return products of the columns times numbers (c,)."""
    square = np.outer(scale, scale)
    return replace(
        inner,
        xz=inner.xz * scale,
        xx=inner.xx * square,
        noise_xz=None if inner.noise_xz is None else inner.noise_xz * scale,
        noise_xx=None if inner.noise_xx is None else inner.noise_xx * square,
    )


def limits_of(groups: Sequence[VarianceGroup]) -> tuple[Array, Array]:
    """Return (G,) squares of noise that a model may foretell at no price, and least sizes.

    A base moves because of the wrench on it: what the data have is the density of its pose, and
    there a heavier base divides as much as it multiplies. Elsewhere torque and wrench are given
    as noisily as the motion, and more noise than the description has costs log |V|.
    Without noise a residual is measured by what rounding leaves of it, and no model is likelier
    because it leaves still less.

    Args:
        groups: G.
    """
    most = [g.n if g.priced else np.inf for g in groups]
    return np.array(most), np.array([g.floor for g in groups])


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
    none = np.zeros_like(p.xz), np.zeros_like(p.xx)
    noise = p.n if p.noise is None else p.noise
    noise_xz = none[0] if p.noise_xz is None else p.noise_xz
    noise_xx = none[1] if p.noise_xx is None else p.noise_xx
    prior = np.zeros(c)
    prior[:nuisances] = 1.0
    highs = np.full(c, np.inf)
    highs[:nuisances] = FARTHEST
    lows = -highs
    if low is not None and high is not None:
        lows[nuisances:], highs[nuisances:] = low, high
    x = np.zeros(c)
    expected, size = noise, sizes(p.n, p.zz, noise)
    A = np.eye(c)
    for _ in range(_PASSES):
        weight = np.where(size > 1, 1 / np.maximum(size, 1.0), p.n / expected)
        share = weight * np.minimum(size, 1.0)  # of the noise expected that is there
        A = _weighted(weight, p.xx) + np.diag(prior)
        noisy = _correctable(_weighted(share, noise_xx), A)
        A = A - SAFE * noisy
        A = A + _RIDGE * np.diag(np.diag(A) + 1e-30)
        b = share @ noise_xz - weight @ p.xz + (1 - SAFE) * noisy @ x
        x = _within(A, b, np.asarray(np.linalg.solve(A, b), float), lows, highs)
        remaining = p.zz + 2 * p.xz @ x + p.xx @ x @ x
        expected = noise + 2 * noise_xz @ x + noise_xx @ x @ x
        expected = np.maximum(expected, QUIETEST * p.n)
        size = sizes(p.n, remaining, expected)
    penalty = float(prior @ x**2)
    return Solution(
        x,
        deviance(p.n, likely_sizes(p.n, remaining, expected, p.most, p.least)) + penalty,
        deviance(p.n, size) + penalty,
        size,
        np.asarray(np.linalg.inv(A), float),
    )


def _weighted(weight: Array, products: Array) -> Array:
    """Return (c, c) the sum of matrices (G, c, c) times weights (G,)."""
    return np.asarray(np.tensordot(weight, products, 1), float)


def _correctable(noisy: Array, full: Array) -> Array:
    """Return the part of the noise (c, c) in a curvature that a fit may take off.

    Of combinations of columns that are mostly noise the data say little, and that of the run
    at hand may be less than that of the draws: taken off as expected, nothing would hold their
    numbers. There it stays in, and draws them to zero, as described.

    Args:
        noisy: expected of noise alone.
        full: with prior; positive definite.
    """
    if not noisy.any():
        return noisy
    try:
        np.linalg.cholesky(_HALF * full - noisy)
        return noisy
    except np.linalg.LinAlgError:
        scale = 1 / np.sqrt(np.maximum(np.diag(full), 1e-30))
        values, axes = np.linalg.eigh(full * np.outer(scale, scale))
        lengths = np.sqrt(np.maximum(values, _RIDGE))  # of single precision: a little negative
        back = (axes / lengths).T
        share, way = np.linalg.eigh(back @ (noisy * np.outer(scale, scale)) @ back.T)
        way = (axes * lengths) @ way / scale[:, None]
        return np.asarray((way * np.minimum(share, np.maximum(1 - share, 0.0))) @ way.T)


def sizes(n: Array, squares: Array, noise: Array) -> Array:
    """Return (G,) mean squares in units of the noise, what is more than noise on top of it.

    Args:
        n: (G,) numbers in each group.
        squares: (G,) sums of squares.
        noise: (G,) those that noise alone would have.
    """
    excess = squares - noise
    return np.maximum(np.where(excess > 0, 1 + excess / n, squares / noise), 1e-12)


def likely_sizes(
    n: Array,
    squares: Array,
    noise: Array,
    most: Array | None = None,
    least: Array | None = None,
) -> Array:
    """Return (G,) the same for a likelihood, where noise passed on enlarged has its price.

    It widens what the model foretells, at the price of its density (log |V|), and of as much as
    there is: it foretells at most so much. Noise that a model damps earns nothing.

    Args:
        n, squares, noise: as for `sizes`.
        most, least: (G,) see `limits_of`; n and zero where None.
    """
    size = sizes(n, squares, np.minimum(noise, n if most is None else most))
    return np.maximum(size, 0.0 if least is None else least)


def deviance(n: Array, size: Array) -> float:
    """Return the profile deviance: twice the negative log-likelihood, group sizes eliminated.

    Args:
        n: (G,) numbers in each group.
        size: (G,) mean squares.
    """
    return float(deviances(n, size).sum())


def deviances(n: Array, size: Array) -> Array:
    """Return (G,) the parts of it that are of single groups.

    Args:
        n, size: as for `deviance`.
    """
    return np.asarray(n * np.where(size > 1, 1 + np.log(np.maximum(size, 1.0)), size))


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
