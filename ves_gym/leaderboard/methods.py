"""Who answers: a method as it is given to `run`, and as an entry names it to answer again."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ves_gym._util.params import ParameterError, require_one_of
from ves_gym.baselines.comparison import policy_files
from ves_gym.baselines.policy import Policy, load_policy, released
from ves_gym.baselines.registry import CONTROLLERS, get_controller
from ves_gym.leaderboard.entry import MOST_GROUPS, Code, Method, Refused, refusing
from ves_gym.leaderboard.files import policy_names
from ves_gym.leaderboard.problems import Problem
from ves_gym.leaderboard.tracks.base import chosen_settings
from ves_gym.leaderboard.tracks.damping import TUNERS, tuner
from ves_gym.planners.registry import PLANNERS, get_planner

# A planner, a controller per group, or a function that finds gains; see the tracks.
Agents = Sequence[Any]


class Entered(NamedTuple):
    """A method with the objects that answer, one per group, and the files it needs again."""

    method: Method
    agents: Agents
    name: str
    files: dict[str, bytes]
    about: dict[str, Any]  # what is told of it

    @property
    def built_in(self) -> bool:
        """True where it can answer again from the entry and the files."""
        return bool(self.method.name or self.method.weights)


def enter(problem: Problem, method: Any, seeds: Sequence[int]) -> Entered:
    """Return the method that somebody enters.

    Args:
        problem: that it is to answer.
        method: name of a built-in planner, controller or tuner, or of a released policy; files
            or folders of policies; or your planner, controller or function.
        seeds: of the method, 0, 1, ... in order, one per group; not used for policies.
    """
    if list(seeds) != list(range(len(seeds))) or not 1 <= len(seeds) <= MOST_GROUPS:
        raise ParameterError(
            f"seeds of a method must be 0, 1, ... in order, {MOST_GROUPS} at most, got"
            f" {', '.join(map(str, seeds)) or 'none'}: none can be picked"
        )
    if isinstance(method, (str, os.PathLike)):
        words = [os.fspath(method)]
    else:
        words = [os.fspath(k) for k in method] if isinstance(method, Sequence) else []
    id = problem.environment
    if id is not None and words and (len(words) > 1 or words[0] not in CONTROLLERS):
        return _policies(id, words)
    if len(words) > 1:
        raise ParameterError(f"expected one method, got {' '.join(words)}")
    agents = [_built_in(problem, words[0], k) if words else method for k in seeds]
    settings: dict[str, Any] = {}
    about: dict[str, Any] = {}
    if id is not None:
        settings = chosen_settings(agents[0], id)
        about = {"privileged": bool(agents[0].privileged)}
    name = words[0] if words else str(getattr(method, "name", ""))
    chosen = Method(
        kind="controller" if id is not None else problem.kinds[0],
        name=name if words and name in _builtin(problem) else "",
        seeds=tuple(seeds),
        settings=settings,
    )
    about["code"] = _code(agents[0])
    return Entered(chosen, agents, name, {}, about)


def answering(
    problem: Problem, method: Method, files: Mapping[str, bytes]
) -> tuple[Method, Agents]:
    """Return what answers again, built in or from the files; nothing submitted is run.

    Raises:
        Refused: WRONG_SEEDS, NOT_REPRODUCIBLE, BAD_POLICY, BAD_SETTINGS.
    """
    if method.kind == "policy":
        policies = _load(problem, method, files)
        choices = [_settings(policy, problem) for policy in policies]
        if any(choice != choices[0] for choice in choices):
            raise Refused(Code.BAD_POLICY, "policies of one entry must ask for the same")
        return replace(method, settings=choices[0]), policies
    if method.seeds != tuple(range(len(method.seeds))):
        raise Refused(
            Code.WRONG_SEEDS,
            f"seeds of a {method.kind} are 0, 1, ... in order, got {method.seeds}",
        )
    names = _builtin(problem)
    if method.name not in names:
        raise Refused(
            Code.NOT_REPRODUCIBLE,
            f"no recording, and no built-in {method.kind} {method.name!r}",
        )
    agents = [_built_in(problem, method.name, seed) for seed in method.seeds]
    settings = _settings(agents[0], problem) if method.kind == "controller" else {}
    return replace(method, settings=settings), agents


def _code(agent: Any) -> str:
    """Place of what answers, as module:name."""
    cls = agent if hasattr(agent, "__qualname__") else type(agent)
    return f"{cls.__module__}:{cls.__qualname__.partition('.')[0]}"


def _builtin(problem: Problem) -> Sequence[str]:
    if problem.environment is not None:
        return tuple(CONTROLLERS)
    return tuple(PLANNERS) if problem.track == "paths" else TUNERS


def _built_in(problem: Problem, name: str, seed: int) -> Any:
    if problem.environment is not None:
        return get_controller(name, seed)
    if problem.track == "paths":
        return get_planner(name)
    require_one_of("gains", name, TUNERS)
    return tuner(name)


def _settings(agent: Any, problem: Problem) -> dict[str, Any]:
    assert problem.environment is not None
    with refusing(Code.BAD_SETTINGS):
        settings = chosen_settings(agent, problem.environment)
    return settings


# ------------------------------------------------------------------------- policies


def _policies(id: str, words: Sequence[str]) -> Entered:
    places = [file for word in words for file in policy_files(word, id)]
    if not 1 <= len(places) <= MOST_GROUPS:
        raise ParameterError(f"an entry has 1 to {MOST_GROUPS} policies, got {len(places)}")
    policies = [load_policy(file) for file in places]
    settings = [chosen_settings(policy, id) for policy in policies]
    if any(choice != settings[0] for choice in settings):
        raise ParameterError("policies of one entry must ask for the same settings")
    files: dict[str, bytes] = {}
    for group, file in enumerate(places):
        table, weights = policy_names(group)
        files[table] = file.read_bytes()
        files[weights] = file.with_suffix(".safetensors").read_bytes()
    origin = policies[0].about
    method = Method(
        kind="policy",
        seeds=_training_seeds(policies),
        weights=tuple(_digest(files[policy_names(g)[1]]) for g in range(len(places))),
        settings=settings[0],
    )
    about = {"training": {k: origin[k] for k in ("algorithm", "steps", "env") if k in origin}}
    return Entered(method, policies, places[0].stem, files, about)


def _training_seeds(policies: Sequence[Policy]) -> tuple[int, ...]:
    """Return the seeds that the policies name, or their numbers."""
    numbers = [p.about.get("seed") for p in policies]
    seeds = [k for k in numbers if isinstance(k, int) and k >= 0]
    return tuple(seeds) if len(set(seeds)) == len(policies) else tuple(range(len(policies)))


def _load(problem: Problem, method: Method, files: Mapping[str, bytes]) -> list[Policy]:
    assert problem.environment is not None
    of_ours = {
        _digest(path.with_suffix(".safetensors").read_bytes()): path
        for path in released(problem.environment).values()
    }
    out = []
    for group, digest in enumerate(method.weights):
        table, weights = policy_names(group)
        if {table, weights} <= files.keys():
            if _digest(files[weights]) != digest:
                raise Refused(Code.BAD_POLICY, f"{weights}: not the weights that are named")
            out.append(_read(files, table, weights))
        elif digest in of_ours:
            out.append(load_policy(of_ours[digest]))
        else:
            raise Refused(
                Code.NOT_REPRODUCIBLE,
                f"{table} is not there, and no released policy has its weights",
            )
    return out


def _read(files: Mapping[str, bytes], table: str, weights: str) -> Policy:
    with tempfile.TemporaryDirectory() as folder:
        for name in (table, weights):
            (Path(folder) / name).write_bytes(files[name])
        with refusing(Code.BAD_POLICY, Exception):  # the parsers' own, whatever they raise
            policy = load_policy(Path(folder) / table)
    return policy


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
