"""Claim: the best planner's motions leave least energy in the base, and prediction is right.

reach100, bent beam, thesis mass, motor drive; every energy simulated on the full nonlinear
system. `refined` against the straight line and the best known energies, the history beside
it, and predicted against simulated `E_mean` over every planner's motions.

The fast tests take the first queries of 4 s, the slow ones all hundred of each. Promised and
missed: half the straight line's energy at T = 1 s, where 0.63 is reached. Half of it is in
slow modes (0.3 to 0.5 Hz), which in one second see the ends of a motion (docs/results.md).
That 0.63 is where the optimum lies: two sets of 24 starts agree within 1.3 % on each of the
hundred queries, 32 starts with detours of up to 1.8 rad find 0.3 % at best, and without any
limit of speed or torque the median on the first 24 queries is still 0.60.

Missed: median simulated E_mean of `refined` over the straight line on reach100 at T = 1 s:
promised 0.50, measured 0.629 (95 %: 0.57 to 0.68).
"""

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.best_known import best_known
from ves_gym._util.params import write_table
from ves_gym.mechanics.vehicle import BENT_THESIS, STRAIGHT_HORIZONTAL_THESIS
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System

HISTORY = ("hotspot-q", "hotspot-qt", "ompl-q", "ompl-qt")
MOST = ("smooth-jerk", "shaped-zv", "shaped-zvd", *HISTORY, "direct", "refined")
MISS = pytest.mark.xfail(
    reason="miss: 0.629 (95 %: 0.57 to 0.68) on the whole suite, 0.60 without any limit of"
    " speed or torque, docs/claims.md"
)
FEW = 12  # queries of a duration, in the fast tests
SLOW = pytest.mark.slow
PROMISED = [
    pytest.param(1.0, 0.50, marks=[MISS, SLOW]),
    pytest.param(2.0, 0.25, marks=SLOW),
    (4.0, 0.05),
]


@functools.cache
def rows(
    planners: tuple[str, ...], duration: float, count: int, vehicle: str = "bent-thesis"
) -> dict[str, list[dict]]:
    """Benchmark rows of the first queries of a duration, by planner."""
    suite = get_suite("reach100", system=System(vehicle=BENT_THESIS), vehicle=vehicle)
    queries = [(v, q) for v, q in suite.queries if q.duration == duration][:count]
    result = run_benchmark(replace(suite, queries=tuple(queries)), planners=planners, workers=1)
    out: dict[str, list[dict]] = {}
    asked = {query.name: query for _, query in queries}
    for row in result["rows"]:
        out.setdefault(row["planner"], []).append({**row, "asked": asked[row["query"]]})
    return out


def near_best(rows: list[dict]) -> float:
    """Share of rows within 5 % of the best known energy."""
    near = [r["success"] and r["E_mean"] <= 1.05 * best_known(r["asked"]) for r in rows]
    return np.mean(near)


def ratios(found: dict[str, list[dict]], planner: str, key: str = "E_mean") -> np.ndarray:
    """Energy of each query over the straight line's."""
    pairs = zip(found[planner], found["straight"], strict=True)
    return np.array([a[key] / b[key] for a, b in pairs if a[key] is not None])


@pytest.mark.parametrize("count", [FEW, pytest.param(100, marks=SLOW)])
@pytest.mark.parametrize(("duration", "promised"), PROMISED)
def test_least_energy(duration, promised, count):
    found = rows(("refined",), duration, count)
    assert np.median(ratios(found, "refined")) <= promised


@pytest.mark.parametrize(
    ("duration", "peak"),
    [*(pytest.param(*k, marks=SLOW) for k in ((1.0, 1.0), (2.0, 1.1))), (4.0, 1.0)],
)
def test_every_answer_is_feasible_and_near_the_best_known(duration, peak):
    """No answer is worse than the straight line; nine of ten within 5 % of the best known.

    Energy at the end and peak fall in the median; the peak's at T = 2 s is 0.96 of the straight
    line's on all queries, and may be 10 % more of so few.
    """
    found = rows(("refined",), duration, FEW)
    assert all(row["success"] for row in found["refined"])
    assert ratios(found, "refined").max() < 1
    assert near_best(found["refined"]) >= 0.9
    assert np.median(ratios(found, "refined", "E_res")) <= 1
    assert np.median(ratios(found, "refined", "E_peak")) <= peak


@pytest.mark.slow
@pytest.mark.parametrize("duration", [1.0, 2.0, 4.0])
def test_the_whole_suite_is_near_the_best_known_and_neither_peak_nor_end_rises(duration):
    found = rows(("refined",), duration, 100)
    assert near_best(found["refined"]) >= 0.9
    assert np.median(ratios(found, "refined", "E_peak")) <= 1
    assert ratios(found, "refined", "E_res").max() <= 1


@pytest.mark.slow
@pytest.mark.parametrize(("names", "count"), [((*HISTORY, "refined"), 3), (MOST, 20)])
def test_the_history_side_by_side(names, count):
    """Raw Q goes by what instantaneous motions do; at 1 s it is worse than a straight line.

    At every duration the refined motion beats all that go by coupling length.
    """
    for duration, worse in ((1.0, True), (4.0, False)):
        found = rows(names, duration, count)
        median = {name: np.median(ratios(found, name)) for name in (*HISTORY, "refined")}
        if worse:
            assert max(ratios(found, "hotspot-q").max(), ratios(found, "ompl-q").max()) > 1
        assert median.pop("refined") < min(median.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asked", "durations"),
    [([(HISTORY, 2), (("refined",), FEW)], (1.0, 4.0)), ([(MOST, 20)], (1.0, 2.0, 4.0))],
)
def test_prediction_matches_simulation_over_all_planned_motions(asked, durations):
    """Relative error of the predicted E_mean over all motions that keep their limits.

    Args:
        asked: names of planners, and how many queries of each duration they answer.
        durations: of the motions [s].
    """
    errors = []
    for (names, count), duration in itertools.product(asked, durations):
        some = [r for part in rows(names, duration, count).values() for r in part]
        errors += [abs(r["prediction_error"]) for r in some if r["failure"] is None]
    assert len(errors) >= sum(count * len(names) for names, count in asked)
    assert np.median(errors) <= 0.02
    assert max(errors) <= 0.10


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "reached"),
    [
        (replace(BENT_THESIS, mass_model="consistent"), {1.0: 0.45, 2.0: 0.06, 4.0: 0.03}),
        (STRAIGHT_HORIZONTAL_THESIS, {1.0: 0.60, 2.0: 0.32, 4.0: 0.50}),
    ],
    ids=["consistent mass", "straight beam"],
)
def test_other_beams(vehicle, reached, tmp_path):
    """Seen on thirty queries: 0.38, 0.048, 0.024 and 0.55, 0.28, 0.41; here on ten.

    What is refused is not the motion as commanded: the arm cannot follow it on such a beam.
    """
    path = tmp_path / "beam.toml"
    write_table(path, vehicle)
    for duration, most in reached.items():
        found = rows(("refined",), duration, 10, str(path))
        assert np.median(ratios(found, "refined")) <= most
        failures = [row["failure"] for row in found["refined"] if not row["success"]]
        assert all(why.startswith("the arm: ") for why in failures)
