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
from ves_gym.leaderboard.errors import Code, Rejection
from ves_gym.leaderboard.npy_io import pack, unpack
from ves_gym.leaderboard.policy_files import policies_of
from ves_gym.leaderboard.protocol import (
    ACTION,
    LEDGER_EPISODES,
    Problem,
    Seeds,
)
from ves_gym.leaderboard.tracks.action_recorder import Recorded, Replayed
from ves_gym.leaderboard.tracks.base import Answers, Case, Method, Progress, Row, row
from ves_gym.system.system import System

SETTINGS = ("control", "goal")  # of an environment, that a method may choose
_ACTIONS = "actions.npy"
_SLACK = 1e-12  # of an action's bound


class Episodes:
    """Policies and controllers on a registered environment; score: minus the return."""

    def payload(self, problem: Problem) -> str:
        """See `Track`."""
        return _ACTIONS

    def system(self, problem: Problem) -> System:
        """See `Track`."""
        return _task(problem, {}).system

    def seed_list(self, problem: Problem, seeds: Seeds) -> list[int]:
        """See `Track`."""
        return list(range(seeds.root, seeds.root + problem.count))

    def cases(self, problem: Problem, seeds: Seeds, method: Method, group: int) -> list[Case]:
        """See `Track`."""
        first = seeds.root if seeds.which == "public" else 0
        return [Case(f"episode-{k:03d}", first + k) for k in range(problem.count)]

    def run(
        self,
        problem: Problem,
        seeds: Seeds,
        controllers: Sequence[Controller],
        method: Method,
        members: Mapping[str, bytes],
        tell: Progress = lambda stage, done: None,
    ) -> Answers:
        """Evaluate controllers, one per group, and record what they do."""
        actions, rows = [], []
        for group, controller in enumerate(controllers):
            kept = Recorded(controller)
            found = evaluated(
                kept, problem, seeds, method.settings, lambda d: tell("episodes", d)
            )
            rows += self._rows(problem, seeds, method, group, found)
            actions += [kept.actions(r["seed"]) for r in found.rows]
        return Answers(rows, pack(np.concatenate(actions)), method, dict(members))

    def replay(
        self, problem: Problem, seeds: Seeds, method: Method, rows: Sequence[Row], data: bytes
    ) -> list[Row]:
        """See `Track`."""
        groups = len(method.seeds)
        lengths = np.array([r["length"] for r in rows], dtype=np.intp).reshape(groups, -1)
        ends = np.cumsum(lengths).reshape(lengths.shape)
        actions = _actions(data, problem, method, int(lengths.sum()))
        out: list[Row] = []
        for group in range(groups):
            parts = {
                seeds.root + k: actions[ends[group, k] - lengths[group, k] : ends[group, k]]
                for k in range(problem.count)
            }
            again = Replayed(parts)
            found = evaluated(again, problem, seeds, method.settings)
            for line in found.rows:
                if line["length"] != len(parts[line["seed"]]):
                    raise _length(line["seed"] - seeds.root, len(parts[line["seed"]]), line)
            _require_ledger(again.account.residuals(), seeds)
            out += self._rows(problem, seeds, method, group, found)
        return out

    def require_possible(self, problem: Problem, seeds: Seeds, rows: Sequence[Row]) -> None:
        """See `Track`. No term of these tasks' rewards is ever above zero."""
        for line in rows:
            lower_bounds.require_energies(line)
            if line["score"] is not None and line["score"] < 0:
                raise Rejection(Code.BELOW_FLOOR, f"{line['id']}: a return above zero")

    def again(
        self,
        problem: Problem,
        seeds: Seeds,
        method: Method,
        members: Mapping[str, bytes],
        rows: Sequence[Row],
        same: bool,
    ) -> None:
        """See `Track`."""
        recorded = _actions(members[_ACTIONS], problem, method, sum(r["length"] for r in rows))
        found = []
        for controller in controllers_of(method, members):
            kept = Recorded(controller)
            lines = evaluated(kept, problem, seeds, method.settings).rows
            found += [kept.actions(line["seed"]) for line in lines]
        acted = np.concatenate(found)
        if acted.shape != recorded.shape:
            raise Rejection(
                Code.NOT_REPRODUCED, f"{len(acted)} actions instead of {len(recorded)}"
            )
        gap = float(np.abs(acted - recorded).max())
        if gap > (0.0 if same else ACTION):
            where = np.argwhere(np.abs(acted - recorded) == gap)[0].tolist()
            raise Rejection(Code.NOT_REPRODUCED, f"action {where} is off by {gap:.3g}")

    # ---------------------------------------------------------------------- rows

    def _rows(
        self, problem: Problem, seeds: Seeds, method: Method, group: int, found: Evaluation
    ) -> list[Row]:
        scores = self._scores(problem, seeds, found)
        return [
            row(
                case,
                group,
                score=None if line["failed"] else score,
                success=line["success"],
                failed=line["failed"],
                energies=line,
                length=line["length"],
            )
            for case, line, score in zip(
                self.cases(problem, seeds, method, group), found.rows, scores, strict=True
            )
        ]

    def _scores(self, problem: Problem, seeds: Seeds, found: Evaluation) -> list[float | None]:
        """Lower is better: the return turned round. Returns of these tasks are never > 0."""
        return [0.0 - line["return"] for line in found.rows]


