"""Tracks of environments: episodes are recorded as actions, and replayed from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym._util.params import Array, ParameterError
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.evaluate import Evaluation, evaluate
from ves_gym.baselines.policy import Policy
from ves_gym.baselines.registry import get_controller
from ves_gym.envs.build import build_task
from ves_gym.envs.task import Task
from ves_gym.leaderboard import lower_bounds
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.policy_files import policies_of
from ves_gym.leaderboard.protocol import (
    ACTION,
    LEDGER_EPISODES,
    Problem,
    Seeds,
)
from ves_gym.leaderboard.tracks.action_recorder import Recorded, Replayed
from ves_gym.leaderboard.tracks.base import (
    Answers,
    Case,
    Method,
    Progress,
    Row,
    no_progress,
    row,
)
from ves_gym.system.system import System

SETTINGS = ("control", "goal")  # of an environment, that a method may choose
ACTIONS = "actions.npy"
_SLACK = 1e-12  # of an action's bound


class PolicyTrack:
    """Policies and controllers on a registered environment; score: minus the return."""

    LEVELS: int | None = None  # of an action on either side of zero; None: any number

    def payload(self, problem: Problem) -> str:
        """See `LeaderboardTrack`."""
        return ACTIONS

    def system(self, problem: Problem) -> System:
        """See `LeaderboardTrack`."""
        return _task(problem, {}).system

    def seed_list(self, problem: Problem, seeds: Seeds) -> list[int]:
        """See `LeaderboardTrack`."""
        return list(range(seeds.root, seeds.root + problem.count))

    def cases(self, problem: Problem, seeds: Seeds, method: Method, group: int) -> list[Case]:
        """See `LeaderboardTrack`."""
        first = seeds.root if seeds.which == "public" else 0
        return [Case(f"episode-{k:03d}", first + k) for k in range(problem.count)]

    def run(
        self,
        problem: Problem,
        seeds: Seeds,
        controllers: Sequence[Controller],
        method: Method,
        members: Mapping[str, bytes],
        on_progress: Progress = no_progress,
    ) -> Answers:
        """Evaluate controllers, one per group, and record what they do."""
        actions, rows = [], []
        for group, controller in enumerate(controllers):
            recorder = Recorded(controller, self.LEVELS)
            evaluation = evaluated(
                recorder, problem, seeds, method.settings, lambda d: on_progress("episodes", d)
            )
            rows += self._rows(problem, seeds, method, group, evaluation)
            actions += [recorder.actions(r["seed"]) for r in evaluation.rows]
        return Answers(rows, self._packed(np.concatenate(actions)), method, dict(members))

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Row]:
        """See `LeaderboardTrack`."""
        groups = len(method.seeds)
        lengths = np.array([r["length"] for r in rows], dtype=np.intp).reshape(groups, -1)
        ends = np.cumsum(lengths).reshape(lengths.shape)
        actions = self._actions(data, problem, method, int(lengths.sum()))
        out: list[Row] = []
        for group in range(groups):
            parts = {
                seeds.root + k: actions[ends[group, k] - lengths[group, k] : ends[group, k]]
                for k in range(problem.count)
            }
            replayed = Replayed(parts)
            evaluation = evaluated(replayed, problem, seeds, method.settings)
            for result in evaluation.rows:
                if result["length"] != len(parts[result["seed"]]):
                    raise _length(
                        result["seed"] - seeds.root, len(parts[result["seed"]]), result
                    )
            _require_ledger(replayed.account.residuals(), seeds)
            out += self._rows(problem, seeds, method, group, evaluation)
        return out

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """See `LeaderboardTrack`. No term of these tasks' rewards is ever above zero."""
        for result in rows:
            lower_bounds.require_energies(result)
            if result["score"] is not None and result["score"] < 0:
                raise BundleError(Code.BELOW_FLOOR, f"{result['id']}: a return above zero")

    def reproduce(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        members: Mapping[str, bytes],
        rows: Sequence[Row],
    ) -> list[Row]:
        """See `LeaderboardTrack`. The actions, too, must be those that were recorded."""
        total = sum(r["length"] for r in rows)
        recorded = self._actions(members[ACTIONS], problem, method, total)
        ends = np.cumsum([r["length"] for r in rows])
        mine: list[Row] = []
        for group, controller in enumerate(controllers_of(method, members)):
            recorder = Recorded(controller, self.LEVELS)
            evaluation = evaluated(recorder, problem, seeds, method.settings)
            mine += self._rows(problem, seeds, method, group, evaluation)
            first = group * problem.count
            for k, result in enumerate(evaluation.rows, start=first):
                its = recorded[ends[k] - rows[k]["length"] : ends[k]]
                _require_actions(recorder.actions(result["seed"]), its, rows[k])
        return mine

    # ---------------------------------------------------------------------- rows

    def _rows(
        self, problem: Problem, seeds: Seeds, method: Method, group: int, evaluation: Evaluation
    ) -> list[Row]:
        scores = self._scores(problem, seeds, evaluation)
        return [
            row(
                case,
                group,
                score=None if result["failed"] else score,
                success=result["success"],
                failed=result["failed"],
                energies=result,
                length=result["length"],
            )
            for case, result, score in zip(
                self.cases(problem, seeds, method, group), evaluation.rows, scores, strict=True
            )
        ]

    def _scores(
        self, problem: Problem, seeds: Seeds, evaluation: Evaluation
    ) -> list[float | None]:
        """Lower is better: the return turned round. Returns of these tasks are never > 0."""
        return [0.0 - result["return"] for result in evaluation.rows]

    # ------------------------------------------------------------------- payload

    def _packed(self, actions: Array) -> bytes:
        """Actions (total, width) as the file of the bundle."""
        return pack(actions)

    def _unpacked(self, data: bytes, width: int) -> Array:
        return unpack(data, ACTIONS, (None, width))

    def _actions(self, data: bytes, problem: Problem, method: Method, total: int) -> Array:
        """Actions (total, width) of a bundle, checked."""
        actions = self._unpacked(data, width_of(problem, method.settings))
        if len(actions) != total:
            raise BundleError(
                Code.EPISODE_LENGTH, f"{len(actions)} actions, the rows speak of {total}"
            )
        if actions.size and np.abs(actions).max() > 1 + _SLACK:
            where = np.argwhere(np.abs(actions) > 1 + _SLACK)[0].tolist()
            raise BundleError(
                Code.BAD_ACTION, f"action {where} is {actions[tuple(where)]:g}, beyond +-1"
            )
        return actions


