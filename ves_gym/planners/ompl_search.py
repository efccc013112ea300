"""Minimum-coupling paths by sampling-based search (OMPL) in joint space.

A search adds up costs edge by edge, so it minimises coupling length, on raw Q (thesis 4.2)
or Q_T. The energy of a timed path is not a sum over its edges: objective "energy" searches
on Q_T and judges every path the search comes up with, and those between it and the straight
line, by predicted E_mean.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, require_choice
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.hotspot import feasible_part, resample
from ves_gym.planners.ompl_worker import ALGORITHMS, PathSearchResult, Request
from ves_gym.planners.query import NoPlan, Query, broken_limit, require_possible
from ves_gym.planners.search_costs import speed_limits

OBJECTIVES = {
    "q": "coupling length on raw Q (thesis 4.2)",
    "qt": "coupling length on Q_T",
    "energy": "predicted E_mean of the timed path",
    "time": "least time at the speed limits",
}
_START = 120.0  # s for a child to come up, on a busy machine
_GRACE = 10.0  # s a search may take longer than asked before it is killed
_RAMP = 0.2  # of a cruising motion's time to speed up in, and to slow down in
_POINTS = 65  # of a path that is drawn towards the straight line
_FOLLOWED = (48, 96)  # control points of a motion that has to stay on the path found


@dataclass(frozen=True, kw_only=True)
class Ompl:
    """OMPL's best path for a coupling objective, passed in the query's time."""

    objective: str = "qt"
    algorithm: str = "bitstar"
    evaluations: int = 5000  # budget of edge costs; repeatable, unlike seconds
    seconds: float = 30.0
    relax: bool = True  # half of the budget takes what was found to a minimum near it

    def __post_init__(self) -> None:
        require_choice(self, "objective", tuple(OBJECTIVES))
        require_choice(self, "algorithm", tuple(ALGORITHMS))
        if not self.evaluations >= 1:
            raise ParameterError(f"evaluations must be >= 1, got {self.evaluations}")
        if not 0 < self.seconds < np.inf:
            raise ParameterError(f"seconds must be > 0 and finite, got {self.seconds}")

    @property
    def name(self) -> str:
        return f"ompl-{self.objective}"

    @property
    def summary(self) -> str:
        return f"OMPL {ALGORITHMS[self.algorithm]} on {OBJECTIVES[self.objective]}"

    def find(self, query: Query, seed: int) -> tuple[Motion, dict[str, Any]]:
        """Search a new tree every time; the seed and the budget decide the path.

        Args:
            query: the ends, limits and surroundings.
            seed: of OMPL's random numbers, >= 0.

        Returns:
            The motion, and the search's cost, counts and anytime curve.

        Raises:
            NoPlan: no path within the budget, or the child process failed.
        """
        require_possible(query)
        result = self.search(query, seed)
        assert result.path is not None
        motion, share = result.motion, 1.0
        if motion is None:
            motion, share = time_path(query, result.path)
        hurried = broken_limit(query, motion) is not None and self.objective != "time"
        if hurried:  # no time for this path: the fastest is the next best
            fast = replace(self, objective="time").search(query, seed)
            assert fast.path is not None
            motion, share = time_path(query, fast.path)
        info = {
            "objective": self.objective,
            "algorithm": self.algorithm,
            "cost": result.cost,
            "searched": result.searched,  # cost before relaxation
            "bound": result.bound,  # no path costs less
            "evaluations": result.evaluations,
            "checks": result.checks,
            "curve": [list(point) for point in result.curve],
            "points": len(result.path),
            "share": share,  # of the way from the straight line that the limits allow
            "hurried": hurried,
        }
        return motion, info

    def search(self, query: Query, seed: int) -> PathSearchResult:
        """Return way-points and the anytime curve, from the child process.

        Args:
            query: the ends, limits and surroundings.
            seed: of OMPL's random numbers, >= 0.

        Raises:
            MissingPackageError: OMPL is not installed.
            NoPlan: no path within the budget, or the child failed.
        """
        require(f"planner {self.name}", "ompl")
        ideal = replace(query, system=query.system.ideal())
        request = Request(
            query=ideal,
            objective=self.objective,
            algorithm=self.algorithm,
            seed=seed,
            evaluations=self.evaluations,
            seconds=self.seconds,
            relax=self.relax,
        )
        result = SEARCH_PROCESS.request(request, self.seconds + _GRACE)
        if result.path is None:
            raise NoPlan(
                f"no path found within {result.evaluations} cost evaluations and"
                f" {result.checks} validity checks"
            )
        return result


def time_path(query: Query, path: Array) -> tuple[Motion, float]:
    """Time way-points by a motion that respects the query's limits where one can.

    The first of these that does: smooth through them; along their straight edges by a
    quintic; by a law that cruises, for limits of speed. Without surroundings the path is
    drawn towards the straight line instead.

    Args:
        query: the duration and limits.
        path: (k, n) way-points [rad].

    Returns:
        The motion, and the share of the way from the straight line that is left [1].
    """
    smooth = Motion.through(path, query.duration)
    if broken_limit(query, smooth) is None:
        return smooth, 1.0
    if query.surroundings is None:
        return feasible_part(query, resample(path, _POINTS))
    for law in (quintic, cruise):
        for controls in _FOLLOWED:
            motion = follow(path, query.duration, speed_limits(query), controls, law)
            if broken_limit(query, motion) is None:
                return motion, 1.0
    return motion, 1.0


def follow(
    path: Array, duration: float, speed: Array, controls: int, law: Callable[[Array], Array]
) -> Motion:
    """Pass along the straight edges of a polyline, its corners rounded a little.

    Joint speeds stay in proportion to their limits: the law runs over the time the path takes
    with one joint at its limit throughout.

    Args:
        path: (k, n) way-points [rad].
        duration: of the motion [s].
        speed: (n,) speed limits [rad/s].
        controls: control points of the motion.
        law: rest-to-rest law on [0, 1], (N,) to (N,).

    Returns:
        The motion.
    """
    fine = resample(path, 2001)
    least = np.r_[0, np.cumsum(np.max(np.abs(np.diff(fine, axis=0)) / speed, axis=1))]
    at = law(np.linspace(0, 1, 20 * controls + 1)) * least[-1]
    q = np.stack([np.interp(at, least, column) for column in fine.T], axis=1)
    q[0], q[-1] = path[0], path[-1]
    return Motion.fit(q, duration, controls=controls)


def cruise(u: Array) -> Array:
    """Rest-to-rest law on [0, 1] with constant speed 1 / (1 - _RAMP) between its ramps."""
    x = np.clip(np.minimum(u, 1 - u) / _RAMP, 0.0, 1.0)
    ramp = _RAMP * x**4 * (2.5 - 3 * x + x**2)  # integral of the quintic
    way = (ramp + np.maximum(np.minimum(u, 1 - u) - _RAMP, 0.0)) / (1 - _RAMP)
    out: Array = np.where(u < 0.5, way, 1 - way)
    return out


# ----------------------------------------------------------------------------- child


class SearchProcess:
    """The searching process: started when first asked, started anew after it was killed.

    Not for several threads at once; a forked process starts its own.
    """

    def __init__(self, program: str = "") -> None:
        self.program = program or "from ves_gym.planners.ompl_worker import serve; serve()"
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0  # process that started it

    def request(self, request: Request, limit: float) -> PathSearchResult:
        """Send a request to the child and return its answer.

        Args:
            request: what to search.
            limit: time after which the child is killed [s].

        Raises:
            NoPlan: the child crashed, failed or did not answer in time.
        """
        try:
            self._require_running()
            self._requests.send(request)
            if not self._answers.poll(limit):
                raise NoPlan(f"the search did not answer within {limit:g} s and was killed")
            answer = self._answers.recv()
        except (EOFError, OSError):
            raise NoPlan(f"the search crashed: {self._kill()}") from None
        except BaseException:  # or the next request would get this one's answer
            self._kill()
            raise
        if not isinstance(answer, PathSearchResult):
            raise NoPlan(f"the search failed: {answer}")
        return answer

    def _require_running(self) -> None:
        if self._owner != os.getpid():
            self._process = None  # the process this one was forked from keeps it
        if self._process is not None and self._process.poll() is None:
            return
        self._kill()
        self._start()
        if not self._answers.poll(_START):
            raise NoPlan(f"the search did not start within {_START:g} s")
        self._answers.recv()  # it is there

    def _start(self) -> None:
        paths = os.pathsep.join(p or os.getcwd() for p in sys.path)
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - `_end` closes it
        process = subprocess.Popen(
            [sys.executable, "-c", self.program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, "PYTHONPATH": paths, **threads},
        )
        assert process.stdin is not None and process.stdout is not None
        self._process, self._owner = process, os.getpid()
        self._requests = Connection(os.dup(process.stdin.fileno()), readable=False)
        self._answers = Connection(os.dup(process.stdout.fileno()), writable=False)
        process.stdin.close()
        process.stdout.close()
        files = self._requests, self._answers, self._errors
        self._end = weakref.finalize(self, _end, process, *files)

    def _kill(self) -> str:
        """End the child, if there is one; how it had ended, and the last thing it said."""
        if self._process is None:
            return "not started"
        try:  # a child that crashed is still about to end
            code: int | None = self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            code = None
        self._errors.seek(0)
        messages = self._errors.read().decode(errors="replace").strip().splitlines()
        self._end()
        self._process = None
        how = "killed" if code is None else f"exit status {code}"
        return f"{how}; {messages[-1][:200]}" if messages else how


def _end(process: subprocess.Popen[bytes], *files: Any) -> None:
    for file in files:
        file.close()
    if process.poll() is None:
        process.kill()
    process.wait()


SEARCH_PROCESS = SearchProcess()
