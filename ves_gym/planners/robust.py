"""Plans for a machine that is known within ranges: least mean or worst energy at a price.

The energy of a motion is a quadratic form on every machine of the ranges, so their weighted
sum is one (`MeanEnergy`), and `direct`'s optimiser minimises it as it is. Scenarios are the
ends of the ranges; how far the answer leans towards them is limited by what it may cost on the
machine as described.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import has
from ves_gym.planners.direct import MotionProblem, minimise
from ves_gym.planners.prediction import MeanEnergy
from ves_gym.planners.query import Query, broken_limit
from ves_gym.planners.refine import _FREE, Refined
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
_ROUNDS = 4  # of weighing the worst scenarios more
_SHARPNESS = 6.0  # of that weighing: exp(sharpness E / largest E)
_HALVINGS = 5  # of the lean towards the scenarios, until the price is kept


class Robust:
    """Least energy over scenarios of an uncertain machine, at a limited nominal price.

    Args:
        uncertain: {effect: {parameter: (low, high)}}, as environments take it; those that a
            vehicle cannot have are left out.
        price: largest E_mean on the machine as described over that of the nominal optimum.
        objective: "mean" over the scenarios, or "worst".
        free: control points of the answer.
        name: of the planner.
    """

    def __init__(
        self,
        uncertain: Ranges = UNCERTAIN,
        *,
        price: float = 1.15,
        objective: str = "mean",
        free: int = _FREE,
        name: str = "robust",
    ) -> None:
        if objective not in OBJECTIVES:
            raise ParameterError(
                f"objective must be one of {', '.join(OBJECTIVES)}, got {objective!r}"
                f"{did_you_mean(objective, OBJECTIVES)}"
            )
        if not (price >= 1 and math.isfinite(price)):
            raise ParameterError(f"price must be >= 1, got {price}")
        self.uncertain, self.price, self.objective, self.free = (
            uncertain,
            price,
            objective,
            free,
        )
        self.name = name
        self.summary = (
            f"least {objective} predicted E_mean over an uncertain machine, at most"
            f" {price:g} x the nominal optimum on the machine as described"
        )

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Lean from the nominal optimum towards the scenarios as far as the price allows.

        Args:
            query: the ends, the duration and limits.
            seed: of the nominal search.

        Returns:
            The motion; the energies [J] of the nominal optimum and of the answer, on the
            machine as described and in every scenario.

        Raises:
            NoPlan: there is no nominal plan.
        """
        nominal, info = Refined(self.free).find(query, seed)
        problem = ScenarioProblem(query, self.free, scenarios(query.system, self.uncertain))
        x0 = problem.of(nominal)
        before = problem.energies(x0)
        answer, x, lean = x0, x0, 1.0
        for _ in range(_HALVINGS):
            x = self._towards(problem, x, lean)
            motion = problem.motion(x)
            within = problem.energies(x)[0] <= self.price * before[0]
            if within and broken_limit(query, motion) is None:
                answer = x
                break
            lean /= 2
        after = problem.energies(answer)
        return (nominal if answer is x0 else problem.motion(answer)), {
            "scenarios": len(after) - 1,
            "lean": 0.0 if answer is x0 else lean,
            "price": float(after[0] / before[0]) if before[0] > 0 else 1.0,
            "nominal": {"energies": before.tolist()},
            "energies": after.tolist(),
            "message": info.get("message", ""),
        }

    def _towards(self, problem: ScenarioProblem, x: Array, lean: float) -> Array:
        """Minimise (1 - lean) E_nominal + lean times the objective over the scenarios."""
        count = len(problem.systems) - 1
        weights = np.full(count, 1 / count)
        for _ in range(_ROUNDS if self.objective == "worst" else 1):
            problem.weigh(np.r_[1 - lean, lean * weights])
            x = minimise(problem, x, tolerance=1e-4).x
            energy = problem.energies(x)[1:]
            steep = np.exp(_SHARPNESS * (energy / energy.max() - 1))
            weights = 0.5 * weights + 0.5 * steep / steep.sum()
        return x


