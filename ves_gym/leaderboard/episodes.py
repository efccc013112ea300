"""Tracks of environments: episodes are recorded as actions, and replayed from them."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from ves_gym.baselines.controllers import Controller, get_controller
from ves_gym.baselines.evaluate import Evaluation, evaluate
from ves_gym.baselines.policy import Policy, load_policy
from ves_gym.core.params import Array, Index, Mask, ParameterError, read_table
from ves_gym.core.system import System
from ves_gym.envs.build import build_task
from ves_gym.envs.task import Task
from ves_gym.envs.vector import VesVectorEnv
from ves_gym.leaderboard import floor
from ves_gym.leaderboard.account import Account
from ves_gym.leaderboard.arrays import pack, unpack
from ves_gym.leaderboard.protocol import (
    ACTION,
    LEDGER_EPISODES,
    Problem,
    Seeds,
)
from ves_gym.leaderboard.rejection import Code, Rejection
from ves_gym.leaderboard.track import Answers, Case, Method, Progress, Row, row

ARCHITECTURES = ("mlp",)  # of `baselines/policy.py`: dense layers, tanh or ReLU
SETTINGS = ("control", "goal")  # of an environment, that a method may choose
_ACTIONS = "actions.npy"
_SLACK = 1e-12  # of an action's bound


def policy_names(group: int) -> tuple[str, str]:
    """Members that hold the policy of a group."""
    stem = "policy" if group == 0 else f"policy-{group}"
    return f"{stem}.json", f"{stem}.safetensors"


class Episodes:
    """Policies and controllers on a registered environment; score: minus the return."""

    sources: tuple[str, ...] = (
        "core",
        "effects",
        "envs",
        "baselines/evaluate.py",
        "leaderboard/episodes.py",
        "leaderboard/protocol.py",
    )

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
            floor.require_energies(line)
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


def policies_of(method: Method, members: Mapping[str, bytes]) -> list[Policy]:
    """The policies in a bundle's files.

    Raises:
        Rejection: UNKNOWN_ARCHITECTURE, HASH_MISMATCH, BAD_WEIGHTS.
    """
    if method.architecture not in ARCHITECTURES:
        raise Rejection(
            Code.UNKNOWN_ARCHITECTURE,
            f"must be one of {', '.join(ARCHITECTURES)}, got {str(method.architecture)[:80]!r}",
        )
    out = []
    with tempfile.TemporaryDirectory() as folder:
        for group, digest in enumerate(method.weights):
            named, weights = policy_names(group)
            if hashlib.sha256(members[weights]).hexdigest() != digest:
                raise Rejection(Code.HASH_MISMATCH, f"{weights}: not the weights of the method")
            for name in (named, weights):
                (Path(folder) / name).write_bytes(members[name])
            out.append(_policy(Path(folder) / named))
    return out


def _policy(path: Path) -> Policy:
    try:
        table = read_table(path)
        network = table.get("network")
        kinds = {"activation": ("tanh", "relu"), "output": ("clip", "tanh")}
        for key, known in kinds.items():
            if isinstance(network, dict) and network.get(key, known[0]) not in known:
                raise Rejection(
                    Code.UNKNOWN_ARCHITECTURE,
                    f"{key} must be one of {', '.join(known)}, got {str(network[key])[:80]!r}",
                )
        if table.get("schema") != "ves-policy/1":
            raise Rejection(
                Code.UNKNOWN_ARCHITECTURE, f"schema {str(table.get('schema'))[:80]!r}"
            )
        return load_policy(path)
    except Rejection:
        raise
    except Exception as error:  # the parsers' own, whatever a file made them raise
        why = f"{path.name}: {type(error).__name__}: {str(error).replace(str(path.parent), '')}"
        raise Rejection(Code.BAD_WEIGHTS, why[:300]) from None


# ------------------------------------------------------------------------ record, replay


class Recorded:
    """Acts as another controller does, and keeps its actions."""

    def __init__(self, inner: Controller) -> None:
        self.inner, self.name, self.privileged = inner, inner.name, inner.privileged
        self._kept: dict[int, list[Array]] = {}

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""
        self.inner.reset(env, ids)

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`; out of bounds is brought back, as the environment would."""
        actions = np.clip(env.batch.check(self.inner.act(env, observation)), -1.0, 1.0)
        roots = env.batch.episodes.root
        for i in np.flatnonzero(in_episode(env)).tolist():
            self._kept.setdefault(int(roots[i]), []).append(actions[i].copy())
        return actions

    def actions(self, seed: int) -> Array:
        """(steps, width) of the episode of a seed."""
        return np.array(self._kept[seed])


class Replayed:
    """Acts as was recorded; an action too few is none at all."""

    name = "replayed"
    privileged = False

    def __init__(self, actions: Mapping[int, Array]) -> None:
        self._actions = actions
        self.account = Account()

    def reset(self, env: VesVectorEnv, ids: Index) -> None:
        """See `Controller`."""

    def act(self, env: VesVectorEnv, observation: Any) -> Array:
        """See `Controller`."""
        e, fresh = env.batch.episodes, in_episode(env)
        out = np.zeros((env.num_envs, env.batch.width))
        for i in np.flatnonzero(fresh).tolist():
            known = self._actions[int(e.root[i])]
            if e.steps[i] < len(known):
                out[i] = known[e.steps[i]]
        if env.task.system.mode == "ideal":
            self.account.look(env, fresh)
        return out


def in_episode(env: VesVectorEnv) -> Mask:
    """(n,) environments in an episode that counts: a seed's first."""
    return np.asarray(env.batch.episodes.number == 0, dtype=bool)


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
