"""Evidence: how probable the data are under a hypothesis, its numbers integrated out.

A hypothesis M has numbers x of its names, errors of the description, other forms of its laws
and weights of laws without a name, u. With the profile likelihood of the groups' sizes
(`variance_groups.py`), priors p(x) and u ~ N(0, 1) in units of their sizes, Laplace's method
at the most probable numbers gives

    -2 log p(data | M) = deviance(x, u) / T + |u|^2 + log |A| - sum(2 log p(x_i) + log 2 pi)

where A is the curvature of half the deviance over T in all numbers, with the unit prior of u on
its diagonal. T > 1 coarsens the likelihood (Miller and Dunson, J. Am. Stat. Assoc. 114, 2019):
no law is quite a machine's, and the data are weighed as if T of them told as much as one.

Of a number that multiplies what an effect does, p is a Cauchy law as wide as its usual size s:
1 / (pi s (1 + (x / s)^2)), since a size may be ten times the usual one at little cost. One that
gives a shape, such as a frequency, lies anywhere in its range.

Coordinates of a sparse cause are zero or not: those that are not clear are put to zero, at the
misfit that this makes, and the choice of the others is paid for: any is as likely, or, where
the library has the parts alone, each is likely to be there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.constants import CLEAR, PRESENT, TEMPERATURE
from ves_gym.diagnosis.inference.candidates import Candidate


def laplace(
    deviance: float,
    covariance: Array,
    fixed: Array,
    candidates: Sequence[Candidate],
    values: Sequence[Array],
    std: Sequence[Array],
) -> float:
    """Return -2 log p(data | M) of a fit, the choice of its names not counted.

    Args:
        deviance: with the penalties of all numbers that have a unit prior.
        covariance: (f + c, f + c) of those numbers and of the c of the names.
        fixed: (f,) numbers with a unit prior.
        candidates: names.
        values: (k,) numbers of each.
        std: (k,) their standard deviations.
    """
    price, retained, f = 0.0, [True] * len(fixed), len(fixed)
    curvature = [1 - 1 / TEMPERATURE] * f  # the rest of each number's prior curvature
    for c, x, error in zip(candidates, values, std, strict=True):
        free = np.ones(c.k, bool)
        if c.sparse:
            ratio = np.abs(x) / np.maximum(error, 1e-300)
            free = (ratio > CLEAR) | (ratio >= np.sort(ratio)[-c.least])
            price += _choice(c, int(free.sum()))
            at = len(curvature) + np.flatnonzero(~free)
            put = np.linalg.solve(covariance[np.ix_(at, at)], x[~free])
            price += float(x[~free] @ put) / TEMPERATURE
        price += math.fsum(_price(c, i, float(x[i])) for i in range(c.k) if free[i])
        retained += free.tolist()
        curvature += [_curvature(c, i, float(x[i])) for i in range(c.k)]
    A = np.linalg.inv(covariance) / TEMPERATURE + np.diag(curvature)
    penalty = float(fixed @ fixed)
    determinant = float(np.linalg.slogdet(A[np.ix_(retained, retained)])[1])
    return (deviance - penalty) / TEMPERATURE + penalty + price + determinant


def _choice(c: Candidate, there: int) -> float:
    """Return -2 log of the chance that just these coordinates of a cause are not zero."""
    if c.parts:
        return -2 * (there * math.log(PRESENT) + (c.k - there) * math.log(1 - PRESENT))
    return 2 * math.log(math.comb(c.k, there))


def _curvature(c: Candidate, i: int, x: float) -> float:
    """Return about the inverse variance of number i, where it is x, before the data."""
    if i in c.factors:
        return 1 / (max(abs(c.starts[0][i]), 1e-12) ** 2 + x**2)
    return 12 / max(c.high[i] - c.low[i], 1e-12) ** 2


def _price(c: Candidate, i: int, x: float) -> float:
    """Return -2 log p(x) - log 2 pi of number i of a candidate."""
    if i in c.factors:
        s = max(abs(c.starts[0][i]), 1e-12)
        return 2 * math.log(math.pi * s) + 2 * math.log1p((x / s) ** 2) - math.log(2 * math.pi)
    width = max(c.high[i] - c.low[i], 1e-12)
    return 2 * math.log(width) - math.log(2 * math.pi)
