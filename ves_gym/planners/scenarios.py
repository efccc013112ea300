"""One motion on several machines: their energies, weighed as a mean or towards the worst.

E_mean is a quadratic form on every machine (`MeanEnergy`). `Risk` makes one smooth function of
them all, with first derivative and a positive second one, so that `direct`'s optimiser takes it
in place of a single energy.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.special

from ves_gym._util.params import Array
from ves_gym.mechanics.arm import Arm
from ves_gym.planners.direct import MotionProblem
from ves_gym.planners.mean_energy import MeanEnergy, running_integral
from ves_gym.planners.query import Query
from ves_gym.planners.sequential import minimise
from ves_gym.system.system import System

_COARSE = 1e-3  # relative decrease that ends the search for a scale


class Risk:
    """Mean or soft maximum of several energies, each over its scale, and a price on the first.

    With r = E / scale over all but the first machine: price E_0 / scale_0 + log(mean(exp(s r)))
    / s, which is the mean of r for s = 0 and tends to its largest. With `only` it is the energy
    of one machine over its scale.

    Args:
        forms: energies of the machines, the described one's first.
        groups: which momentum each is a function of; those of all groups follow one another.
    """

    def __init__(self, forms: Sequence[MeanEnergy], groups: Sequence[int]) -> None:
        self.forms, self.groups = forms, groups
        self.t, self.linear = forms[0].t, forms[0].linear
        self.scale = np.ones(len(forms))  # J
        self.sharpness = self.price = 0.0
        self.only: int | None = None
        sizes = [len(forms[groups.index(k)].hessian) for k in range(max(groups) + 1)]
        ends = np.cumsum([0, *sizes])
        self._slices = [slice(a, b) for a, b in itertools.pairwise(ends)]

    def energies(self, u: Array) -> Array:
        """E_mean on every machine [J] of the momenta of all groups."""
        pairs = zip(self.forms, self.groups, strict=True)
        return np.array([form.value(u[self._slices[g]]) for form, g in pairs])

    def value(self, u: Array) -> float:
        """The function itself [1]."""
        r = self.energies(u) / self.scale
        if self.only is not None:
            return float(r[self.only])
        if self.sharpness == 0:
            return float(self.price * r[0] + r[1:].mean())
        soft = scipy.special.logsumexp(self.sharpness * r[1:]) - np.log(len(r) - 1)
        return float(self.price * r[0] + soft / self.sharpness)

    def force(self, u: Array) -> Array:
        """Derivative of `value`."""
        out = np.zeros_like(u)
        parts = zip(self._weights(u), self.forms, self.groups, strict=True)
        for weight, form, g in parts:
            if weight:
                out[self._slices[g]] += weight * form.force(u[self._slices[g]])
        return out

    def curvature(self, u: Array, slope: Array) -> Array:
        """Second derivative of `value` along directions (k, k).

        Args:
            u: momenta of all groups, one after another.
            slope: (size of u, k) derivatives of u by k variables.
        """
        weights, k = self._weights(u), slope.shape[1]
        out = np.zeros((k, k))
        for g, part in enumerate(self._slices):
            pairs = zip(weights, self.forms, self.groups, strict=True)
            parts = [w * form.hessian for w, form, at in pairs if at == g and w]
            if parts:
                out += slope[part].T @ (sum(parts) @ slope[part])
        if self.sharpness == 0 or self.only is not None:
            return out
        scaled = list(zip(self.forms, self.groups, self.scale, strict=True))[1:]
        rows = np.array(
            [
                slope[self._slices[g]].T @ form.force(u[self._slices[g]]) / size
                for form, g, size in scaled
            ]
        )
        share = weights[1:] * self.scale[1:]
        mean = share @ rows
        out += self.sharpness * ((rows.T * share) @ rows - np.outer(mean, mean))
        return out

    def _weights(self, u: Array) -> Array:
        """Derivative of `value` by every machine's energy (k,) [1/J]."""
        if self.only is not None:
            return np.eye(len(self.scale))[self.only] / self.scale
        r = self.energies(u)[1:] / self.scale[1:]
        share = scipy.special.softmax(self.sharpness * r)
        return np.r_[self.price, share] / self.scale


