"""Plans for a machine that is known within ranges: least mean or worst energy at a price.

Scenarios are the ends of the ranges. The energy of a motion on each counts over the least that
a motion made for that machine alone has there (`ScenarioProblem.known`), so that what is
minimised is the cost of not knowing; what it may cost on the machine as described is limited.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import scipy.linalg

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.mechanics.motion import Motion
from ves_gym.mechanics.vehicle import has
from ves_gym.planners.query import Query, first_violation
from ves_gym.planners.refine import _FREE, Refined
from ves_gym.planners.scenarios import ScenarioProblem
from ves_gym.planners.sequential import minimise
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
        free: int = _FREE,
        name: str = "robust",
        around: System | None = None,
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
        self.name, self.around = name, around
        self.summary = (
            f"least {objective} predicted E_mean over an uncertain machine, each over what it"
            f" could be, at most {price:g} x the nominal optimum on the machine as described"
        )

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Minimise the objective over the scenarios, the price on the described machine kept.

        Args:
            query: the ends, the duration and limits.
            seed: of the nominal search.

        Returns:
            The motion; the energies [J] of the nominal optimum, of the answer, and of motions
            made for each machine alone (`known`), on the machine as described and in every
            scenario.

        Raises:
            NoPlan: there is no nominal plan.
        """
        nominal, info = Refined(self.free).find(query, seed)
        problem = ScenarioProblem(
            query, self.free, scenarios(self.around or query.system, self.uncertain)
        )
        x0 = problem.of(nominal)
        before = problem.energies(x0)
        known, found = problem.known(x0), x0
        if (known > 0).all():
            found = self._least(problem, x0, before, known)
        after = problem.energies(found)
        return (nominal if found is x0 else problem.motion(found)), {
            "scenarios": len(after) - 1,
            "price": float(after[0] / before[0]) if before[0] > 0 else 1.0,
            "nominal": {"energies": before.tolist()},
            "energies": after.tolist(),
            "known": known.tolist(),
            "message": info.get("message", ""),
        }

    def _least(self, problem: ScenarioProblem, x0: Array, before: Array, known: Array) -> Array:
        """Return the best decision whose price is kept, x0 where there is none better.

        Where the torque of every arm cannot be kept at the price, that of the described one is.

        Args:
            problem: of all scenarios.
            x0: the nominal optimum.
            before: its energies [J].
            known: least energies [J], the scales.
        """
        risk = problem.risk
        risk.scale = np.r_[before[0], known[1:]]
        if self.objective == "worst":
            risk.sharpness = _SHARPNESS / float((before / risk.scale)[1:].max())
        best, least = x0, self._objective(problem, x0)
        for limited in (range(len(problem.arms)), range(1)):
            problem.limited = limited
            for x in self._tried(problem, x0):
                if not self._stands(problem, x):
                    continue
                value = self._objective(problem, x)
                if self._price(problem, x) <= self.price and value < least:
                    best, least = x, value
            if best is not x0:
                break
        return best

    def _tried(self, problem: ScenarioProblem, x0: Array) -> Iterator[Array]:
        """Optima with a multiplier on the price, until it is just kept.

        Were the energies quadratic between x0 and the optimum without a price, then on the way,
        by the share s of it, price - 1 would go with s^2 and the multiplier with (1 - s) / s:
        the first guess. Then the secant in its logarithm, halving where that leads astray.
        """
        risk = problem.risk
        most = self.price - 1
        start = self._objective(problem, x0)
        x = free = minimise(problem, x0, tolerance=_TOLERANCE).x
        yield x
        spent, gained = self._price(problem, x) - 1, start - self._objective(problem, x)
        if spent <= most or most == 0 or gained <= 0:
            return
        s = math.sqrt(most / spent)
        level = math.log(gained / spent * (1 - s) / s)
        low, high = (level - _SPAN, spent), (math.inf, 0.0)  # too little, enough
        for _ in range(_ROUNDS):
            risk.price = math.exp(level)
            x = minimise(problem, x0 + s * (free - x0), tolerance=_TOLERANCE).x
            risk.price = 0.0
            yield x
            paid = self._price(problem, x) - 1
            if most - _NEAR_PRICE <= paid <= most:
                return
            low, high = (low, (level, paid)) if paid <= most else ((level, paid), high)
            if math.isinf(high[0]):
                level += _SPAN / 2
                continue
            share = (low[1] - most + _NEAR_PRICE / 2) / (low[1] - high[1])
            level = low[0] + min(max(share, 0.2), 0.8) * (high[0] - low[0])

    @staticmethod
    def _objective(problem: ScenarioProblem, x: Array) -> float:
        """Risk of a decision; its price is added where the problem has one."""
        return problem.risk.value(problem.momentum(x)[0])

    @staticmethod
    def _price(problem: ScenarioProblem, x: Array) -> float:
        """Energy on the machine as described over that of the nominal optimum."""
        return float(problem.energies(x)[0] / problem.risk.scale[0])

    @staticmethod
    def _stands(problem: ScenarioProblem, x: Array) -> bool:
        return first_violation(problem.query, problem.motion(x)) is None


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
