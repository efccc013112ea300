"""A model of the residual that has no name: torque regressed on all angles, the rate of each
joint and how it has moved before, force on the base's ways and rates, and how much belief there
is in that.

The regression (`joint/unknown`, `joint/curves`, `joint/memory`, `base/unknown`) is fitted with
nuisances and sizes of groups as any effect is. Its weights have normal priors, whose size at
each joint is that of the largest marginal likelihood. It is written where runs held back are
more probable with it and no channel of theirs is worse. It takes no place from a name: a law
that is quite the machine's is rare, and that many free numbers would beat most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from ves_gym._util.params import Array
from ves_gym.diagnosis.inference.base_laws import base_regressions
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.fit import Fit, columns_of, evaluate_residuals
from ves_gym.diagnosis.inference.held_back import LOSS, gaps, losses
from ves_gym.diagnosis.inference.model_selection import Rival, Selection, Thresholds
from ves_gym.diagnosis.inference.prior_sizes import likeliest_sizes
from ves_gym.diagnosis.inference.variance_groups import (
    InnerProducts,
    Solution,
    products,
    solve,
)
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.effects.joint_unnamed import (
    KNOTS,
    LEVELS,
    WEIGHTS,
    JointCurves,
    JointMemory,
    JointUnknown,
    monomials,
)
from ves_gym.system.candidate import Number, at_joint, placed

NOTHING, NONE_OF_THESE, LIBRARY = "nothing", "none of these", "library"
_SIZES = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)  # of weights, a priori [N m]
_ROUNDS = 2
_WIDER = 1.05  # of the angles seen
_FAR = (-50.0, 50.0)  # of a weight
_OF_FRICTION = (-500.0, 500.0)  # of one of several that all but agree [N m]
_SURE = 2.0  # log odds of what is decided by other grounds than evidence
_LEAST = 0.01  # probability of a rival that is listed by itself
_LISTED = 12


def regressions(residuals: WhitenedResiduals) -> list[Candidate]:
    """Return the regressions of each joint: over the angles that the runs have seen and its
    rate; over how far it has travelled since it turned and how long it has rested; and curves
    over its own angle, over that against the way it turns, and over its rate.

    Args:
        residuals: of the runs to fit.
    """
    q = np.concatenate([run["q"].reshape(-1, run["q"].shape[-1]) for run in residuals.runs])
    n, low, high = q.shape[1], q.min(axis=0), q.max(axis=0)
    middle = (low + high) / 2
    reach = np.maximum(_WIDER * (high - low) / 2, 1e-2)
    products = monomials(n)
    numbers = [Number(name, JointUnknown.unit_of(name), _FAR, (1.0,)) for name in WEIGHTS]
    for factors in products:
        name = " ".join(f"x{i + 1}" for i in factors)
        numbers.append(Number(name, JointUnknown.unit_of("surface"), _FAR, (1.0,)))
    out = []
    for joint in range(n):

        def fields(x: Array, joint: int = joint) -> dict[str, tuple[float, ...]]:
            weights = {
                name: at_joint(joint, n, w)
                for name, w in zip(WEIGHTS, x[: len(WEIGHTS)], strict=True)
            }
            surface = [w for value in x[len(WEIGHTS) :] for w in at_joint(joint, n, value)]
            return {
                "middle": tuple(middle),
                "reach": tuple(reach),
                "surface": tuple(surface),
                **weights,
            }

        out.append(placed(JointUnknown, f"joint {joint + 1}", numbers, fields))
    out += [_memory(joint, n) for joint in range(n)]
    v = np.concatenate([np.abs(run.joints.v) for run in residuals.runs])
    fastest = np.maximum(_WIDER * v.max(axis=0), 1e-2)
    at = {"middle": tuple(middle), "reach": tuple(reach), "fastest": tuple(fastest)}
    return out + [_curve(joint, n, name, at) for joint in range(n) for name in KNOTS]


def _memory(joint: int, n: int) -> Candidate:
    """Friction of a joint that depends on how it has moved."""

    def fields(x: Array) -> dict[str, tuple[float, ...]]:
        return {name: at_joint(joint, n, w) for name, w in zip(LEVELS, x, strict=True)}

    numbers = [Number(name, "N m", _OF_FRICTION, (1.0,)) for name in LEVELS]
    return placed(JointMemory, f"joint {joint + 1}", numbers, fields)


def _curve(joint: int, n: int, curve: str, at: dict[str, tuple[float, ...]]) -> Candidate:
    """One of the curves of a joint."""

    def fields(x: Array) -> dict[str, tuple[float, ...]]:
        return {**at, curve: tuple(w for height in x for w in at_joint(joint, n, height))}

    numbers = [Number(f"{curve} {k + 1}", "N m", _FAR, (1.0,)) for k in range(KNOTS[curve])]
    return placed(JointCurves, f"joint {joint + 1}", numbers, fields)


def unnamed(residuals: WhitenedResiduals, last: WhitenedResiduals, null: Fit) -> Fit | None:
    """Return the fit of what a description leaves at its joints and at its base in space; None
    where none is worth it.

    Args:
        residuals: of the runs fitted.
        last: of the runs held back.
        null: fit of the description as it is.
    """
    system = getattr(residuals.machine, "system", None)
    if system is None:
        return None
    tested, candidates = {p.name for p in residuals.ports}, []
    if "joint" in tested and system.drive == "motor":
        candidates += regressions(residuals)
    if "base" in tested:
        candidates += base_regressions(system)
    if not candidates:
        return None
    evidence = _Evidence(residuals, candidates)
    sizes = evidence.sizes()
    while any(sizes):
        fitted = evidence.fit(sizes)
        if barred := evidence.barred(sizes, fitted):
            sizes = [0.0 if k in barred else s for k, s in enumerate(sizes)]
            continue
        if losses(last, fitted, null) < -LOSS and not any(
            g.worse for g in gaps(last, fitted, null, False)
        ):
            return fitted
        lost = {}  # by leaving one out
        for place in np.flatnonzero(sizes).tolist():
            others = [s if k != place else 0.0 for k, s in enumerate(sizes)]
            lost[place] = losses(last, evidence.fit(others), null) if any(others) else 0.0
        sizes[min(lost, key=lambda place: lost[place])] = 0.0
    return None


class _Evidence:
    """Regressions whose weights have normal priors, of a size for each joint.

    Sizes are those of the largest marginal likelihood (Laplace, groups at the sizes left):
    weights that the data do not ask for stay near zero, and a joint without any gets size 0.
    """

    def __init__(self, residuals: WhitenedResiduals, candidates: Sequence[Candidate]) -> None:
        self._residuals, self._candidates = residuals, candidates
        self._p = len(residuals.nuisances)
        self._columns = np.hstack([columns_of(residuals, c) for c in candidates])
        self._inner = products(residuals, residuals.null, self._columns)

    def _solve(self, sizes: Sequence[float]) -> Solution:
        """Fit with weights in units of their sizes, those of size zero left out."""
        per_number = [np.full(c.k, s) for c, s in zip(self._candidates, sizes, strict=True)]
        scale = np.concatenate([np.ones(self._p), *per_number])
        at = np.flatnonzero(scale)
        scale = scale[at]
        inner = self._inner
        square = np.outer(scale, scale)
        return solve(
            InnerProducts(
                inner.n,
                inner.zz,
                inner.xz[:, at] * scale,
                inner.xx[:, at][:, :, at] * square,
                inner.noise,
                None if inner.noise_xz is None else inner.noise_xz[:, at] * scale,
                None if inner.noise_xx is None else inner.noise_xx[:, at][:, :, at] * square,
                inner.most,
                inner.least,
            ),
            len(at),
        )

    def sizes(self) -> list[float]:
        """The prior size of each regression's weights [N m], 0 where it has none."""
        widths, out = [c.k for c in self._candidates], [0.0] * len(self._candidates)
        for _ in range(_ROUNDS):  # what they explain gives more weight to its groups
            freedom = self._solve(out).size
            out = likeliest_sizes(self._inner, freedom, widths, self._p, _SIZES)
        return out

    def fit(self, sizes: Sequence[float]) -> Fit:
        """The fit with the regressions of some joints, which have these prior sizes."""
        solution, p = self._solve(sizes), self._p
        candidates = [c for c, _ in self._with(sizes)]
        edges = np.cumsum([c.k for c in candidates])[:-1]
        scale = np.concatenate([np.zeros(0), *(np.full(c.k, s) for c, s in self._with(sizes))])
        values = tuple(np.split(solution.x[p:] * scale, edges))
        std = np.sqrt(np.maximum(np.diag(solution.covariance)[p:], 0.0)) * scale
        z = evaluate_residuals(self._residuals, candidates, [values])[0]
        used = np.repeat(np.array(sizes) > 0, [c.k for c in self._candidates])
        return Fit(
            candidates=tuple(candidates),
            values=values,
            deviance=solution.deviance,
            std=tuple(np.split(std, edges)),
            size=solution.size,
            nuisances=solution.x[:p],
            residual=z,
            tangents=self._columns[:, used],
        )

    def barred(self, sizes: Sequence[float], fitted: Fit) -> list[int]:
        """Return the places of single numbers that a fit has below their range."""
        there = [k for k, size in enumerate(sizes) if size]
        pairs = zip(there, fitted.candidates, fitted.values, strict=True)
        return [k for k, c, x in pairs if c.k == 1 and x[0] < c.low[0]]

    def _with(self, sizes: Sequence[float]) -> list[tuple[Candidate, float]]:
        return [(c, s) for c, s in zip(self._candidates, sizes, strict=True) if s]


