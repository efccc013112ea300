"""How far a further run would hold rivals apart: expected differences in log-likelihood.

If rival a is the truth, a run that is still to be made has the residual d = z_b - z_a under
rival b, of which b explains what its numbers and the tolerances can, at the price of what the
runs at hand say of them: the least of |d + X x|^2 + x^T P x, P the precision they leave. Half
of it is the Kullback-Leibler divergence, its root a distance in standard deviations. Motions
that make it large are T-optimal (Atkinson and Fedorov, Biometrika 62, 1975). Where nothing is
named because nothing could have been seen, the information on the candidates that could not
counts instead (D-optimality).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.fit import Fit, evaluate_residuals, fit, linearised
from ves_gym.diagnosis.inference.model_selection import Rival, Selection
from ves_gym.diagnosis.inference.variance_groups import SAFE
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals


@dataclass(frozen=True, eq=False)
class LinearHypothesis:
    """A fit that may be the truth, and how sure the runs at hand are of its numbers."""

    name: str  # of what it has and its rivals have not
    fit: Fit
    tolerances: dict[str, float]  # of the m tolerances of the machine, in their usual size
    precision: Array  # (m + c, m + c) of these and of the c tangents
    sizes: dict[tuple[str, int, float], float]  # mean square left: port, channel, frequency

    def at(self, new: WhitenedResiduals) -> tuple[Array, Array]:
        """Return tolerances (m',) and precision (m' + c, m' + c) of what a further run shows.

        Args:
            new: residuals of the run, of all ports or of some.
        """
        every = list(self.tolerances)
        indices = [every.index(k.name) for k in new.nuisances[: new.shared]]
        retained = np.r_[np.array(indices, int), len(every) : len(self.precision)]
        values = np.array(list(self.tolerances.values()))[indices]
        return values, _marginal(self.precision, retained)


def hypothesis(residuals: WhitenedResiduals, full: Fit, name: str) -> LinearHypothesis:
    """Return a fit with the precision that these runs leave; what single runs have is out.

    Args:
        residuals: that were fitted.
        full: the fit.
        name: of it.
    """
    m, p = residuals.shared, residuals.slopes.shape[1]
    X = np.hstack([residuals.slopes, full.tangents])
    numbers = sum(c.k for c in full.candidates)
    blurs = full.tangents.shape[1] - numbers
    A = np.diag(np.r_[np.ones(p + blurs), np.zeros(numbers)])
    for g, size in zip(residuals.groups, full.size, strict=True):
        x = X[g.part]
        noisy = SAFE * residuals.noise_product(g, X)
        A += (x.T @ x - noisy) / max(float(size), 1.0)
    names = [k.name for k in residuals.nuisances[:m]]
    return LinearHypothesis(
        name,
        full,
        dict(zip(names, full.nuisances[:m].tolist(), strict=True)),
        _marginal(A, np.r_[0:m, p : len(A)]),
        {
            (g.port, g.channel, g.low): max(float(size), 1.0)
            for g, size in zip(residuals.groups, full.size, strict=True)
        },
    )


def _marginal(precision: Array, retained: Array) -> Array:
    """Return the precision of some numbers where nothing is known of the others."""
    out = np.setdiff1d(np.arange(len(precision)), retained)
    across = precision[np.ix_(out, retained)]
    inner = precision[np.ix_(retained, retained)]
    return np.asarray(
        inner - across.T @ np.linalg.solve(precision[np.ix_(out, out)], across), float
    )


def rival_hypotheses(
    residuals: WhitenedResiduals, selection: Selection, place: int, alike: float, most: int
) -> list[LinearHypothesis]:
    """Return the rivals for a place in the answer as hypotheses, the answer itself first.

    Args:
        residuals: that were fitted.
        selection: the answer.
        place: of the effect whose rivals count.
        alike: difference in cost below which two candidates are one class.
        most: at the most so many; other kinds go before other places of a kind.
    """
    every, answer = selection.rivals[place], selection.fit
    near = [r for r in every[1:] if r.cost - every[0].cost < alike]
    kinds = {every[0].candidate.kind}
    first_of_kind: list[Rival] = []
    others: list[Rival] = []
    for r in near:
        (others if r.candidate.kind in kinds else first_of_kind).append(r)
        kinds.add(r.candidate.kind)
    out = [hypothesis(residuals, answer, every[0].candidate.name)]
    for r in (first_of_kind + others)[: most - 1]:
        candidates, values = list(answer.candidates), list(answer.values)
        candidates[place], values[place] = r.candidate, r.values
        out.append(hypothesis(residuals, fit(residuals, candidates, values), r.candidate.name))
    return out


def separations(new: WhitenedResiduals, rivals: Sequence[LinearHypothesis]) -> Array:
    """Return the deviance that a further run is expected to hold against each rival.

    Args:
        new: residuals of the run as one of them would have it, without noise.
        rivals: h hypotheses from runs at hand.

    Returns:
        (h, h): the truth in rows, what is wrong in columns; zero on the diagonal.
    """
    under = [linearised(new, h.fit.candidates, h.fit.values) for h in rivals]
    at_hand = [h.at(new) for h in rivals]
    J, m, weight = new.slopes, new.shared, _weights(new, rivals[0])
    out = np.zeros((len(rivals), len(rivals)))
    for b, ((wrong, precision), (z, tangents)) in enumerate(zip(at_hand, under, strict=True)):
        d = [
            z - z_true + J[:, :m] @ (wrong - true)
            for (true, _), (z_true, _) in zip(at_hand, under, strict=True)
        ]
        out[:, b] = np.diag(_unexplained(new, tangents, weight, precision, np.stack(d, 1)))
    return out


def visibility(
    new: WhitenedResiduals, at_hand: LinearHypothesis, faint: Sequence[Candidate]
) -> Array:
    """Return the information of a further run on candidates, at their usual size.

    Args:
        new: residuals of the run as described, without noise.
        at_hand: what the runs at hand say.
        faint: c candidates.

    Returns:
        (c, c), in variances of noise; tolerances and what is named already are projected out.
    """
    _, tangents = linearised(new, at_hand.fit.candidates, at_hand.fit.values)
    weight, precision = _weights(new, at_hand), at_hand.at(new)[1]
    columns = [
        evaluate_residuals(new, [c], [[np.array(c.starts[0])]])[0] - new.null for c in faint
    ]
    return _unexplained(new, tangents, weight, precision, np.stack(columns, axis=1))


def _unexplained(
    new: WhitenedResiduals, tangents: Array, weight: Array, precision: Array, d: Array
) -> Array:
    """Return the products (c, c) of residuals (N, c) that numbers with a prior leave."""
    X = np.hstack([new.slopes, tangents])
    retained = np.r_[0 : new.shared, new.slopes.shape[1] : X.shape[1]]
    A = np.eye(X.shape[1])  # what is of the new run alone has a unit prior
    A[np.ix_(retained, retained)] = precision
    weighted = X * weight[:, None]
    A += X.T @ weighted
    across = weighted.T @ d
    solved = np.linalg.solve(A + 1e-9 * np.diag(np.diag(A) + 1e-30), across)
    return np.asarray(d.T @ (d * weight[:, None]) - across.T @ solved)


def _weights(new: WhitenedResiduals, at_hand: LinearHypothesis) -> Array:
    """Return (N,) weights: what is more than noise at hand will be more than noise again."""
    out = np.zeros(new.length)
    for g in new.groups:
        out[g.part] = 1 / at_hand.sizes[g.port, g.channel, g.low]
    return out
