"""Track *damping*: policies on PumaDamp, and joint gains on releases of the thesis's kind.

Score: the time integral of the strain energy over that of the same start with the joints held
by the thesis's high gains (eq. 4.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.baselines.evaluate import Evaluation
from ves_gym.baselines.registry import get_controller
from ves_gym.damping.free_vibration import simulate_free_vibration
from ves_gym.damping.plant import GainMatrices, plant_at
from ves_gym.damping.tuning import OBJECTIVES, WIDE, tune
from ves_gym.envs.damp import Damp
from ves_gym.leaderboard import lower_bounds
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.protocol import (
    PPED_SECONDS,
    PPED_VEHICLE,
    Problem,
    Seeds,
)
from ves_gym.leaderboard.tracks.base import (
    Answers,
    Case,
    Method,
    Progress,
    Row,
    no_progress,
    require_as_good,
    row,
)
from ves_gym.leaderboard.tracks.policies import PolicyTrack, evaluated
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.simulation.divergence import Divergence
from ves_gym.system.system import System

TUNERS = ("high", "thesis", *OBJECTIVES, *(f"{k}-full" for k in OBJECTIVES))
_ENERGY = Damp().energy  # J, of strain at the start
_GAINS = "gains.npy"
_EDGE = 1 + 1e-6  # of a bound, for rounding


class DampingTrack(PolicyTrack):
    """Environments as in `PolicyTrack`; problems pped-... ask for gains instead."""

    def payload(self, problem: Problem) -> str:
        """See `LeaderboardTrack`."""
        return super().payload(problem) if problem.environment is not None else _GAINS

    def system(self, problem: Problem) -> System:
        """See `LeaderboardTrack`."""
        if problem.environment is not None:
            return super().system(problem)
        return System(vehicle=get_vehicle(PPED_VEHICLE))

    def seed_list(self, problem: Problem, seeds: Seeds) -> list[int]:
        """See `LeaderboardTrack`."""
        if problem.environment is not None:
            return super().seed_list(problem, seeds)
        return [seeds.root]

    def cases(self, problem: Problem, seeds: Seeds, method: Method, group: int) -> list[Case]:
        """See `LeaderboardTrack`."""
        if problem.environment is not None:
            return super().cases(problem, seeds, method, group)
        seed = method.seeds[group]
        return [Case(f"release-{k:03d}", seed) for k in range(problem.count)]

    def run_tuner(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        on_progress: Progress = no_progress,
    ) -> Answers:
        """Find gains for every release, and simulate them."""
        tuned = self._tuned(problem, seeds, method, on_progress)
        rows = self._released(problem, seeds, method, tuned)
        return Answers(rows, pack(tuned.reshape(-1, *tuned.shape[2:])), method)

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Row]:
        """See `LeaderboardTrack`."""
        if problem.environment is not None:
            return super().replay(problem, seeds, method, rows, data)
        n = self.system(problem).arm.n
        if any(r["length"] != 1 for r in rows):
            raise BundleError(Code.EPISODE_LENGTH, "a release has one set of gains")
        gains = unpack(data, _GAINS, (None, 2, n, n))
        if len(gains) != len(rows):
            raise BundleError(
                Code.EPISODE_LENGTH, f"{len(gains)} gains for {len(rows)} releases"
            )
        _require_gains(gains)
        groups = len(method.seeds)
        return self._released(problem, seeds, method, gains.reshape(groups, -1, 2, n, n))

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """See `LeaderboardTrack`."""
        system = self.system(problem).ideal()
        for result in rows:
            lower_bounds.require_energies(result)
            if result["score"] is None or result["E_int"] is None or result["E_peak"] is None:
                continue
            least = lower_bounds.strain_floor(system, _ENERGY, result["E_peak"])
            if result["E_int"] < least:
                raise BundleError(
                    Code.BELOW_FLOOR,
                    f"{result['id']}: E_int {result['E_int']:.3g} J s, the base cannot give its"
                    f" energy away faster than {least:.3g} J s",
                )

    def reproduce(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        members: Mapping[str, bytes],
        rows: Sequence[Row],
    ) -> list[Row]:
        """See `LeaderboardTrack`. Scores of gains are compared, not gains."""
        if problem.environment is not None:
            return super().reproduce(problem, seeds, method, members, rows)
        if method.name not in TUNERS:
            raise BundleError(Code.NOT_REPRODUCIBLE, f"no tuner {method.name!r:.80}")
        tuned = self._tuned(problem, seeds, method)
        mine = self._released(problem, seeds, method, tuned)
        require_as_good(rows, mine)
        return mine

    # ---------------------------------------------------------------------- rows

    def _scores(
        self, problem: Problem, seeds: Seeds, evaluation: Evaluation
    ) -> list[float | None]:
        high = evaluated(get_controller("high"), problem, seeds, {})
        return [
            mine["E_int"] / its["E_int"] if np.isfinite(mine["E_int"] / its["E_int"]) else None
            for mine, its in zip(evaluation.rows, high.rows, strict=True)
        ]

    def _released(
        self, problem: Problem, seeds: Seeds, method: Method, gains: Array
    ) -> list[Row]:
        system, out = self.system(problem), []
        high = GainMatrices.of(HIGH_GAINS)
        for group in range(len(method.seeds)):
            cases = self.cases(problem, seeds, method, group)
            for case, (q, y), (K, B) in zip(
                cases, releases(problem, seeds), gains[group], strict=True
            ):
                result = _let_go(system, case, group, q, y, [high, GainMatrices(K, B)])
                out.append(result)
        return out

    def _tuned(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        on_progress: Progress = no_progress,
    ) -> Array:
        """(groups, releases, 2, n, n) gains."""
        if method.name not in TUNERS:
            raise ParameterError(
                f"gains must be one of {', '.join(TUNERS)}, got {method.name!r:.80}"
                f"{did_you_mean(method.name, TUNERS)}"
            )
        system, questions = self.system(problem), releases(problem, seeds)
        out: list[list[Array]] = []
        for seed in method.seeds:
            out.append([])
            for k, (q, y) in enumerate(questions):
                out[-1].append(np.stack(_gains(system, method.name, q, y, seed)))
                on_progress("gains", (k + 1) / len(questions))
        return np.array(out)


def releases(problem: Problem, seeds: Seeds) -> list[tuple[Array, Array]]:
    """Joint angles and displacements, drawn as the episodes of task damp are."""
    task = replace(Damp(), system=System(vehicle=get_vehicle(PPED_VEHICLE), physics_dt=2.5e-3))
    u = np.random.default_rng((seeds.root, 0)).random((problem.count, task.draws))
    begin = task.start(u)
    y = np.broadcast_to(begin.y, (problem.count, 6))
    return list(zip(begin.q, y, strict=True))


def _gains(system: System, name: str, q: Array, y: Array, seed: int) -> GainMatrices:
    if name in ("high", "thesis"):
        return GainMatrices.of(HIGH_GAINS if name == "high" else PPED_GAINS)
    objective = name.removesuffix("-full")
    tuned = tune(plant_at(system, q), objective, y=y, full=name != objective, seed=seed)
    return tuned.gains


def _let_go(
    system: System, case: Case, group: int, q: Array, y: Array, gains: list[GainMatrices]
) -> Row:
    try:
        run = simulate_free_vibration(system, q, gains, y, seconds=PPED_SECONDS)
    except Divergence:
        none: dict[str, float | None] = {}
        return row(case, group, score=None, success=False, failed=True, energies=none, length=1)
    measured: dict[str, float | None] = {
        "E_mean": float(np.trapezoid(run.total[1], run.t) / run.t[-1]),
        "E_res": float(run.total[1, -1]),
        "E_peak": float(run.total[1].max()),
        "E_int": float(run.E_int[1]),
    }
    settled = bool(np.isfinite(run.t_5[1]))
    score = float(run.E_int[1] / run.E_int[0])
    return row(
        case, group, score=score, success=settled, failed=False, energies=measured, length=1
    )


def _require_gains(gains: Array) -> None:
    """Refuse gains that are not symmetric with eigenvalues inside the bounds."""
    if not np.allclose(gains, np.swapaxes(gains, -1, -2), rtol=1e-9, atol=1e-9):
        raise BundleError(Code.BAD_ACTION, "gains must be symmetric matrices")
    for k, name in enumerate(("K", "B")):
        low, high = getattr(WIDE, name)
        values = np.linalg.eigvalsh(gains[:, k])
        if values.min() < low / _EDGE or values.max() > high * _EDGE:
            raise BundleError(
                Code.BAD_ACTION,
                f"{name} must have eigenvalues from {low:g} to {high:g}, got"
                f" {values.min():.4g} to {values.max():.4g}",
            )