class ScenarioProblem(MotionProblem):
    """The problem of `direct` with the energies of several machines (`risk`).

    The first is the query's own. Where another has another arm, its servo is still fed
    forward as described. Torque limits hold with the arms of `limited`: places in `arms`, the
    described one first.
    """

    def __init__(self, query: Query, free: int, others: Sequence[System]) -> None:
        self.systems = [query.system, *others]
        self.arms = arms = list(dict.fromkeys(system.arm for system in self.systems))
        self.limited = range(len(arms))
        groups = [arms.index(system.arm) for system in self.systems]
        super().__init__(query, free)
        middle = (self.start + self.goal) / 2
        assert isinstance(self.energy, MeanEnergy)
        forms = [self.energy, *(self.form_at(middle, system) for system in others)]
        self._others = [
            _OtherArm(
                replace(query, system=query.system.replace(arm=arm)),
                free,
                forms[groups.index(k)],
            )
            for k, arm in enumerate(arms)
            if k
        ]
        self.risk = Risk(forms, groups)
        self.energy = self.risk  # type: ignore[assignment]

    def known(self, x: Array) -> Array:
        """Least energy on every machine [J] of a motion made for it alone.

        Args:
            x: decision to start from.
        """
        risk, out = self.risk, []
        for k, group in enumerate(risk.groups):
            risk.only, self.limited = k, range(group, group + 1)
            out.append(minimise(self, x, tolerance=_COARSE).energy * risk.scale[k])
        risk.only, self.limited = None, range(len(self.arms))
        return np.array(out)

    def form_at(self, at: Array, system: System | None = None) -> MeanEnergy:  # type: ignore[override]
        """E_mean on a machine whose servo is fed forward by the query's arm.

        Args:
            at: (n,) configuration of the frozen inertia [rad].
            system: another one than the query's.
        """
        return super().form_at(at, system, described=self.arm)

    def energies(self, x: Array) -> Array:
        """E_mean of a decision on every machine [J]."""
        return self.risk.energies(self.momentum(x)[0])

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples of every arm's momentum, one after another, and their derivative."""
        parts = [super().momentum(x), *(own.momentum(x) for own in self._others)]
        return np.concatenate([u for u, _ in parts]), np.vstack([slope for _, slope in parts])

    def _torque(self, x: Array) -> tuple[Array, Array]:
        parts = [self._others[k - 1]._torque(x) for k in self.limited if k]
        if 0 in self.limited:
            parts.append(super()._torque(x))
        return np.concatenate([v for v, _ in parts]), np.vstack([s for _, s in parts])

    def add_torque_samples(self, x: Array) -> bool:
        """Sample each arm's torque also at its peaks; True if any passes its share."""
        found = [self._others[k - 1].add_torque_samples(x) for k in self.limited if k]
        if 0 in self.limited:
            found.append(super().add_torque_samples(x))
        return any(found)


class _OtherArm(MotionProblem):
    """Momentum and torque of another arm, its servo fed forward as `energy` says."""

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples u (N (6 + n)) with the torque that is lacking, and their derivative."""
        u, slope = super().momentum(x)
        described = self.energy.described if isinstance(self.energy, MeanEnergy) else None
        if described is None:
            return u, slope
        lacking, by = self._lacking(described, x)
        count = len(self.energy.t)
        samples = np.hstack([u.reshape(count, -1), lacking])
        slopes = np.concatenate([slope.reshape(count, 6, -1), by], axis=1)
        return samples.ravel(), slopes.reshape(samples.size, -1)

    def _lacking(self, described: Arm, x: Array) -> tuple[Array, Array]:
        """Torque beyond the described arm's, over time [N m s] (N, n), and by x."""
        bases = self._sampled(self.energy.t / self.query.duration, 3)
        own, fed = self.torque(x, bases), self.torque(x, bases, described)
        total = running_integral(self.energy.t)
        lacking: Array = total @ (own.tau - fed.tau)
        by = np.tensordot(total, own.by - fed.by, axes=1)
        return lacking, by.reshape(*lacking.shape, -1)
