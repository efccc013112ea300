"""Plans for a machine that is known within ranges: least mean or worst energy at a price.

Scenarios are the ends of the ranges: a user's, or a diagnosis's 90 % intervals. E_mean is a
quadratic form on every machine (`MeanEnergy`); `Risk` makes one smooth function of them all,
which the optimiser of `direct` takes in place of a single energy. The energy on each machine
counts over the least that a motion made for it alone has there (`ScenarioProblem.known`), so
what is minimised is the cost of not knowing; what it may cost as described is limited.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.linalg
import scipy.special

from ves_gym._util.params import Array, ParameterError, read_result, read_table, require_one_of
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import has
from ves_gym.planners.motion_problem import MotionProblem, beside, stacked
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.query import Query, first_violation
from ves_gym.planners.refine import FREE, Refined
from ves_gym.planners.sequential import minimise
from ves_gym.system.candidate import Scope
from ves_gym.system.effect import EFFECTS, ArmEffect, BaseEffect
from ves_gym.system.system import System

Ranges = Mapping[str, Mapping[str, Any]]  # effect -> parameter -> (low, high), as `randomize`
# what is seldom known better of a structure in orbit and of what the arm holds
UNCERTAIN: Ranges = {
    "base/stiffness": {"error": (-0.2, 0.2)},
    "base/damping": {"error": (-0.9, 1.0)},
    "payload/mass": {"mass": (0.0, 5.0)},
}
OBJECTIVES = ("mean", "worst")
_FULL = 3  # uncertain numbers up to which every corner of their box is a scenario
_SHARPNESS = 20.0  # of the soft maximum, over the largest ratio: within log(k) / 20 of it
_ROUNDS = 6  # of finding the multiplier that keeps the price
_SPAN = 3.0  # of its logarithm, searched at first
_NEAR_PRICE = 0.01  # of the price that may be left
_TOLERANCE = 1e-4  # relative decrease that ends an optimisation


class Robust:
    """Least energy over scenarios of an uncertain machine, at a limited nominal price.

    Args:
        uncertain: {effect: {parameter: (low, high)}}, as environments take it; those that a
            vehicle cannot have are left out.
        price: largest E_mean on the machine as described over that of the nominal optimum.
        objective: "mean" over the scenarios of the energy over what knowing the machine would
            give, or "worst" (a soft maximum).
        free: control points of the answer.
        name: of the planner.
        around: machine that the ranges deviate from; default the query's.
    """

    def __init__(
        self,
        uncertain: Ranges = UNCERTAIN,
        *,
        price: float = 1.15,
        objective: str = "mean",
        free: int = FREE,
        name: str = "robust",
        around: System | None = None,
    ) -> None:
        require_one_of("objective", objective, OBJECTIVES)
        if not (price >= 1 and math.isfinite(price)):
            raise ParameterError(f"price must be >= 1, got {price}")
        self.uncertain, self.price, self.objective = uncertain, price, objective
        self.free, self.name, self.around = free, name, around
        self.summary = (
            f"least {objective} predicted E_mean over an uncertain machine, each over what it"
            f" could be, at most {price:g} x the nominal optimum on the machine as described"
        )

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Minimise the objective over the scenarios, with the price on the described machine.

        `info` has the energies [J] of the nominal optimum, of the answer, and of motions made
        for each machine alone (`known`), on the machine as described and in every scenario.
        """
        nominal, info = Refined(self.free).find(query, seed)
        problem = ScenarioProblem(
            query, self.free, scenarios(self.around or query.system, self.uncertain)
        )
        x0 = problem.of(nominal)
        before = problem.energies(x0)
        informed, best_x = problem.informed(x0), x0
        if (informed > 0).all():
            best_x = self._least(problem, x0, before, informed)
        after = problem.energies(best_x)
        return (nominal if best_x is x0 else problem.motion(best_x)), {
            "scenarios": len(after) - 1,
            "price": float(after[0] / before[0]) if before[0] > 0 else 1.0,
            "nominal": {"energies": before.tolist()},
            "energies": after.tolist(),
            "known": informed.tolist(),
            "message": info.get("message", ""),
        }

    def _least(
        self, problem: ScenarioProblem, x0: Array, before: Array, informed: Array
    ) -> Array:
        """Return the best decision within the price, x0 where there is none better.

        Where the torque of every arm cannot be kept at the price, that of the described one is.

        Args:
            problem: of all scenarios.
            x0: the nominal optimum. before: its energies [J].
            informed: least energies [J], the scales.
        """
        risk = problem.risk
        risk.scale = np.r_[before[0], informed[1:]]
        if self.objective == "worst":
            risk.sharpness = _SHARPNESS / float((before / risk.scale)[1:].max())
        best, least = x0, problem.objective(x0)
        for limited in (range(len(problem.arms)), range(1)):
            problem.limited = limited
            for x in self._tried(problem, x0):
                if first_violation(problem.query, problem.motion(x)) is not None:
                    continue
                value = problem.objective(x)
                if problem.price(x) <= self.price and value < least:
                    best, least = x, value
            if best is not x0:
                break
        return best

    def _tried(self, problem: ScenarioProblem, x0: Array) -> Iterator[Array]:
        """Optima with a multiplier on the price, until it is just satisfied.

        Were the energies quadratic between x0 and the optimum without a price, then on the way,
        by the share s of it, price - 1 would go with s^2 and the multiplier with (1 - s) / s:
        the first guess. Then the secant in its logarithm, halving where that leads astray.
        """
        risk = problem.risk
        most = self.price - 1
        start = problem.objective(x0)
        x = free = minimise(problem, x0, tolerance=_TOLERANCE).x
        yield x
        spent, gained = problem.price(x) - 1, start - problem.objective(x)
        if spent <= most or most == 0 or gained <= 0:
            return
        s = math.sqrt(most / spent)
        level = math.log(gained / spent * (1 - s) / s)
        low, high = (level - _SPAN, spent), (math.inf, 0.0)  # too little, enough
        for _ in range(_ROUNDS):
            risk.weights[0] = math.exp(level)
            x = minimise(problem, x0 + s * (free - x0), tolerance=_TOLERANCE).x
            risk.weights[0] = 0.0
            yield x
            paid = problem.price(x) - 1
            if most - _NEAR_PRICE <= paid <= most:
                return
            low, high = (low, (level, paid)) if paid <= most else ((level, paid), high)
            if math.isinf(high[0]):
                level += _SPAN / 2
                continue
            share = (low[1] - most + _NEAR_PRICE / 2) / (low[1] - high[1])
            level = low[0] + min(max(share, 0.2), 0.8) * (high[0] - low[0])