def scenarios(system: System, uncertain: Ranges) -> list[System]:
    """Return machines at the ends of uncertain ranges, with their effects in them.

    All corners of the box of up to three numbers; of more, the rows of a Hadamard matrix, in
    which every number stands at either end as often, and every pair at all four.

    Args:
        system: as described.
        uncertain: {effect: {parameter: (low, high)}}.

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
        bits = np.arange(2**size)[:, None] >> np.arange(size) & 1
        return bits.astype(np.float64)
    order = 2 ** math.ceil(math.log2(size + 1))
    signs = scipy.linalg.hadamard(order)[:, 1 : size + 1]
    return np.asarray((signs + 1) / 2, dtype=np.float64)


class ScenarioProblem(MotionProblem):
    """The problem of `direct` with the weighted energy of several machines.

    The first is the query's own. Machines of one arm share its momentum; torque limits hold
    with every arm.
    """

    def __init__(self, query: Query, free: int, others: Sequence[System]) -> None:
        super().__init__(query, free)
        self.systems = [query.system, *others]
        arms = list(dict.fromkeys(system.arm for system in self.systems))
        self._group = [arms.index(system.arm) for system in self.systems]
        assert isinstance(self.energy, MeanEnergy)
        self._forms = [self.energy]
        self._arms: list[MotionProblem] = [self]
        for arm in arms[1:]:
            other = query.system.replace(arm=arm)
            problem = MotionProblem(replace(query, system=other), free, self.energy)
            self._arms.append(problem)
        middle = (self.start + self.goal) / 2
        for system in others:
            self._forms.append(self.form_at(middle, system))
        self.weigh(np.r_[1.0, np.zeros(len(others))])

    def weigh(self, weights: Array) -> None:
        """Set the weight of every machine's energy, the query's own first."""
        groups = range(len(self._arms))
        parts = [
            [
                (w, f)
                for w, f, g in zip(weights, self._forms, self._group, strict=True)
                if g == k
            ]
            for k in groups
        ]
        self.energy = _Mixture(parts)  # type: ignore[assignment]

    def energies(self, x: Array) -> Array:
        """E_mean of a decision on every machine [J]."""
        samples = self._samples(x)
        pairs = zip(self._forms, self._group, strict=True)
        return np.array([form.value(samples[g][0]) for form, g in pairs])

    def _samples(self, x: Array) -> list[tuple[Array, Array]]:
        return [MotionProblem.momentum(arm, x) for arm in self._arms]

    def momentum(self, x: Array) -> tuple[Array, Array]:
        """Samples of every arm's momentum, one after another, and their derivative."""
        samples = self._samples(x)
        return np.concatenate([u for u, _ in samples]), np.vstack([s for _, s in samples])

    def _torque(self, x: Array) -> tuple[Array, Array]:
        parts = [MotionProblem._torque(arm, x) for arm in self._arms]
        return np.concatenate([v for v, _ in parts]), np.vstack([s for _, s in parts])

    def add_torque_samples(self, x: Array) -> bool:
        """Sample each arm's torque also at its peaks; True if any passes its share."""
        added = [MotionProblem.add_torque_samples(arm, x) for arm in self._arms]  # all of them
        return any(added)


class _Mixture:
    """Weighted sum of quadratic forms in the momenta of several arms, one after another."""

    def __init__(self, parts: list[list[tuple[float, MeanEnergy]]]) -> None:
        first = parts[0][0][1]
        self.t, self.linear, size = first.t, first.linear, len(first.hessian)
        self._parts = parts
        self._slices = [slice(k * size, (k + 1) * size) for k in range(len(parts))]
        blocks = [sum(w * form.hessian for w, form in part) for part in parts]
        self.hessian: Array = scipy.linalg.block_diag(*blocks)

    def value(self, u: Array) -> float:
        """Weighted energy [J] of momenta."""
        pairs = zip(self._parts, self._slices, strict=True)
        return float(sum(w * form.value(u[at]) for part, at in pairs for w, form in part if w))

    def curvature(self, u: Array, slope: Array) -> Array:
        """slope^T W slope (k, k): the same for all u, for slopes of momenta."""
        out: Array = slope.T @ (self.hessian @ slope)
        return out

    def force(self, u: Array) -> Array:
        """Derivative of `value`."""
        pairs = zip(self._parts, self._slices, strict=True)
        forces = [sum(w * form.force(u[at]) for w, form in part) for part, at in pairs]
        return np.concatenate(forces)
