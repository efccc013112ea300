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
from gymnasium.vector import AutoresetMode

from ves_gym._util.params import Array, Index
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import Evaluation, evaluate, make_vector, run_episodes
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.leaderboard.entry import Code, Refused, Results
from ves_gym.leaderboard.files import Recording
from ves_gym.leaderboard.problems import Problem, Seeds
from ves_gym.leaderboard.tracks.base import Answers, BoardTrack, Progress, no_progress, task_of

_SLACK = 1e-12  # of an action's bound


class TaskTrack(BoardTrack):
    """Policies and controllers on a registered environment: actions."""

    def shape(self) -> tuple[int, ...]:
        return (task_of(_id(self.problem), self.method.settings).action_width,)

    def answer(self, agents: Sequence[Controller], progress: Progress = no_progress) -> Answers:
        out, first, count = [], self.seeds.root, self.problem.count
        for group, agent in enumerate(agents):
            env = make_vector(
                _id(self.problem), count, AutoresetMode.DISABLED,
                **self.problem.settings, **self.method.settings,
            )  # fmt: skip
            actions: list[list[Array]] = [[] for _ in range(count)]
            ended = 0
            for period in run_episodes(agent, env, range(first, first + count)):
                for i in np.flatnonzero(period.seeds >= 0).tolist():
                    # as the environment takes them
                    done = np.clip(period.actions[i], -1.0, 1.0)
                    actions[int(period.seeds[i]) - first].append(done)
                ended += int(period.ended.sum())
                progress("episodes", (group + ended / count) / len(agents))
            env.close()
            out.append([np.array(k) for k in actions])
        return Answers(out)

    def replay(self, recording: Recording) -> Results:
        parts = []
        for group in recording:
            for k, actions in enumerate(group):
                if actions.size and np.abs(actions).max() > 1 + _SLACK:
                    raise Refused(Code.BAD_RECORDING, f"episode {k}: an action beyond +-1")
            by_seed = {self.seeds.root + k: actions for k, actions in enumerate(group)}
            evaluation = _evaluated(
                Replayed(by_seed), self.problem, self.seeds, **self.method.settings
            )
            for k, (row, actions) in enumerate(zip(evaluation.rows, group, strict=True)):
                if row["length"] != len(actions):
                    raise Refused(
                        Code.WRONG_LENGTH,
                        f"episode {k}: {len(actions)} actions, it takes {row['length']}",
                    )
            names = ("success", "failed", "E_mean", "E_peak", "E_res", "E_int")
            parts.append(self._scored({k: _column(evaluation, k) for k in names}))
        return {name: np.stack([part[name] for part in parts]) for name in parts[0]}

    def _scored(self, measured: Results) -> Results:
        """Results of one group, each (episodes,)."""
        score = np.where(measured["success"] > 0, measured["E_mean"], np.inf)
        names = ("success", "E_mean", "E_peak", "E_res")
        return {"score": score, **{k: measured[k] for k in names}}


class DampTrack(TaskTrack):
    """Score: the time integral of the strain energy over that of joints held by high gains."""

    def _scored(self, measured: Results) -> Results:
        score = measured["E_int"] / _locked_energy(self.problem, self.seeds)
        failed = (measured["failed"] > 0) | ~np.isfinite(score)
        return {
            "score": np.where(failed, np.inf, score),
            "success": measured["success"],
            "E_decay": measured["E_mean"],
            "E_peak": measured["E_peak"],
            "E_res": measured["E_res"],
        }


@lru_cache(maxsize=8)
def _locked_energy(problem: Problem, seeds: Seeds) -> Array:
    """(episodes,) integral of the strain energy under the high gains."""
    return _column(_evaluated(get_controller("high"), problem, seeds), "E_int")


def _evaluated(
    controller: Controller, problem: Problem, seeds: Seeds, **options: Any
) -> Evaluation:
    options = {**problem.settings, **options}
    return evaluate(
        controller, _id(problem), episodes=problem.count, seed=seeds.root, **options
    )


def _id(problem: Problem) -> str:
    assert problem.environment is not None
    return problem.environment


def _column(evaluation: Evaluation, name: str) -> Array:
    return np.array([float(row[name]) for row in evaluation.rows])


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
        episodes = env.batch.episodes
        out = np.zeros((env.num_envs, env.batch.width))
        for i in np.flatnonzero(episodes.number == 0).tolist():
            recorded = self._actions[int(episodes.root[i])]
            if episodes.steps[i] < len(recorded):
                out[i] = recorded[episodes.steps[i]]
        return out