def scenarios(system: System, uncertain: Ranges) -> list[System]:
    """Return machines at the ends of uncertain ranges, with their effects in them.

    All corners of the box of up to three numbers; of more, the rows of a Hadamard matrix, in
    which every number stands at either end as often, and every pair at all four.

    Raises:
        ParameterError: nothing is uncertain, or as `randomize` refuses it.
    """
    from ves_gym.envs.randomize import Draws, ranges_of  # loads Gymnasium

    fits = {
        "base/stiffness": has(system.vehicle, "K"),
        "base/damping": has(system.vehicle, "D"),
    }
    ranges = ranges_of({k: v for k, v in uncertain.items() if fits.get(k, True)})
    if not ranges:
        raise ParameterError("a robust plan needs at least one uncertain parameter, got none")
    draws = Draws(system.ideal(), ranges)
    corners = _corners(draws.size)
    rows = draws.rows(corners)
    return [rows.system(k).actual for k in range(len(corners))]


def _corners(size: int) -> Array:
    """(k, size) of zeros and ones."""
    if size <= _FULL:
        return np.array([*itertools.product((0.0, 1.0), repeat=size)])[:, ::-1]
    order = 2 ** math.ceil(math.log2(size + 1))
    signs = scipy.linalg.hadamard(order)[:, 1 : size + 1]
    return np.asarray((signs + 1) / 2, dtype=np.float64)


_COARSE = 1e-3  # relative decrease that ends the search for a scale


