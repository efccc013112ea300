"""Minimum-coupling paths by sampling-based search (OMPL) in joint space.

A search adds up costs edge by edge, so it minimises coupling length, on raw Q (thesis 4.2)
or Q_T, or time. The energy of a timed path is not a sum over its edges: `refined` takes these
paths, where there are obstacles, to motions of least energy.
"""

from __future__ import annotations

import os
import pickle
import select
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import IO, Any

import numpy as np

from ves_gym._util.optional import require
from ves_gym._util.params import Array, ParameterError, require_choice
from ves_gym._util.process_pool import ONE_THREAD
from ves_gym.mechanics.motion import Motion, quintic
from ves_gym.planners.hotspot import feasible_part, resample
from ves_gym.planners.ompl_worker import ALGORITHMS, PathSearchResult, Request
from ves_gym.planners.query import NoPlan, Query, first_violation, require_possible

OBJECTIVES = {
    "q": "coupling length on raw Q (thesis 4.2)",
    "qt": "coupling length on Q_T",
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
        motion, share = time_path(query, result.path)
        hurried = first_violation(query, motion) is not None and self.objective != "time"
        if hurried:  # no time for this path: the fastest is the next best
            fast = replace(self, objective="time").search(query, seed)
            assert fast.path is not None
            motion, share = time_path(query, fast.path)
        info = {
            "objective": self.objective,
            "algorithm": self.algorithm,
            "cost": result.cost,
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
    if first_violation(query, smooth) is None:
        return smooth, 1.0
    if query.surroundings is None:
        return feasible_part(query, resample(path, _POINTS))
    for law in (quintic, cruise):
        for controls in _FOLLOWED:
            motion = follow(path, query.duration, query.speed, controls, law)
            if first_violation(query, motion) is None:
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

    A planner that crashes or hangs takes this process with it, and nothing else. It ends when
    its standard input does, so none is left behind; a forked process starts its own.
    """

    def __init__(self, program: str = "") -> None:
        self.program = program or "from ves_gym.planners.ompl_worker import serve; serve()"
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0  # process that started it

    def request(self, request: Request, limit: float) -> PathSearchResult:
        """Send a request to the child and return its answer.

        Args:
            request: what to search.
            limit: time after which the child is killed [s], its start not counted.

        Raises:
            NoPlan: the child crashed, failed or did not answer in time.
        """
        fresh = self._owner != os.getpid() or self._process is None
        process = self._start() if fresh or self._process is None else self._process
        assert process.stdin is not None and process.stdout is not None
        answer: object = None
        try:
            pickle.dump(request, process.stdin)
            process.stdin.flush()
            if not select.select([process.stdout], [], [], limit + fresh * _START)[0]:
                raise NoPlan(f"the search did not answer within {limit:g} s and was killed")
            answer = pickle.load(process.stdout)
        except (EOFError, OSError, pickle.UnpicklingError):
            raise NoPlan(f"the search crashed: {self._end()}") from None
        finally:
            if answer is None:  # or the next request would get this one's answer
                self._end()
        if not isinstance(answer, PathSearchResult):
            raise NoPlan(f"the search failed: {answer}")
        return answer

    def _start(self) -> subprocess.Popen[bytes]:
        paths = os.pathsep.join(p or os.getcwd() for p in sys.path)
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - `_stop` closes it
        process = subprocess.Popen(
            [sys.executable, "-c", self.program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env={**os.environ, "PYTHONPATH": paths, **ONE_THREAD},
        )
        self._stop = weakref.finalize(self, _stop, process, self._said)
        self._process, self._owner = process, os.getpid()
        return process

    def _end(self) -> str:
        """End the child, if there is one; how it had ended, and the last thing it said."""
        process, self._process = self._process, None
        if process is None:
            return "not started"
        try:  # one that crashed is still about to end
            how = f"exit status {process.wait(timeout=1.0)}"
        except subprocess.TimeoutExpired:
            how = "killed"
        self._said.seek(0)
        messages = self._said.read().decode(errors="replace").strip().splitlines()
        self._stop()
        return f"{how}; {messages[-1][:200]}" if messages else how


def _stop(process: subprocess.Popen[bytes], messages: IO[bytes]) -> None:
    process.kill()
    process.communicate()
    messages.close()


SEARCH_PROCESS = SearchProcess()
