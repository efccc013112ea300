"""Track *damping*, its problem of gains: joint gains for releases of the thesis's kind.

Score: the time integral of the strain energy over that of the same start with the joints held
by the thesis's high gains (eq. 4.6). Policies and controllers answer `tasks.DampTrack`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ves_gym._util.params import Array
from ves_gym.damping.free_vibration import simulate_free_vibration
from ves_gym.damping.plant import GainMatrices, plant_at
from ves_gym.damping.tuning import OBJECTIVES, WIDE, tune
from ves_gym.envs.damp import Damp
from ves_gym.leaderboard.entry import Code, Refused, Results
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import GAINS_VEHICLE, Problem, Seeds
from ves_gym.leaderboard.tracks.base import Answers, BoardTrack, Progress, no_progress
from ves_gym.mechanics.servo import HIGH_GAINS, PPED_GAINS
from ves_gym.mechanics.vehicle import get_vehicle
from ves_gym.simulation.machines import Divergence
from ves_gym.system.system import System

TUNERS = ("high", "thesis", *OBJECTIVES, *(f"{k}-full" for k in OBJECTIVES))
SECONDS = 20.0  # of every release
_EDGE = 1 + 1e-6  # of a bound, for rounding
_MEASURES = ("score", "success", "E_decay", "E_peak", "E_res")

# system, joint angles (n,), displacement (6,), seed -> gains
Tuner = Callable[[System, Array, Array, int], GainMatrices]


class GainTrack(BoardTrack):
    """Gains for every release: matrices K and B."""

    def shape(self) -> tuple[int, ...]:
        n = _system().arm.n
        return (n, n)

    def answer(self, agents: Sequence[Tuner], progress: Progress = no_progress) -> Answers:
        questions = releases(self.problem, self.seeds)
        out: list[list[Array]] = []
        for find, seed in zip(agents, self.method.seeds, strict=True):
            out.append([])
            for k, (q, y) in enumerate(questions):
                out[-1].append(np.stack(find(_system(), q, y, seed)))
                progress("gains", (k + 1) / len(questions))
        return Answers(out)

    def replay(self, recording: Recording) -> Results:
        questions = releases(self.problem, self.seeds)
        for group in recording:
            for gains in group:
                _require_gains(gains)
        rows = [
            [_let_go(q, y, gains) for (q, y), gains in zip(questions, group, strict=True)]
            for group in recording
        ]
        return {
            name: np.array([[row[name] for row in group] for group in rows])
            for name in _MEASURES
        }


def tuner(name: str) -> Tuner:
    """A built-in tuner, one of `TUNERS`."""
    if name in ("high", "thesis"):
        fixed = GainMatrices.of(HIGH_GAINS if name == "high" else PPED_GAINS)
        return lambda system, q, y, seed: fixed
    objective = name.removesuffix("-full")

    def find(system: System, q: Array, y: Array, seed: int) -> GainMatrices:
        full = name != objective
        return tune(plant_at(system, q), objective, y=y, full=full, seed=seed).gains

    return find


def releases(problem: Problem, seeds: Seeds) -> list[tuple[Array, Array]]:
    """Joint angles and displacements, drawn as the episodes of task damp are."""
    task = replace(Damp(), system=_system().replace(physics_dt=2.5e-3))
    u = np.random.default_rng((seeds.root, 0)).random((problem.count, task.draws))
    begin = task.start(u)
    y = np.broadcast_to(begin.y, (problem.count, 6))
    return list(zip(begin.q, y, strict=True))


def _system() -> System:
    return System(vehicle=get_vehicle(GAINS_VEHICLE))


def _let_go(q: Array, y: Array, gains: Array) -> dict[str, float]:
    """Measures of one release, beside the high gains; infinite where it diverges."""
    both = [GainMatrices.of(HIGH_GAINS), GainMatrices(*gains)]
    try:
        run = simulate_free_vibration(_system(), q, both, y, seconds=SECONDS)
    except Divergence:
        return {**dict.fromkeys(_MEASURES, np.inf), "success": 0.0}
    return {
        "score": float(run.E_int[1] / run.E_int[0]),
        "success": float(np.isfinite(run.t_5[1])),
        "E_decay": float(np.trapezoid(run.total[1], run.t) / run.t[-1]),
        "E_peak": float(run.total[1].max()),
        "E_res": float(run.total[1, -1]),
    }


def _require_gains(gains: Array) -> None:
    """Refuse gains that are not symmetric with eigenvalues inside the bounds."""
    if len(gains) != 2:
        raise Refused(Code.WRONG_LENGTH, f"a release has matrices K and B, got {len(gains)}")
    if not np.allclose(gains, np.swapaxes(gains, -1, -2), rtol=1e-9, atol=1e-9):
        raise Refused(Code.BAD_RECORDING, "gains must be symmetric matrices")
    for k, name in enumerate(("K", "B")):
        low, high = getattr(WIDE, name)
        values = np.linalg.eigvalsh(gains[k])
        if values.min() < low / _EDGE or values.max() > high * _EDGE:
            raise Refused(
                Code.BAD_RECORDING,
                f"{name} must have eigenvalues from {low:g} to {high:g}, got"
                f" {values.min():.4g} to {values.max():.4g}",
            )