class Risk:
    """Mean or soft maximum of several energies, each over its scale, and a price on the first.

    With r = E / scale over all but the first machine: price E_0 / scale_0 + log(mean(exp(s r)))
    / s, which is the mean of r for s = 0 and tends to its largest. `weights` are the price and
    those of the mean.

    Args:
        forms: energies of the machines, the described one's first.
        groups: which momentum each is a function of; those of all groups follow one another.
    """

    def __init__(self, forms: Sequence[MeanEnergy], groups: Sequence[int]) -> None:
        self.forms, self.groups = forms, groups
        self.t, self.linear = forms[0].t, forms[0].linear
        self.scale = np.ones(len(forms))  # J
        self.sharpness = 0.0
        self.weights = np.r_[0.0, np.full(len(forms) - 1, 1 / (len(forms) - 1))]
        sizes = [len(forms[groups.index(k)].hessian) for k in range(max(groups) + 1)]
        ends = np.cumsum([0, *sizes]).tolist()
        self.parts = [slice(ends[g], ends[g + 1]) for g in groups]  # of u, per machine

    def energies(self, u: Array) -> Array:
        """E_mean on every machine [J] of the momenta of all groups."""
        pairs = zip(self.forms, self.parts, strict=True)
        return np.array([form.value(u[part]) for form, part in pairs])

    def value(self, u: Array) -> float:
        """The function itself [1]."""
        r = self.energies(u) / self.scale
        if self.sharpness == 0:
            return float(self.weights @ r)
        soft = scipy.special.logsumexp(self.sharpness * r[1:]) - np.log(len(r) - 1)
        return float(self.weights[0] * r[0] + soft / self.sharpness)

    def force(self, u: Array) -> Array:
        """Derivative of `value`."""
        out = np.zeros_like(u)
        for weight, form, part in zip(self._weights(u), self.forms, self.parts, strict=True):
            if weight:
                out[part] += weight * form.force(u[part])
        return out

    def curvature(self, u: Array, slope: Array) -> Array:
        """Second derivative of `value` (k, k) along directions: `slope` of u (size of u, k)."""
        weights, k = self._weights(u), slope.shape[1]
        out = np.zeros((k, k))
        for g in range(max(self.groups) + 1):  # machines of one momentum at once
            members = [i for i, at in enumerate(self.groups) if at == g and weights[i]]
            if members:
                directions = slope[self.parts[members[0]]]
                hessian = sum(weights[i] * self.forms[i].hessian for i in members)
                out += directions.T @ (hessian @ directions)
        if self.sharpness == 0:
            return out
        scaled = list(zip(self.forms, self.parts, self.scale, strict=True))[1:]
        rows = np.array([slope[at].T @ form.force(u[at]) / size for form, at, size in scaled])
        share = weights[1:] * self.scale[1:]
        mean = share @ rows
        out += self.sharpness * ((rows.T * share) @ rows - np.outer(mean, mean))
        return out

    def _weights(self, u: Array) -> Array:
        """Derivative of `value` by every machine's energy (k,) [1/J]."""
        if self.sharpness == 0:
            return self.weights / self.scale
        r = self.energies(u)[1:] / self.scale[1:]
        share = scipy.special.softmax(self.sharpness * r)
        return np.r_[self.weights[0], share] / self.scale


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
            _OtherArm(replace(query, system=query.system.replace(arm=arm)), free, forms[first])
            for arm, first in ((arm, groups.index(k)) for k, arm in enumerate(arms) if k)
        ]
        self.risk = Risk(forms, groups)
        self.energy = self.risk  # type: ignore[assignment]

    def informed(self, x: Array) -> Array:
        """Least energy on every machine [J] of a motion made for it alone, starting from x."""
        usual, out = self.risk.weights, []
        for alone, group in zip(np.eye(len(usual)), self.risk.groups, strict=True):
            self.risk.weights, self.limited = alone, range(group, group + 1)
            out.append(minimise(self, x, tolerance=_COARSE).energy)
        self.risk.weights, self.limited = usual, range(len(self.arms))
        return np.array(out) * self.risk.scale

    def form_at(self, at: Array, system: System | None = None) -> MeanEnergy:  # type: ignore[override]
        """E_mean on a machine whose servo is fed forward by the query's arm."""
        return super().form_at(at, system, described=self.arm)

    def energies(self, x: Array) -> Array:
        """E_mean of a decision on every machine [J]."""
        return self.risk.energies(self.momentum(x)[0])

    def objective(self, x: Array) -> float:
        """Risk of a decision; its price is added where the problem has one."""
        return self.risk.value(self.momentum(x)[0])

    def price(self, x: Array) -> float:
        """Energy on the machine as described over that of the nominal optimum."""
        return float(self.energies(x)[0] / self.risk.scale[0])

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples of every arm's momentum, one after another, and their derivative."""
        return stacked([super().momentum(x), *(other.momentum(x) for other in self._others)])

    def _torque(self, x: Array) -> tuple[Array, Array]:
        parts = [self._others[k - 1]._torque(x) for k in self.limited if k]
        if 0 in self.limited:
            parts.append(super()._torque(x))
        return stacked(parts)

    def add_torque_samples(self, x: Array) -> bool:
        """Sample each arm's torque also at its peaks; True if any passes its share."""
        best_x = [self._others[k - 1].add_torque_samples(x) for k in self.limited if k]
        if 0 in self.limited:
            best_x.append(super().add_torque_samples(x))
        return any(best_x)