def controllers_of(method: Method, members: Mapping[str, bytes]) -> list[Controller]:
    """Return the controllers of a method: built in by its name, or the policies of a bundle.

    Args:
        method: the answerer.
        members: files of the bundle.
    """
    if method.kind == "controller":
        try:
            return [get_controller(method.name, seed) for seed in method.seeds]
        except ParameterError as error:
            raise BundleError(Code.NOT_REPRODUCIBLE, str(error)) from None
    return list(policies_of(method, members))


def evaluated(
    controller: Controller,
    problem: Problem,
    seeds: Seeds,
    settings: Mapping[str, Any],
    on_progress: Any = None,
) -> Evaluation:
    """The episodes of a problem by a controller."""
    return evaluate(
        controller,
        _id(problem),
        episodes=problem.count,
        seed=seeds.root,
        progress=on_progress,
        **settings,
    )


def _task(problem: Problem, settings: Mapping[str, Any]) -> Task:
    kwargs = {**gym.spec(_id(problem)).kwargs, **settings}
    return build_task(**{k: v for k, v in kwargs.items() if k != "goal"})


def _id(problem: Problem) -> str:
    assert problem.environment is not None
    return problem.environment


def chosen_settings(controller: Controller, id: str) -> dict[str, Any]:
    """The settings of the environment that a controller asks for."""
    needs = getattr(controller, "settings", None)
    settings: dict[str, Any] = dict(needs(gym.spec(id))) if needs is not None else {}
    unknown = [k for k in settings if k not in SETTINGS]
    if unknown:
        raise ParameterError(
            f"{controller.name}: a method may choose {', '.join(SETTINGS)}, not {unknown[0]}"
        )
    if _names_control(id, settings):
        raise ParameterError(f"{controller.name}: {id} names its control, which stays")
    return settings


