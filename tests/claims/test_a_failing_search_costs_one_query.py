"""Claim: a crash, a hang or a bad cost in a search is reported for its query; the rest runs.

Faults are put into the real child process: of three queries the second makes it crash, hang
or return a cost that is not a number.
"""

import dataclasses
import json

import pytest

from ves_gym._util.child_process import Child
from ves_gym.planners import ompl_search
from ves_gym.planners.benchmark import run_benchmark
from ves_gym.planners.ompl_search import Ompl
from ves_gym.planners.registry import PLANNERS
from ves_gym.planners.suites import get_suite
from ves_gym.system.system import System

PROGRAM = """
import os, time
from ves_gym.planners import metric, ompl_search as w
search = w.search
def faulty(request):
    if request.query.name.endswith("001"):
        {fault}
    return search(request)
w.search = faulty
w.serve()
"""
FAULTS = {
    "crash": ("os.kill(os.getpid(), 11)", "the search crashed: SIGSEGV"),
    "hang": ("time.sleep(600)", "did not answer within 4 s and was killed"),
    "bad cost": ("metric.Metric.edge = lambda *a: float('nan')", "BadCost: a cost must be"),
}


# a search that hangs has a test of its own: tests/planners/test_ompl_search.py
@pytest.mark.parametrize(
    "fault", [pytest.param(k, marks=pytest.mark.slow) if k == "hang" else k for k in FAULTS]
)
def test_a_failing_search_costs_one_query(monkeypatch, fault):
    code, message = FAULTS[fault]
    monkeypatch.setattr(ompl_search, "SEARCH_PROCESS", Child(PROGRAM.format(fault=code)))
    monkeypatch.setitem(PLANNERS, "ompl-qt", Ompl(evaluations=300, seconds=2.0))
    suite = get_suite("reach100", system=System(), vehicle="bent-thesis")
    queries = tuple((v, q) for v, q in suite.queries if q.duration == 2.0)[:3]
    # the child starts, and compiles on a new machine, in a time of its own
    PLANNERS["ompl-qt"].find(queries[0][1], 0)
    monkeypatch.setattr(ompl_search, "_GRACE", 2.0)
    result = run_benchmark(
        dataclasses.replace(suite, queries=queries), planners=["ompl-qt"], workers=1
    )
    json.dumps(result, allow_nan=False)
    failures = [r["failure"] for r in result["rows"] if r["planner"] == "ompl-qt"]
    assert len(result["rows"]) == 6
    assert failures[0] is None
    assert message in failures[1]
    if fault != "bad cost":  # that fault stays in the child, which lives on
        assert failures[2] is None
    assert all(r["success"] for r in result["rows"] if r["planner"] == "straight")
