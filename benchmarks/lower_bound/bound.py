"""A certificate of how little a query's E_mean can be: a rigorous lower bound.

The base is linear (M, D, K), its inertia M that of one configuration of the arm (default the
middle of the straight line, as in `MeanEnergy`), at rest at first; the joints follow their
motion exactly. Then the bound holds for every absolutely continuous motion from start to goal
within position and speed limits; limits on acceleration or torque only add to it.

With u = H(q) q', E_mean = J_R(u) + 1/2 int u^T R u dt (`conjugate`), and for every l(t)

    E_mean >= min over motions of (int l^T u + 1/2 u^T R u dt) - J_R*(l)
           >= f(0, start) - f(T, goal) - int e dt - J_R*(l)

for every potential f with residual e (`potential`): README.md has the proof.
Any l, f and y are valid; `barrier` finds good ones, and `LowerBound.check` evaluates them, so
that the answer does not rest on the optimiser. Arms of more than four joints: the part of the
bound that follows from the first moment of the arm's mass alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.linalg

from benchmarks.lower_bound.barrier import Barrier
from benchmarks.lower_bound.conjugate import MomentumCost, conjugate, local_part, momentum_cost
from benchmarks.lower_bound.potential import (
    Potential,
    ReachableSet,
    Setting,
    Shapes,
    residual_floor,
)
from ves_gym._util.params import Array, ParameterError
from ves_gym.mechanics.dynamics import inertia
from ves_gym.planners.motion_problem import MotionProblem
from ves_gym.planners.objective import MeanEnergy
from ves_gym.planners.prediction import LinearBase
from ves_gym.planners.query import Query, require_time
from ves_gym.planners.sequential import minimise

_JOINTS = 4  # at most, for a potential over all of joint space
_SLABS = (12, 20)  # least and most parts of the duration
_SLAB = 0.125  # s, about
_TOLERANCE = 0.03  # of the bound, that the residual's own bound may cost
_ROUNDING = 1e-7  # relative, taken off at the end: a million times that of double precision


@dataclass(frozen=True, eq=False)
class LowerBound:
    """A lower bound of E_mean and what proves it."""

    query: Query
    energy: float  # J: no motion has less
    at: Array  # (n,) rad: configuration of M
    cost: MomentumCost  # with the R that was taken off
    setting: Setting | None  # None for a bound by the first moment alone
    potential: Potential | None
    errors: Array  # (slabs,) e [W]

    def gap(self, energy: float) -> float:
        """An energy [J] over the bound; 1: it is the least there is."""
        return energy / self.energy

    def check(self) -> float:
        """Evaluate the certificate again: the bound [J] that l, f and y give."""
        if self.setting is None or self.potential is None:
            return _first_moment(self.query, self.cost)
        value, _ = _evaluate(self.setting, self.potential, self.cost, self.energy)
        return value


def bound_energy(
    query: Query, *, at: npt.ArrayLike | None = None, slabs: int | None = None
) -> LowerBound:
    """Bound a query's E_mean from below.

    Args:
        query: the ends, the duration and limits; its surroundings and servo are not used.
        at: (n,) configuration whose inertia the base carries [rad]; default the middle of the
            straight line.
        slabs: parts of the duration; default about 0.125 s each.

    Returns:
        The bound with its certificate.

    Raises:
        ParameterError: slabs below 2, or arm or base move at the start.
        NoPlan: a joint cannot cover its way in time.
    """
    require_time(query)
    start, goal = query.ends
    arm, T = query.system.arm, query.duration
    if query.is_moving:
        raise ParameterError(
            "a lower bound needs arm and base at rest at the start, got a moving one"
        )
    if slabs is not None and slabs < 2:
        raise ParameterError(f"slabs must be >= 2, got {slabs}")
    where = (start + goal) / 2 if at is None else arm.require_within_limits(at, "at")
    linear = LinearBase(query.system)
    plain = momentum_cost(linear.mass(linear.inertia(where)), linear.D, linear.K, T)
    simple = _first_moment(query, plain)
    nothing = LowerBound(query, simple, where, plain, None, None, np.zeros(0))
    if arm.n > _JOINTS or np.array_equal(start, goal):
        return nothing
    N = slabs or int(np.clip(round(T / _SLAB), *_SLABS))
    cost = plain.less(local_part(plain))
    speed = arm.column("v_max")
    if query.v_max is not None:
        speed = np.minimum(speed, query.v_max)
    reach = ReachableSet(start, goal, arm.column("q_min"), arm.column("q_max"), speed, T)
    sides = [reach.box(k * T / N, (k + 1) * T / N) for k in range(N)]
    low, high = np.min([b[0] for b in sides], axis=0), np.max([b[1] for b in sides], axis=0)
    shapes = Shapes(arm, (low + high) / 2, (high - low) / 2)
    values, vectors = np.linalg.eigh(cost.R)
    square = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T  # the symmetric root
    setting = Setting(reach, shapes, square, N)
    unit = _near(query, where)
    potential = Barrier(setting, conjugate(cost, N), unit).solve()
    energy, errors = _evaluate(setting, potential, cost, unit)
    if energy <= simple:
        return nothing
    return LowerBound(query, energy, where, cost, setting, potential, errors)


def _near(query: Query, where: Array) -> float:
    """An energy [J] of about the size of the least one, to scale the search with."""
    form = MeanEnergy(query.system, where, query.duration)
    problem = MotionProblem(replace(query, surroundings=None), 8, form)
    return max(minimise(problem, problem.straight, 25, 1e-2).energy, 1e-12)


def _evaluate(
    setting: Setting, p: Potential, cost: MomentumCost, scale: float
) -> tuple[float, Array]:
    """The bound [J] and e of every slab [W]; `scale` is an energy for the tolerance [J]."""
    T = setting.reach.duration
    tolerance = _TOLERANCE * scale / T
    floors = [residual_floor(setting, p, k, tolerance)[0] for k in range(setting.slabs)]
    errors = -np.array(floors)
    ends = setting.shapes.at(np.stack([setting.reach.start, setting.reach.goal]))[0]
    parts = ends[0] @ p.f[0], ends[1] @ p.f[-1], float(errors.sum()) * setting.step
    multiplier = p.l.ravel()
    spent = 0.5 * float(multiplier @ conjugate(cost, setting.slabs) @ multiplier)
    rounding = _ROUNDING * (sum(map(abs, parts)) + spent)
    return float(parts[0] - parts[1] - parts[2] - spent - rounding), errors


def _first_moment(query: Query, cost: MomentumCost) -> float:
    """The least of J with int u_lin dt as the ends have it [J]; any arm, any speed.

    The linear momentum is the rate of the first moment m c(q), so a constant l on it has the
    same int l^T u for every motion: potential and residual are exact, with R = 0.
    """
    ends = inertia(query.system.arm, np.stack(query.ends))[:, :3, 3:6]
    moment = np.stack([ends[:, 1, 2], ends[:, 2, 0], ends[:, 0, 1]], axis=1)
    change = moment[1] - moment[0]
    W = conjugate(cost.less(np.zeros_like(cost.R)), 2).reshape(3, 6, 3, 6)
    form = W[:, :3, :, :3].sum(axis=(0, 2))
    return (1 - _ROUNDING) * 0.5 * float(change @ scipy.linalg.solve(form, change))