class _OtherArm(MotionProblem):
    """Momentum and torque of another arm, its servo fed forward as `energy` says."""

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples u with the torque beyond the described arm's, and their derivative."""
        u, slope = super().momentum(x)
        described = self.energy.described if isinstance(self.energy, MeanEnergy) else None
        if described is None:
            return u, slope
        bases = self.sampled(self.energy.t / self.query.duration, 3)
        other, fed = self.torque(x, bases), self.torque(x, bases, described)
        return beside(self.energy.t, u, slope, other.tau - fed.tau, other.by - fed.by)


DIAGNOSIS = "ves-diagnose/1"


@dataclass(frozen=True)
class Uncertainty:
    """Ranges of effects about a machine; without one, about that of the query."""

    ranges: Ranges
    around: System | None = None  # before the effects of the ranges
    estimate: System | None = None  # with their estimates in arm and vehicle

    @property
    def lines(self) -> list[str]:
        """Every range as text."""
        return [
            f"{effect}.{name}: {np.asarray(low).tolist()} to {np.asarray(high).tolist()}"
            for effect, fields in self.ranges.items()
            for name, (low, high) in fields.items()
            if np.any(np.asarray(low) != np.asarray(high))
        ]


def read_uncertainty(path: str | os.PathLike[str]) -> Uncertainty:
    """Read ranges from TOML, as `randomize` takes them, or from `ves-gym diagnose`'s JSON.

    That has an estimate and a 90 % interval for every number that it names: the machine with
    the estimates is what a robust plan is made for, the ends of the intervals are its
    scenarios. Effects on arm and base count; others (friction, sensors, platform) do not change
    the base's response to a motion that the joints follow, and stay as they are.

    Raises:
        ParameterError: no such file, or nothing of arm or base in it is uncertain.
    """
    if Path(path).suffix.lower() == ".toml":
        ranges = read_table(path)
        if not ranges:
            raise ParameterError(f"{path}: expected ranges of effects, got none")
        return Uncertainty(ranges)
    plain = read_result(path, DIAGNOSIS)
    if "system" not in plain:
        raise ParameterError(f"{path}: expected the diagnosis of a System, got one of MJCF")
    better = System.from_dict(plain["system"], f"{path}: system").ideal()
    effects: dict[str, dict[str, Any]] = {}
    for entry in plain["effects"]:
        cls = EFFECTS.get(entry["kind"])
        if cls is None or not issubclass(cls, (ArmEffect, BaseEffect)):
            continue
        for name, ends in _ends(better, entry).items():
            fields = effects.setdefault(entry["kind"], {})
            # of an effect that is named in two places each is zero where the other is not
            fields[name] = fields.get(name, 0.0) + ends
    ranges = {k: {n: tuple(ends.tolist()) for n, ends in v.items()} for k, v in effects.items()}
    if not ranges:
        named = ", ".join(entry["name"] for entry in plain["effects"]) or "none"
        raise ParameterError(
            f"{path}: expected an effect on arm or base with an interval, got {named}"
            f" ({plain['verdict']})"
        )
    others = tuple(e for e in better.effects if e.kind not in ranges)
    return Uncertainty(ranges, better.replace(effects=others), better.actual)


def _ends(system: System, entry: dict[str, Any]) -> dict[str, Array]:
    """Fields of a diagnosed effect that are not as by default: (low, high) of each."""
    scope = Scope(system.arm.n, system)
    candidates = {c.slot: c for c in EFFECTS[entry["kind"]].candidates(scope)}
    if entry["slot"] not in candidates:
        raise ParameterError(f"the diagnosis names {entry['name']}, which this machine lacks")
    candidate = candidates[entry["slot"]]
    values = np.array([entry["value"][name] for name in candidate.names])
    estimate = candidate.effect(values)
    corners = [estimate]  # the estimate, and each number at the ends of its interval
    for k, name in enumerate(candidate.names):
        for end in entry["interval"][name] or ():
            moved = values.copy()
            moved[k] = end
            corners.append(candidate.effect(moved))
    out = {}
    for field in dataclasses.fields(estimate):
        if getattr(estimate, field.name) != field.default:
            at = np.array([getattr(effect, field.name) for effect in corners], float)
            out[field.name] = np.array([at.min(axis=0), at.max(axis=0)])
    return out