def evidence(selection: Selection, remaining: float, limits: Thresholds) -> tuple[float, float]:
    """Return the evidence for the best that the library has, and for none of it [deviance].

    Args:
        selection: the answer.
        remaining: deviance above that of noise which it leaves.
        limits: thresholds.
    """
    if not selection.rivals:
        first = selection.first
        names = min(first[1] - selection.needed[0], 0.0) if first else -np.inf
        return names, remaining - limits.remains
    gained = selection.null.deviance - selection.fit.deviance
    names = gained - sum(selection.needed[: len(selection.rivals)])
    tolerated = limits.explained / (1 - limits.explained) * gained
    return names, min(remaining - limits.remains, names + remaining - tolerated)


def beliefs(
    selection: Selection,
    names: float,
    none_of_these: float,
    decided: str | None,
    limits: Thresholds,
) -> dict[str, float]:
    """Return probabilities of "nothing", of library members and of "none of these": sum 1.

    Odds are exp(evidence / 2 T), evidence in deviance over the description as it is, less
    what the gates of the verdict ask for: at a gate the odds are even.

    Args:
        selection: the answer, with the rivals for each of its places.
        names: evidence for the best that the library has.
        none_of_these: evidence for something else.
        decided: the verdict's hypothesis, which is the most probable even where a fault of
            the recording or the runs held back have decided; None where there is none.
        limits: thresholds, with T.
    """
    gains = {NOTHING: 0.0, LIBRARY: names, NONE_OF_THESE: none_of_these}
    log_odds = {k: x / (2 * limits.temperature) for k, x in gains.items()}
    if decided is not None:
        others = max(x for k, x in log_odds.items() if k != decided)
        if log_odds[decided] < others:
            log_odds[decided] = others + _SURE
    highest = max(log_odds.values())
    weight = {k: float(np.exp(max(x - highest, -700.0))) for k, x in log_odds.items()}
    total = sum(weight.values())
    share = {k: x / total for k, x in weight.items()}
    return {
        NOTHING: share[NOTHING],
        **_members(selection, share[LIBRARY]),
        NONE_OF_THESE: share[NONE_OF_THESE],
    }


def doubting(believed: Mapping[str, float], trust: float) -> dict[str, float]:
    """Return probabilities that leave what the library's names are not trusted with to others.

    Args:
        believed: probabilities of "nothing", of library members and of "none of these".
        right: share of such names that are right.
    """
    ends = (NOTHING, NONE_OF_THESE)
    out = {k: p if k in ends else p * trust for k, p in believed.items()}
    out[NONE_OF_THESE] += sum(believed.values()) - sum(out.values())
    return out


def _members(selection: Selection, mass: float) -> Mapping[str, float]:
    """Divide the mass of the library among its members: sets of names that go together."""
    if not selection.rivals:
        first = selection.first
        return {} if first is None else {first[0].name: mass}
    listed: list[Sequence[Rival]] = [
        [r for r in rivals if r.probability > _LEAST][:_LISTED] for rivals in selection.rivals
    ]
    sets = {
        " + ".join(r.candidate.name for r in chosen): float(
            np.prod([r.probability for r in chosen])
        )
        for chosen in product(*listed)
    }
    best = dict(sorted(sets.items(), key=lambda item: -item[1])[:_LISTED])
    total = sum(best.values())
    return {name: mass * p / total for name, p in best.items()}
