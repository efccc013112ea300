"""Tracks of environments: *tasks*, and *damping* where a policy or controller answers.

What is recorded is actions. In *tasks* the score of an episode is its energy, and an episode
that is not solved counts as the worst there is: energies are never compared over what is easy
alone. Entries are ranked by their share of solved episodes first (`leaderboard.statistics`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from ves_gym._util.params import Array, Index, Mask
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import Evaluation, evaluate
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.leaderboard.entry import Method, Results
from ves_gym.leaderboard.errors import Code, Refused
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import Problem
from ves_gym.leaderboard.seeds import Seeds
from ves_gym.leaderboard.tracks.base import Answers, Progress, no_progress
from ves_gym.leaderboard.tracks.settings import task_of

_SLACK = 1e-12  # of an action's bound


class TaskTrack:
    """Policies and controllers on a registered environment; see `base.TrackRules`."""

    def shape(self, problem: Problem, method: Method) -> tuple[int, ...]:
        """See `TrackRules`."""
        return (task_of(_id(problem), method.settings).action_width,)

    def answer(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        agents: Sequence[Controller],
        progress: Progress = no_progress,
    ) -> Answers:
        """See `TrackRules`."""
        out = []
        for group, agent in enumerate(agents):
            recorder = Recorded(agent)

            def step(done: float, group: int = group) -> None:
                progress("episodes", (group + done) / len(agents))

            evaluated(recorder, problem, seeds, method.settings, step)
            out.append([recorder.actions(seeds.root + k) for k in range(problem.count)])
        return Answers(out)

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, recording: Recording
    ) -> Results:
        """See `TrackRules`."""
        parts = []
        for group in recording:
            for k, actions in enumerate(group):
                if actions.size and np.abs(actions).max() > 1 + _SLACK:
                    raise Refused(Code.BAD_RECORDING, f"episode {k}: an action beyond +-1")
            by_seed = {seeds.root + k: actions for k, actions in enumerate(group)}
            evaluation = evaluated(Replayed(by_seed), problem, seeds, method.settings)
            for k, (row, actions) in enumerate(zip(evaluation.rows, group, strict=True)):
                if row["length"] != len(actions):
                    raise Refused(
                        Code.WRONG_LENGTH,
                        f"episode {k}: {len(actions)} actions, it takes {row['length']}",
                    )
            parts.append(self._results(problem, seeds, evaluation))
        return {name: np.stack([part[name] for part in parts]) for name in parts[0]}

    def _results(self, problem: Problem, seeds: Seeds, evaluation: Evaluation) -> Results:
        """Results of one group, each (episodes,)."""
        energies = {k: _column(evaluation, k) for k in ("E_mean", "E_peak", "E_res")}
        success = _column(evaluation, "success")
        return {
            "score": np.where(success > 0, energies["E_mean"], np.inf),
            "success": success,
            **energies,
        }


class DampTrack(TaskTrack):
    """Score: the time integral of the strain energy over that of joints held by high gains."""

    def _results(self, problem: Problem, seeds: Seeds, evaluation: Evaluation) -> Results:
        """See `TaskTrack`."""
        score = _column(evaluation, "E_int") / _held(problem, seeds)
        failed = (_column(evaluation, "failed") > 0) | ~np.isfinite(score)
        return {
            "score": np.where(failed, np.inf, score),
            "success": _column(evaluation, "success"),
            "E_decay": _column(evaluation, "E_mean"),
            "E_peak": _column(evaluation, "E_peak"),
            "E_res": _column(evaluation, "E_res"),
        }


@lru_cache(maxsize=8)
def _held(problem: Problem, seeds: Seeds) -> Array:
    """(episodes,) integral of the strain energy under the high gains."""
    return _column(evaluated(get_controller("high"), problem, seeds, {}), "E_int")


def evaluated(
    controller: Controller,
    problem: Problem,
    seeds: Seeds,
    settings: Mapping[str, Any],
    progress: Any = None,
) -> Evaluation:
    """The episodes of a problem by a controller."""
    return evaluate(
        controller,
        _id(problem),
        episodes=problem.count,
        seed=seeds.root,
        progress=progress,
        **settings,
    )


def _id(problem: Problem) -> str:
    assert problem.environment is not None
    return problem.environment


def _column(evaluation: Evaluation, name: str) -> Array:
    return np.array([float(row[name]) for row in evaluation.rows])


class Recorded:
    """Acts as another controller does, and keeps its actions.

    Args:
        inner: the controller.
    """

    def __init__(self, inner: Controller) -> None:
        self.inner, self.name, self.privileged = inner, inner.name, inner.privileged
        self._recorded: dict[int, list[Array]] = {}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        self.inner.reset(env, ids)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`; out of bounds is brought back, as the environment would."""
        actions = np.clip(env.batch.check(self.inner.act(env, observation)), -1.0, 1.0)
        roots = env.batch.episodes.root
        for i in np.flatnonzero(_in_episode(env)).tolist():
            self._recorded.setdefault(int(roots[i]), []).append(actions[i].copy())
        return actions

    def actions(self, seed: int) -> Array:
        """(steps, width) of the episode of a seed."""
        return np.array(self._recorded[seed])


class Replayed:
    """Acts as was recorded; an action too few is none at all.

    Args:
        actions: (steps, width) by the seed of the episode.
    """

    name = "replayed"
    privileged = False

    def __init__(self, actions: Mapping[int, Array]) -> None:
        self._actions = actions

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        episodes = env.batch.episodes
        out = np.zeros((env.num_envs, env.batch.width))
        for i in np.flatnonzero(_in_episode(env)).tolist():
            recorded = self._actions[int(episodes.root[i])]
            if episodes.steps[i] < len(recorded):
                out[i] = recorded[episodes.steps[i]]
        return out


def _in_episode(env: VesVectorEnv) -> Mask:
    """(n,) environments in an episode that counts: a seed's first."""
    return np.asarray(env.batch.episodes.number == 0, dtype=bool)
