"""Searches against plain L-BFGS: cost after 20,000 evaluations, `python -m benchmarks.search`.

The referee is SciPy's L-BFGS-B from four starts, the straight line and three random bends, on
the cost that the search reports: coupling length of a polyline for `ompl-q`, predicted E_mean
for `ompl-energy`. It knows neither OMPL nor our optimisers. An evaluation of the referee is a
whole path, ours one edge; for `ompl-energy` it has the derivative of every motion for nothing.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.optimize
from threadpoolctl import threadpool_limits

from ves_gym.mechanics.motion import Motion, basis
from ves_gym.planners.mean_energy import MeanEnergy
from ves_gym.planners.metric import Metric
from ves_gym.planners.momentum import momentum
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.query import Query
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System

BUDGET = 20_000  # evaluations
STARTS = 4
INNER = 8  # free way-points of the referee's path
FREE = 24  # free control points of its motion, as many as ours
BENDS = 0.7, 0.35  # rad: random half and full sine waves on every joint


def referee(
    query: Query,
    inner: int,
    cost: Callable[[np.ndarray], Any],
    exact: bool,
    budget: int,
    seed: int,
) -> float:
    """Least cost from four starts.

    Args:
        query: the ends and joint limits.
        inner: free points (inner, n) of the decision.
        cost: of them, flat; with its derivative if `exact`.
        exact: whether `cost` gives (value, gradient).
        budget: evaluations of `cost`, all starts together.
        seed: of the bends.

    Returns:
        The least cost.
    """
    rng, (start, goal) = np.random.default_rng(seed), query.ends
    arm = query.system.arm
    low, high = (np.tile(arm.column(k), inner) for k in ("q_min", "q_max"))
    u = np.linspace(0, 1, inner + 2)[1:-1, None]
    best = np.inf
    for k in range(STARTS):
        half, full = rng.normal(size=(2, arm.n))
        bend = BENDS[0] * np.sin(np.pi * u) * half + BENDS[1] * np.sin(2 * np.pi * u) * full
        x0 = np.clip((start + u * (goal - start) + (k > 0) * bend).ravel(), low, high)
        first = cost(x0)
        scale = first[0] if exact else first

        def scaled(x: np.ndarray, scale: float = scale) -> Any:
            value = cost(x)
            return (value[0] / scale, value[1] / scale) if exact else value / scale

        result = scipy.optimize.minimize(
            scaled, x0, jac=exact, method="L-BFGS-B", bounds=scipy.optimize.Bounds(low, high),
            options={"maxfun": budget // STARTS, "maxiter": BUDGET, "ftol": 1e-9},
        )  # fmt: skip
        best = min(best, result.fun * scale)
    return best


def lengths(query: Query) -> Callable[[np.ndarray], float]:
    """Coupling length on raw Q of the polyline through inner points."""
    metric, (start, goal) = Metric(query.system, "q"), query.ends
    return lambda x: metric.length(np.vstack([start, x.reshape(-1, len(start)), goal]))


def energies(query: Query) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
    """Predicted E_mean of the motion with inner control points, and its derivative."""
    (start, goal), arm = query.ends, query.system.arm
    form = MeanEnergy(query.system, (start + goal) / 2, query.duration, query.servo)
    u, m = form.t / query.duration, FREE + 6
    position, velocity = basis(m, u), basis(m, u, 1) / query.duration

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        control = np.vstack([[start] * 3, x.reshape(-1, arm.n), [goal] * 3])
        sample = momentum(arm, position @ control, velocity @ control)
        force = form.hessian @ sample.u.ravel()
        pull = force.reshape(sample.u.shape)
        slope = position.T @ np.einsum("kcj,kc->kj", sample.by_q, pull)
        slope += velocity.T @ np.einsum("kcj,kc->kj", sample.by_v, pull)
        return 0.5 * float(sample.u.ravel() @ force), slope[3:-3].ravel()

    return cost


def path_energies(query: Query) -> Callable[[np.ndarray], float]:
    """Predicted E_mean of the path through inner way-points, passed by a quintic."""
    start, goal = query.ends
    form = MeanEnergy(query.system, (start + goal) / 2, query.duration, query.servo)

    def cost(x: np.ndarray) -> float:
        way = np.vstack([start, x.reshape(-1, len(start)), goal])
        return form.of(Motion.through(way, query.duration))

    return cost


def queries(count: int) -> list[Query]:
    """Return the first of reach100 at 2 and 4 s, with no limits but those of joint angles."""
    suite = get_suite("reach100", system=System(drive="prescribed").ideal(), quick=True)
    by_duration = [[q for _, q in suite.queries if q.duration == d] for d in (2.0, 4.0)]
    both = [q for pair in zip(*by_duration, strict=True) for q in pair]
    return [replace(q, v_max=None) for q in both[:count]]


def ratios(query: Query, budget: int, paths: bool, seed: int = 0) -> dict[str, float]:
    """Cost of the searches over the referee's.

    Args:
        query: without limits of speed or torque, which the referee does not know.
        budget: evaluations of ours, and of the referee.
        paths: whether the referee also bends paths passed by a quintic (a minute a query).
        seed: of all that is random.
    """
    out = {}
    found = {
        k: Ompl(objective=k, evaluations=budget).search(query, seed) for k in ("q", "energy")
    }
    length = referee(query, INNER, lengths(query), False, budget, seed)
    out["q"] = found["q"].cost / length
    out["q, searched only"] = found["q"].searched / length
    moved = referee(query, FREE, energies(query), True, budget, seed)
    out["energy"] = found["energy"].cost / moved
    if paths:
        bent = referee(query, INNER, path_energies(query), False, budget, seed)
        out["energy, way only"] = found["energy"].cost / bent
        out["energy, way only, searched only"] = found["energy"].searched / bent
    return out


def main(argv: Sequence[str] | None = None) -> None:
    """Print the ratios of some queries, their median and worst."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=10)
    parser.add_argument("--paths", action="store_true", help="the referee on paths as well")
    args = parser.parse_args(argv)
    rows = []
    with threadpool_limits(1):
        for query in queries(args.queries):
            begin = time.perf_counter()
            rows.append(ratios(query, BUDGET, args.paths))
            text = ", ".join(f"{k} {v:.3f}" for k, v in rows[-1].items())
            print(f"{query.name}: {text} ({time.perf_counter() - begin:.1f} s)", flush=True)
    for key in rows[0]:
        values = [row[key] for row in rows]
        print(f"{key}: median {np.median(values):.3f}, worst {max(values):.3f}")


if __name__ == "__main__":
    main()