def _names_control(id: str, settings: Mapping[str, Any]) -> bool:
    """Whether a control is chosen in the place of one that is part of what an id asks."""
    return "control" in settings and "control" in gym.spec(id).kwargs


def require_settings(problem: Problem, settings: Mapping[str, Any]) -> None:
    """Raise a BundleError (MALFORMED_MANIFEST) unless the environment takes them."""
    unknown = [k for k in settings if k not in SETTINGS]
    if unknown:
        raise BundleError(
            Code.MALFORMED_MANIFEST,
            f"method.settings: {str(unknown[0])[:80]!r} is not one's own",
        )
    if "goal" in settings and not isinstance(settings["goal"], bool):
        raise BundleError(Code.MALFORMED_MANIFEST, "method.settings.goal must be a truth value")
    if _names_control(_id(problem), settings):
        raise BundleError(
            Code.MALFORMED_MANIFEST,
            f"method.settings.control: {problem.base} names its control, which stays",
        )
    try:
        task = _task(problem, settings)
        if settings.get("goal") and task.goal_fields is None:
            raise ParameterError(f"task {task.kind} has no goal-conditioned variant")
    except (ValueError, TypeError, OverflowError, ArithmeticError) as error:
        raise BundleError(Code.MALFORMED_MANIFEST, f"method.settings: {error}") from None


def width_of(problem: Problem, settings: Mapping[str, Any]) -> int:
    """Numbers in an action."""
    task = _task(problem, settings)
    return task.action_width


def require_fit(problem: Problem, method: Method, policies: Sequence[Policy]) -> None:
    """Raise a BundleError (BAD_WEIGHTS) unless policies take what the environment shows."""
    task = _task(problem, method.settings)
    expected = sum(f.size for f in task.fields()), task.action_width
    for policy in policies:
        have = policy.network.observations, policy.network.sizes[-1]
        if have != expected:
            raise BundleError(
                Code.BAD_WEIGHTS, f"{have} inputs and actions, the environment has {expected}"
            )


def _require_actions(acted: Array, recorded: Array, row: Row) -> None:
    where = f"{row['id']} of group {row['group']}"
    if acted.shape != recorded.shape:
        raise BundleError(
            Code.NOT_REPRODUCED, f"{where}: {len(acted)} actions, {len(recorded)} recorded"
        )
    gap = np.abs(acted - recorded)
    if gap.max(initial=0.0) > ACTION:
        at = np.unravel_index(np.argmax(gap), gap.shape)
        raise BundleError(
            Code.NOT_REPRODUCED,
            f"{where}: action {at[1] + 1} of period {at[0]} is {acted[at]:.6g}, recorded"
            f" {recorded[at]:.6g}",
        )


def _length(k: int, received: int, result: Mapping[str, Any]) -> BundleError:
    return BundleError(
        Code.EPISODE_LENGTH, f"episode {k}: {received} actions, it takes {result['length']}"
    )


def _require_ledger(residuals: Mapping[int, float], seeds: Seeds) -> None:
    for seed, relative in residuals.items():
        if not relative <= LEDGER_EPISODES:
            raise BundleError(
                Code.LEDGER_RESIDUAL,
                f"episode {seed - seeds.root}: {relative:.3g} of the energy turned over is"
                f" unaccounted for, at most {LEDGER_EPISODES:g}",
            )
