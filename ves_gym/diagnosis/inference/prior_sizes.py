"""`likeliest_sizes`: how large the weights of regressions are a priori, chosen by the data.

Weights of a regression have independent normal priors of one size, and many of them are worth
nothing where there is nothing to find. The size of the largest marginal likelihood says so: it
weighs what the weights explain against how many values of them would have explained less.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.variance_groups import InnerProducts

_SWEEPS = 2  # over the regressions


def likeliest_sizes(
    inner: InnerProducts,
    freedom: Array,
    widths: Sequence[int],
    p: int,
    choices: Sequence[float],
) -> list[float]:
    """Return the size of each regression with the largest marginal likelihood, 0 for none.

    Groups keep the sizes that are left. A regression that is there costs its choice.

    Args:
        inner: products of p tolerances, the regressions' columns, and others that are free.
        left: (G,) mean squares of the groups.
        widths: weights of each regression.
        p: tolerances.
        choices: sizes to choose from, in the unit of the weights; 0 among them.
    """
    weight = 1 / np.maximum(freedom, 1.0)
    A = np.einsum("g,gij->ij", weight, inner.xx)
    b = -weight @ inner.xz
    n = sum(widths)
    A[:p, :p] += np.eye(p)
    others = np.r_[:p, p + n : len(A)]
    mine = np.arange(p, p + n)
    inside = A[np.ix_(others, others)]
    inside = inside + 1e-9 * np.diag(np.diag(inside) + 1e-30)
    solved = np.linalg.solve(inside, np.column_stack([A[np.ix_(others, mine)], b[others]]))
    across = A[np.ix_(mine, others)]
    A, b = A[np.ix_(mine, mine)] - across @ solved[:, :-1], b[mine] - across @ solved[:, -1]
    choice = float(np.log(inner.n.sum()))

    def cost(sizes: Sequence[float]) -> float:
        scale = np.concatenate([np.full(w, s) for w, s in zip(widths, sizes, strict=True)])
        there = np.flatnonzero(scale)
        s = scale[there]
        H = np.eye(len(there)) + s[:, None] * A[np.ix_(there, there)] * s
        g = s * b[there]
        gain = float(g @ np.linalg.solve(H, g)) - float(np.linalg.slogdet(H)[1])
        return np.count_nonzero(sizes) * choice - gain

    sizes = [0.0] * len(widths)
    for _ in range(_SWEEPS):
        for k in range(len(sizes)):
            sizes = min(([*sizes[:k], s, *sizes[k + 1 :]] for s in choices), key=cost)
    return sizes