def controllers_of(method: Method, members: Mapping[str, bytes]) -> list[Controller]:
    """What a method runs: what is built in by its name, or the policies of a bundle."""
    if method.kind == "controller":
        try:
            return [get_controller(method.name, seed) for seed in method.seeds]
        except ParameterError as error:
            raise Rejection(Code.NOT_REPRODUCIBLE, str(error)) from None
    return list(policies_of(method, members))


def evaluated(
    controller: Controller,
    problem: Problem,
    seeds: Seeds,
    settings: Mapping[str, Any],
    tell: Any = None,
) -> Evaluation:
    """The episodes of a problem by a controller."""
    return evaluate(
        controller,
        _id(problem),
        episodes=problem.count,
        seed=seeds.root,
        progress=tell,
        **settings,
    )


def _task(problem: Problem, settings: Mapping[str, Any]) -> Task:
    given = {**gym.spec(_id(problem)).kwargs, **settings}
    return build_task(**{k: v for k, v in given.items() if k != "goal"})


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
    return settings


def require_settings(problem: Problem, settings: Mapping[str, Any]) -> None:
    """Raise a Rejection (MALFORMED_MANIFEST) unless the environment takes them."""
    unknown = [k for k in settings if k not in SETTINGS]
    if unknown:
        raise Rejection(
            Code.MALFORMED_MANIFEST,
            f"method.settings: {str(unknown[0])[:80]!r} is not one's own",
        )
    if "goal" in settings and not isinstance(settings["goal"], bool):
        raise Rejection(Code.MALFORMED_MANIFEST, "method.settings.goal must be a truth value")
    try:
        task = _task(problem, settings)
        if settings.get("goal") and task.goal_fields is None:
            raise ParameterError(f"task {task.kind} has no goal-conditioned variant")
    except (ValueError, TypeError, OverflowError, ArithmeticError) as error:
        raise Rejection(Code.MALFORMED_MANIFEST, f"method.settings: {error}") from None


def width_of(problem: Problem, settings: Mapping[str, Any]) -> int:
    """Numbers in an action."""
    task = _task(problem, settings)
    return task.control.width(task.system.arm)


def require_fit(problem: Problem, method: Method, policies: Sequence[Policy]) -> None:
    """Raise a Rejection (BAD_WEIGHTS) unless policies take what the environment shows."""
    task = _task(problem, method.settings)
    wanted = sum(f.size for f in task.fields()), task.control.width(task.system.arm)
    for policy in policies:
        have = policy.network.sizes[0], policy.network.sizes[-1]
        if have != wanted:
            raise Rejection(
                Code.BAD_WEIGHTS, f"{have} inputs and actions, the environment has {wanted}"
            )


def _actions(data: bytes, problem: Problem, method: Method, total: int) -> Array:
    width = width_of(problem, method.settings)
    actions = unpack(data, _ACTIONS, (None, width))
    if len(actions) != total:
        raise Rejection(
            Code.EPISODE_LENGTH, f"{len(actions)} actions, the rows speak of {total}"
        )
    if actions.size and np.abs(actions).max() > 1 + _SLACK:
        where = np.argwhere(np.abs(actions) > 1 + _SLACK)[0].tolist()
        raise Rejection(
            Code.BAD_ACTION, f"action {where} is {actions[tuple(where)]:g}, beyond +-1"
        )
    return actions


def _length(k: int, given: int, line: Mapping[str, Any]) -> Rejection:
    return Rejection(
        Code.EPISODE_LENGTH, f"episode {k}: {given} actions, it takes {line['length']}"
    )


def _require_ledger(found: Mapping[int, float], seeds: Seeds) -> None:
    for seed, relative in found.items():
        if not relative <= LEDGER_EPISODES:
            raise Rejection(
                Code.LEDGER_RESIDUAL,
                f"episode {seed - seeds.root}: {relative:.3g} of the energy turned over is"
                f" unaccounted for, at most {LEDGER_EPISODES:g}",
            )
