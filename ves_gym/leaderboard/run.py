"""`leaderboard run`: answer a problem and write the bundle that proves it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ves_gym._util.params import ParameterError, to_plain
from ves_gym._util.threads import on_one_thread
from ves_gym.baselines.controllers import Controller
from ves_gym.baselines.policy import load_policy
from ves_gym.baselines.registry import get_controller
from ves_gym.leaderboard import evaluators, fingerprint
from ves_gym.leaderboard.archive import MANIFEST, write_members
from ves_gym.leaderboard.bundle import SCHEMA, digest, sealed
from ves_gym.leaderboard.errors import BundleError
from ves_gym.leaderboard.policy_files import ARCHITECTURES, policy_names
from ves_gym.leaderboard.probes import require_behaviour
from ves_gym.leaderboard.protocol import (
    MOST_GROUPS,
    PROTOCOL,
    Problem,
    Seeds,
    get_problem,
    seeds_of,
)
from ves_gym.leaderboard.tracks.base import (
    Answers,
    LeaderboardTrack,
    Method,
    Progress,
    no_progress,
    repeated,
)
from ves_gym.leaderboard.tracks.damping import DampingTrack
from ves_gym.leaderboard.tracks.diagnosis import DiagnosisTrack
from ves_gym.leaderboard.tracks.paths import PathTrack
from ves_gym.leaderboard.tracks.policies import PolicyTrack, chosen_settings
from ves_gym.leaderboard.tracks.registry import get_track
from ves_gym.planners.query import Planner
from ves_gym.planners.registry import get_planner


def make_bundle(
    path: str | os.PathLike[str],
    track: str,
    problem: str,
    method: str | Planner | Controller | Sequence[str | os.PathLike[str]],
    *,
    name: str | None = None,
    author: str = "",
    seeds: Sequence[int] = (0,),
    salt: str | None = None,
    training: Mapping[str, Any] | None = None,
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Path:
    """Answer a problem and write the bundle.

    Args:
        path: new or empty folder, or a .zip file.
        method: name of a built-in planner, controller, tuner or selector; a planner or
            controller of one's own (its bundle can be replayed, not reproduced); or the files
            of policies.
        seeds: of the method, 0, 1, ... in order: one group of rows each. Policies: one per
            file, as told by them.
        salt: of the official seeds; None for the public ones.
        training: what it took to make the method, plain data; default what policies tell.
        folder, workers: see `DiagnosisTrack` and `PathTrack`.

    Returns:
        The path.
    """
    question = get_problem(track, problem)
    drawn = seeds_of(question, salt)
    try:
        require_behaviour(question)
    except BundleError as error:  # of what nobody would accept, sooner than hours later
        raise ParameterError(error.why) from None
    if not 1 <= len(seeds) <= MOST_GROUPS or tuple(seeds) != tuple(range(len(seeds))):
        raise ParameterError(
            f"seeds of a method must be 0, 1, ... in order, {MOST_GROUPS} at most, got"
            f" {', '.join(map(str, seeds)) or 'none'}: the protocol fixes them"
        )
    rules = get_track(track, folder, workers)
    begun = _timestamp()
    with on_one_thread():  # as `verify` does
        answers, described = _answer(rules, question, drawn, method, tuple(seeds), progress)
    if (twice := repeated(answers.rows, answers.method)) is not None:
        raise ParameterError(
            f"groups {twice[0]} and {twice[1]} do the same, and one of them would count twice:"
            " leave it out"
        )
    manifest = {
        "schema": SCHEMA,
        "track": track,
        "protocol": PROTOCOL[track],
        "problem": problem,
        "name": name or answers.method.name or described.get("name", ""),
        "author": author,
        "kind": answers.method.kind,
        "seeds": {
            "which": drawn.which,
            "mark": drawn.mark,
            "list": rules.seed_list(question, drawn),
        },
        "spec": spec_of(rules, question),
        "method": {k: v for k, v in to_plain(vars(answers.method)).items() if k != "kind"},
        "members": {},
        "rows": answers.rows,
        "about": {
            "versions": fingerprint.package_versions(),
            "cpu": fingerprint.cpu_model(),
            "simd": fingerprint.simd(),
            "settings": described.get("settings", {}),
            "training": dict(training)
            if training is not None
            else described.get("training", {}),
            "begun": begun,
            "ended": _timestamp(),
        },
    }
    members = {rules.payload(question): answers.payload, **answers.members}
    manifest["members"] = {
        k: {"bytes": len(data), "sha256": digest(data)} for k, data in members.items()
    }
    return write_members(path, {**members, MANIFEST: sealed(manifest)})


def spec_of(rules: LeaderboardTrack, problem: Problem) -> dict[str, Any]:
    """Return the hashes of all that an answer to a problem depends on.

    Args:
        rules: its track.
        problem: the problem.
    """
    system = rules.system(problem)
    id = problem.environment
    return {
        "environment": None if id is None else fingerprint.environment(id),
        "system": system.hash,
        "model": fingerprint.model_xml(system),
        "evaluator": evaluators.identity(problem),
    }


def _answer(
    rules: LeaderboardTrack,
    problem: Problem,
    drawn: Seeds,
    method: Any,
    seeds: tuple[int, ...],
    on_progress: Progress,
) -> tuple[Answers, dict[str, Any]]:
    if isinstance(rules, PathTrack):
        planner = get_planner(method) if isinstance(method, str) else method
        chosen = Method(kind="planner", name=planner.name, seeds=seeds)
        return rules.run(problem, drawn, planner, chosen, on_progress), {}
    if isinstance(rules, DiagnosisTrack):
        chosen = Method(kind="selector", name=str(method))
        return rules.run(problem, drawn, chosen, on_progress), {}
    if problem.environment is None:
        assert isinstance(rules, DampingTrack)
        chosen = Method(kind="gains", name=str(method), seeds=seeds)
        return rules.run_tuner(problem, drawn, chosen, on_progress), {}
    assert isinstance(rules, PolicyTrack)
    is_controller = hasattr(method, "act")
    if is_controller or isinstance(method, str):
        agents = [method] if is_controller else [get_controller(method, seed) for seed in seeds]
        chosen = Method(
            kind="controller",
            name=agents[0].name,
            seeds=seeds[: len(agents)],
            settings=chosen_settings(agents[0], problem.environment),
        )
        described = {"settings": {"privileged": bool(agents[0].privileged)}}
        return rules.run(problem, drawn, agents, chosen, {}, on_progress), described
    return _policies(rules, problem, drawn, [Path(p) for p in method], on_progress)


def _policies(
    rules: PolicyTrack, problem: Problem, drawn: Seeds, files: list[Path], on_progress: Progress
) -> tuple[Answers, dict[str, Any]]:
    if not 1 <= len(files) <= MOST_GROUPS:
        raise ParameterError(f"a bundle holds 1 to {MOST_GROUPS} policies, got {len(files)}")
    policies = [load_policy(file) for file in files]
    assert problem.environment is not None
    choices = [chosen_settings(p, problem.environment) for p in policies]
    if any(c != choices[0] for c in choices):
        raise ParameterError("policies of one bundle must ask for the same settings")
    members: dict[str, bytes] = {}
    weights = []
    for group, file in enumerate(files):
        named, data = policy_names(group)
        members[named] = file.read_bytes()
        members[data] = file.with_suffix(".safetensors").read_bytes()
        weights.append(hashlib.sha256(members[data]).hexdigest())
    told_seeds = [p.about.get("seed") for p in policies]
    seeds = [k for k in told_seeds if isinstance(k, int) and k >= 0]
    distinct = len(seeds) == len(files) and len(set(seeds)) == len(seeds)
    method = Method(
        kind="policy",
        seeds=tuple(seeds) if distinct else tuple(range(len(files))),
        architecture=ARCHITECTURES[0],
        weights=tuple(weights),
        settings=choices[0],
    )
    about = policies[0].about
    training = {k: about[k] for k in ("algorithm", "steps", "env") if k in about}
    described = {"name": str(about.get("algorithm", policies[0].name)), "training": training}
    controllers: list[Controller] = list(policies)
    return rules.run(problem, drawn, controllers, method, members, on_progress), described


def _timestamp() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
