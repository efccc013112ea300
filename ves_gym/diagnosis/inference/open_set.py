"""The open set: laws without a name, which compete with those of the library.

At a joint the residual is regressed on all angles, the rate and how the joint has moved before,
and on curves over its own angle and rate; at the base on springs and dampers. These are random
effects: weights have independent normal priors, of a size for each law that is the one of the
largest marginal likelihood (`prior_sizes.py`), none where that is zero. A hypothesis with them
stands beside that of its names alone, by the same evidence.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index
from ves_gym.diagnosis.constants import OPEN, OPEN_JOINTS, SIZES
from ves_gym.diagnosis.inference.candidates import Candidate
from ves_gym.diagnosis.inference.evidence import laplace
from ves_gym.diagnosis.inference.fit import Fit, columns_of, evaluate_residuals
from ves_gym.diagnosis.inference.prior_sizes import likeliest_sizes
from ves_gym.diagnosis.inference.variance_groups import (
    InnerProducts,
    Solution,
    products,
    scaled,
    solve,
)
from ves_gym.diagnosis.inference.whitened_residuals import WhitenedResiduals
from ves_gym.effects.base import BaseUnknown
from ves_gym.effects.joint_unnamed import (
    KNOTS,
    LEVELS,
    WEIGHTS,
    JointCurves,
    JointMemory,
    JointUnknown,
    monomials,
)
from ves_gym.mechanics.spatial import AXES
from ves_gym.mechanics.vehicle import Satellite
from ves_gym.system.candidate import Number, at_joint, placed
from ves_gym.system.system import System

Fields = dict[str, tuple[float, ...]]
_ROUNDS, _MOST = 2, 5  # sizes of weights and of groups, in turn
_WIDER = 1.05  # of the angles seen
_FAR = (-50.0, 50.0)  # of a weight
_STIFFER = (0.0, 1e4)  # of a base, in hundredths of what it has
_SLOW = 0.5  # Hz: stands for the spring of a base that has none
_OF_FRICTION = (-500.0, 500.0)  # of one of several that all but agree [N m]


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
    at = {"middle": tuple(middle), "reach": tuple(reach)}
    names = [*WEIGHTS, *("".join(f" x{i + 1}" for i in k)[1:] for k in monomials(n))]
    widths = {**dict.fromkeys(WEIGHTS, 1), "surface": len(names) - len(WEIGHTS)}
    units = [JointUnknown.unit_of(k if k in WEIGHTS else "surface") for k in names]
    numbers = [Number(k, u, _FAR, (1.0,)) for k, u in zip(names, units, strict=True)]
    out = [_of_joint(JointUnknown, joint, n, numbers, widths, at) for joint in range(n)]
    numbers = [Number(name, "N m", _OF_FRICTION, (1.0,)) for name in LEVELS]
    widths = dict.fromkeys(LEVELS, 1)
    out += [_of_joint(JointMemory, joint, n, numbers, widths, {}) for joint in range(n)]
    v = np.concatenate([np.abs(run.joints.v) for run in residuals.runs])
    at = {**at, "fastest": tuple(np.maximum(_WIDER * v.max(axis=0), 1e-2))}
    for joint, (curve, knots) in itertools.product(range(n), KNOTS.items()):
        numbers = [Number(f"{curve} {k + 1}", "N m", _FAR, (1.0,)) for k in range(knots)]
        out.append(_of_joint(JointCurves, joint, n, numbers, {curve: knots}, at))
    return out


def _of_joint(
    cls: type[Any],
    joint: int,
    n: int,
    numbers: Sequence[Number],
    widths: Mapping[str, int],
    known: Fields,
) -> Candidate:
    """A law of one of n joints: how many of the numbers each field has, and other fields."""

    def fields(x: Array) -> Fields:
        parts = np.split(x, np.cumsum(list(widths.values()))[:-1])
        spread = (tuple(w for value in k for w in at_joint(joint, n, value)) for k in parts)
        return {**known, **dict(zip(widths, spread, strict=True))}

    return placed(cls, f"joint {joint + 1}", numbers, fields)


def base_regressions(system: System) -> list[Candidate]:
    """Return springs and dampers more, one along each coordinate of the base.

    Weights are hundredths of the base's own stiffness, and of what damps it critically.

    Args:
        system: as described.

    Returns:
        Twelve; none of a satellite, which nothing holds.
    """
    if isinstance(system.vehicle, Satellite):
        return []
    base = system.base
    mass = np.diag(base.M)
    springs = np.maximum(np.diag(base.K), mass * (2 * np.pi * _SLOW) ** 2) / 100
    critical = 2 * np.sqrt(springs * mass / 100)
    sizes = {"stiffness": springs, "damping": critical}
    out = []
    for (name, size), (i, axis) in itertools.product(sizes.items(), enumerate(AXES)):

        def fields(x: Array, i: int = i, name: str = name, size: Array = size) -> Fields:
            return {name: tuple((np.eye(6)[i] * size * x[0]).tolist())}

        candidate = placed(BaseUnknown, axis, [Number(name, "1", _STIFFER, (1.0,))], fields)
        out.append(replace(candidate, ports=("base", "wrench")))  # as the library's are
    return out


class OpenSet:
    """Laws without a name at the joints and at the base of a machine, on its runs.

    Args:
        residuals: of the runs fitted.
        null: fit of the description as it is.
    """

    def __init__(self, residuals: WhitenedResiduals, null: Fit) -> None:
        self.residuals, self.candidates = residuals, _laws(residuals, null)
        self._widths = [c.k for c in self.candidates]
        parts = [columns_of(residuals, c) for c in self.candidates]
        self._columns = np.hstack(parts) if parts else np.zeros((residuals.length, 0))

    def fit(self, f: Fit) -> Fit:
        """Return a fit with the laws that its evidence asks for beside its names; else itself.

        The laws come after the names; their numbers are in the unit of the candidates.
        """
        if not self.candidates:
            return f
        r, p, m = self.residuals, len(self.residuals.nuisances), sum(self._widths)
        inner = products(r, f.residual, np.hstack([self._columns, f.tangents]))
        freedom, out, barred = f.size, f, set[int]()
        for turn in range(_MOST):
            sizes = likeliest_sizes(inner, freedom, self._widths, p, SIZES)
            sizes = [0.0 if k in barred else s for k, s in enumerate(sizes)]
            if not any(sizes):
                return f
            scale = np.r_[
                np.ones(p), np.repeat(sizes, self._widths), np.ones(f.tangents.shape[1])
            ]
            at = np.flatnonzero(scale)
            prior = int((at < p + m + len(f.forms)).sum())  # columns of a unit prior
            solution = solve(_taken(scaled(inner, scale), at), prior, *_room(f))
            out = self._fitted(f, sizes, scale, at, solution)
            laws = zip(np.flatnonzero(sizes), out.values[len(f.candidates) :], strict=True)
            single = ((int(k), x, self.candidates[k]) for k, x in laws)
            below = {k for k, x, c in single if c.k == 1 and x[0] < c.low[0]}
            if turn + 1 >= _ROUNDS and not below:
                break
            # what they explain gives more weight to its groups
            freedom, barred = solution.size, barred | below
        return out

    def _fitted(
        self, f: Fit, sizes: Sequence[float], scale: Array, at: Index, solution: Solution
    ) -> Fit:
        p, m, b = len(self.residuals.nuisances), sum(self._widths), len(f.forms)
        x, std = np.zeros(len(scale)), np.zeros(len(scale))
        x[at] = scale[at] * solution.x
        std[at] = scale[at] * np.sqrt(np.maximum(np.diag(solution.covariance), 0.0))
        laws = [(c, s) for c, s in zip(self.candidates, sizes, strict=True)]
        edges = np.cumsum(self._widths)[:-1]
        weights, deviations = (np.split(k[p : p + m], edges) for k in (x, std))
        named = np.cumsum([c.k for c in f.candidates])[:-1]
        moved = np.split(x[p + m + b :], named) if f.candidates else []
        values = [v + d for v, d in zip(f.values, moved, strict=True)]
        uncertain = np.split(std[p + m + b :], named) if f.candidates else []
        taken = [k for k, (_, s) in enumerate(laws) if s]
        likely = laplace(
            solution.deviance,
            solution.covariance,
            solution.x[: int((at < p + m + b).sum())],
            f.candidates,
            values,
            uncertain,
        )
        every = (*f.candidates, *(self.candidates[k] for k in taken))
        numbers = (*values, *(weights[k] for k in taken))
        return Fit(
            candidates=every,
            values=numbers,
            deviance=solution.deviance,
            std=(*uncertain, *(deviations[k] for k in taken)),
            size=solution.size,
            nuisances=x[:p],
            residual=evaluate_residuals(self.residuals, every, [numbers])[0],
            tangents=f.tangents,
            forms=x[p + m : p + m + b],
            evidence=likely + OPEN + len(taken) * 2 * float(np.log(len(self.candidates))),
        )


def _laws(residuals: WhitenedResiduals, null: Fit) -> list[Candidate]:
    """Return laws for the joints where most is unexplained, and for the base."""
    system = getattr(residuals.machine, "system", None)
    tested, out = {p.name for p in residuals.ports}, list[Candidate]()
    if system is None:
        return out
    if "joint" in tested and system.drive == "motor":
        excess = np.zeros(system.arm.n)
        for g, size in zip(residuals.groups, null.size, strict=True):
            if g.port == "joint":
                excess[g.channel] += g.n * np.log(max(float(size), 1.0))
        slots = {f"joint {i + 1}" for i in np.argsort(-excess)[:OPEN_JOINTS]}
        out += [c for c in regressions(residuals) if c.slot in slots]
    if "base" in tested:
        out += base_regressions(system)
    return out


def _room(f: Fit) -> tuple[Array, Array]:
    """Return how far the numbers of names may go, down and up; shapes are no linear matter."""
    low, high = [], []
    for c, x in zip(f.candidates, f.values, strict=True):
        free = np.isin(np.arange(c.k), c.factors) & (not c.sets_in)
        low.append(np.where(free, np.array(c.low) - x, 0.0))
        high.append(np.where(free, np.array(c.high) - x, 0.0))
    none = [np.zeros(0)]
    return np.concatenate([*low, *none]), np.concatenate([*high, *none])


def _taken(inner: InnerProducts, at: Index) -> InnerProducts:
    """Return products of some of the columns."""
    square = np.ix_(np.arange(len(inner.n)), at, at)
    return replace(
        inner,
        xz=inner.xz[:, at],
        xx=inner.xx[square],
        noise_xz=None if inner.noise_xz is None else inner.noise_xz[:, at],
        noise_xx=None if inner.noise_xx is None else inner.noise_xx[square],
    )
