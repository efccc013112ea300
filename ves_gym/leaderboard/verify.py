"""`leaderboard verify`: believe nothing of a bundle that can be computed.

*Replayed*: the recorded actions, motions, gains or answers are simulated or scored again, and
no submitted code runs. *Reproduced*: the method, too, is run again and must do as well.

The rows of an entry are those computed here, of the method's run where it is run again. What a
bundle says of its machine changes nothing of how strictly it is checked.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym._util.threads import on_one_thread
from ves_gym.leaderboard import evaluators
from ves_gym.leaderboard.archive import MANIFEST, SIGNATURE, read_members
from ves_gym.leaderboard.bundle import digest, read_manifest
from ves_gym.leaderboard.entry import LEVELS, Entry, check_entry, with_named_measures
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.fingerprint import processor_free
from ves_gym.leaderboard.policy_files import policies_of, policy_names
from ves_gym.leaderboard.probes import require_behaviour
from ves_gym.leaderboard.protocol import (
    FLIPPED,
    PROTOCOL,
    RELATIVE,
    SCORES,
    Problem,
    Seeds,
    get_problem,
    seeds_of,
)
from ves_gym.leaderboard.run import spec_of
from ves_gym.leaderboard.signature import signer
from ves_gym.leaderboard.tracks.base import (
    Case,
    LeaderboardTrack,
    Method,
    Progress,
    Row,
    claims_more,
    no_progress,
    repeated,
)
from ves_gym.leaderboard.tracks.policies import require_fit, require_settings
from ves_gym.leaderboard.tracks.registry import get_track

Plain = Mapping[str, Any]


@on_one_thread()
def verify(
    path: str | os.PathLike[str],
    *,
    level: str = "replayed",
    salt: str | None = None,
    expect: str | None = None,
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Entry:
    """Check a bundle.

    Args:
        path: folder or .zip file.
        level: "replayed" or "reproduced".
        salt: the maintainer's secret, for a bundle of official seeds.
        expect: SHA-256 that the manifest must have, such as a board tells.
        folder, workers: see `DiagnosisTrack` and `PathTrack`.
        progress: called with the stage and the fraction done, where it may take long.

    Returns:
        The entry, its numbers those computed here.

    Raises:
        ParameterError: no such bundle, a level that there is not, a salt that is missing.
        BundleError: what is wrong with the bundle.
    """
    if level not in LEVELS:
        raise ParameterError(
            f"level must be one of {', '.join(LEVELS)}, got {level!r}"
            f"{did_you_mean(level, LEVELS)}"
        )
    members = read_members(path)
    if MANIFEST not in members:
        raise BundleError(Code.MISSING_MEMBER, f"there is no {MANIFEST}")
    computed = digest(members[MANIFEST])
    if expect is not None and computed != expect:
        raise BundleError(Code.HASH_MISMATCH, f"{MANIFEST} is {computed}, expected {expect}")
    manifest = read_manifest(members[MANIFEST])
    key = _signer(members)
    problem = _problem(manifest)
    evaluators.require_same(problem, manifest["spec"]["evaluator"])
    require_behaviour(problem)  # before anything else is computed here
    rules = get_track(problem.track, folder, workers, progress)
    method = _method(manifest)
    _require_seeds(method)
    _require_members(manifest, members, rules.payload(problem), method)
    ours = spec_of(rules, problem)
    _require_spec(manifest, ours)
    seeds = _seeds(manifest, problem, salt, rules)
    if problem.environment is not None:
        require_settings(problem, method.settings)
    elif method.settings:
        raise BundleError(Code.MALFORMED_MANIFEST, "method.settings: there is no environment")
    _require_rows(manifest["rows"], problem, seeds, method, rules)
    if method.kind == "policy":
        require_fit(problem, method, policies_of(method, members))
    rules.require_possible(problem, seeds, manifest["rows"])
    data = members[rules.payload(problem)]
    with _careful(Code.BAD_ACTION):
        replayed = rules.replay(problem, seeds, method, manifest["rows"], data)
    rules.require_possible(problem, seeds, replayed)
    _require_claims(manifest["rows"], replayed)
    _require_distinct(replayed, method)
    official = {} if seeds.mark is None else {"salt": seeds.mark}
    about = {"model": ours["model"], **official, **key}
    if level == "replayed":
        return _entry(manifest, replayed, level, computed, about)
    with _careful(Code.NOT_REPRODUCIBLE):
        found = rules.reproduce(problem, seeds, method, members, replayed)
    rules.require_possible(problem, seeds, found)
    _require_distinct(found, method)
    measured = {"reproduction": _difference(replayed, found)}
    return _entry(manifest, found, level, computed, {**about, **measured})


@contextmanager
def _careful(code: Code) -> Iterator[None]:
    """Numbers that no simulation can carry on with are the bundle's fault."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (ValueError, ArithmeticError) as error:
        raise BundleError(code, f"cannot be run: {str(error)[:200]}") from None


def bundle_manifest(path: str | os.PathLike[str]) -> tuple[dict[str, Any], bytes]:
    """A bundle's manifest, checked by itself alone, and its bytes."""
    members = read_members(path)
    if MANIFEST not in members:
        raise BundleError(Code.MISSING_MEMBER, f"there is no {MANIFEST}")
    return read_manifest(members[MANIFEST]), members[MANIFEST]


def _signer(members: Mapping[str, bytes]) -> dict[str, str]:
    """The key of an entry's account, nothing for a bundle that is not signed."""
    if SIGNATURE not in members:
        return {}
    return {"key": signer(members[MANIFEST], members[SIGNATURE])}


def _problem(manifest: Plain) -> Problem:
    name = manifest["track"]
    if name not in PROTOCOL:
        raise BundleError(Code.UNKNOWN_PROBLEM, f"no track {name!r:.80}")
    if manifest["protocol"] != PROTOCOL[name]:
        raise BundleError(
            Code.OLD_PROTOCOL,
            f"version {manifest['protocol']} of track {name}, now it is {PROTOCOL[name]}",
        )
    try:
        problem = get_problem(name, manifest["problem"])
    except ParameterError as error:
        raise BundleError(Code.UNKNOWN_PROBLEM, str(error)) from None
    if manifest["kind"] not in problem.kinds():
        raise BundleError(
            Code.UNKNOWN_PROBLEM,
            f"{problem.name} is answered by {' or '.join(problem.kinds())}, not by"
            f" {manifest['kind']}",
        )
    return problem


def _method(manifest: Plain) -> Method:
    plain = manifest["method"]
    return Method(
        kind=manifest["kind"],
        name=plain["name"],
        seeds=tuple(plain["seeds"]),
        architecture=plain["architecture"],
        weights=tuple(plain["weights"]),
        settings=plain["settings"],
    )


def _require_seeds(method: Method) -> None:
    """Seeds of what is built in are those of the protocol: none can be picked."""
    if method.kind != "policy" and method.seeds != tuple(range(len(method.seeds))):
        raise BundleError(
            Code.WRONG_SEEDS,
            f"seeds of a {method.kind} are 0, 1, ... in order, got"
            f" {', '.join(map(str, method.seeds))}",
        )


def _require_members(
    manifest: Plain, members: Mapping[str, bytes], payload: str, method: Method
) -> None:
    """The files that this bundle must have, with the digests that the manifest tells."""
    expected = {payload}
    for group in range(len(method.weights)):
        expected |= set(policy_names(group))
    for there in (set(manifest["members"]), set(members) - {MANIFEST, SIGNATURE}):
        if missing := sorted(expected - there):
            raise BundleError(Code.MISSING_MEMBER, missing[0])
        if extra := sorted(there - expected):
            raise BundleError(Code.EXTRA_MEMBER, extra[0])
    for name in sorted(expected):
        claimed, data = manifest["members"][name], members[name]
        if claimed != {"bytes": len(data), "sha256": digest(data)}:
            raise BundleError(Code.HASH_MISMATCH, f"{name} is not the file of the manifest")
    for group, weights in enumerate(method.weights):
        name = policy_names(group)[1]
        if digest(members[name]) != weights:
            raise BundleError(Code.HASH_MISMATCH, f"{name}: not the weights of the method")


def _require_spec(manifest: Plain, ours: Plain) -> None:
    there = manifest["spec"]
    if _any_processors(there["environment"]) != _any_processors(ours["environment"]):
        raise BundleError(
            Code.OLD_ENVIRONMENT,
            f"{_env(there['environment'])} then, {_env(ours['environment'])} now",
        )
    # `model` is not compared: MJCF's text is of MuJoCo's version and, in numbers that are zero
    # but for rounding, of the processor; what it says is in `system`, and is simulated again
    if processor_free(there["system"]) != processor_free(ours["system"]):
        raise BundleError(
            Code.SYSTEM_MISMATCH, f"{there['system'][:12]} then, {ours['system'][:12]} now"
        )


def _any_processors(plain: Plain | None) -> Plain | None:
    """Return an environment's record with the hash that all processors share."""
    return None if plain is None else {**plain, "spec": processor_free(plain["spec"])}


def _env(plain: Plain | None) -> str:
    return "none" if plain is None else f"{plain['id']} of {plain['spec'][:12]}"


def _seeds(
    manifest: Plain, problem: Problem, salt: str | None, rules: LeaderboardTrack
) -> Seeds:
    claimed = manifest["seeds"]
    if claimed["which"] == "official" and salt is None:
        raise ParameterError(
            "a bundle of official seeds: give the salt (--salt FILE), or where it was published"
            " with the board, the entry of the bundle (entries/....json) instead"
        )
    try:
        seeds = seeds_of(problem, salt if claimed["which"] == "official" else None)
    except ParameterError as error:
        raise BundleError(Code.WRONG_SEEDS, str(error)) from None
    if claimed["mark"] != seeds.mark:
        raise BundleError(Code.WRONG_SEEDS, "the mark is of another salt")
    expected = rules.seed_list(problem, seeds)
    if claimed["list"] != expected:
        raise BundleError(
            Code.WRONG_SEEDS, f"not the {claimed['which']} seeds of {problem.name}"
        )
    return seeds


def _require_rows(
    rows: Sequence[Row], problem: Problem, seeds: Seeds, method: Method, rules: LeaderboardTrack
) -> None:
    """One row per question and group, in order, with its seed."""
    questions: list[tuple[int, Case]] = [
        (group, case)
        for group in range(len(method.seeds))
        for case in rules.cases(problem, seeds, method, group)
    ]
    names = {(group, case.id) for group, case in questions}
    answered: set[tuple[int, str]] = set()
    for row in rows:
        key = (row["group"], row["id"])
        if key not in names or key in answered:
            how = "is there twice" if key in answered else "is no question of the problem"
            raise BundleError(Code.EXTRA_EPISODE, f"{row['id']!r:.80} of group {key[0]} {how}")
        answered.add(key)
    if missing := [case.id for group, case in questions if (group, case.id) not in answered]:
        raise BundleError(Code.MISSING_EPISODE, f"{missing[0]}, {len(missing)} in all")
    for row, (group, case) in zip(rows, questions, strict=True):
        if (row["group"], row["id"]) != (group, case.id):
            raise BundleError(Code.MALFORMED_MANIFEST, f"{row['id']!r:.80} is out of order")
        if row["seed"] != case.seed:
            raise BundleError(
                Code.WRONG_SEEDS, f"{case.id}: seed {row['seed']}, not {case.seed}"
            )


def _require_claims(claimed: Sequence[Row], replayed: Sequence[Row]) -> None:
    """Refuse claims that are better than the replay; worse ones cost only whoever makes them.

    1 % of the rows may cross a threshold by rounding.
    """
    off = [
        (mine, its, name)
        for mine, its in zip(replayed, claimed, strict=True)
        if (name := _claimed_better(mine, its)) is not None
    ]
    if len(off) > int(FLIPPED * len(replayed)):
        mine, its, name = off[0]
        raise BundleError(
            Code.SCORE_DIFFERS,
            f"{mine['id']} of group {mine['group']}: {name} is {mine.get(name)}, claimed was"
            f" {its.get(name)}",
        )


def _claimed_better(mine: Row, its: Row) -> str | None:
    return "length" if mine["length"] != its["length"] else claims_more(its, mine, RELATIVE)


def _require_distinct(rows: Sequence[Row], method: Method) -> None:
    if (twice := repeated(rows, method)) is not None:
        raise BundleError(Code.REPEATED_GROUP, f"groups {twice[0]} and {twice[1]} do the same")


def _difference(replayed: Sequence[Row], found: Sequence[Row]) -> dict[str, Any]:
    """Compare a run of the method here with the run that was submitted."""
    pairs = [(a["score"], b["score"]) for a, b in zip(replayed, found, strict=True)]
    both = [(a, b) for a, b in pairs if a is not None and b is not None]
    largest = max((abs(a - b) / max(abs(a), abs(b), 1e-12) for a, b in both), default=0.0)
    return {"rows": len(pairs), "equal": sum(a == b for a, b in pairs), "largest": largest}


def _entry(
    manifest: Plain, rows: Sequence[Row], level: str, bundle: str, computed: Plain
) -> Entry:
    name, unit = SCORES[manifest["track"]]
    spec, about = manifest["spec"], manifest["about"]
    return check_entry(
        with_named_measures(
            {
                "schema": "ves-entry/1",
                "track": manifest["track"],
                "protocol": manifest["protocol"],
                "problem": manifest["problem"],
                "name": manifest["name"],
                "author": manifest["author"],
                "kind": manifest["kind"],
                "level": level,
                "seeds": manifest["seeds"]["which"],
                "bundle": bundle,
                "score": {"name": name, "unit": unit, "better": "lower"},
                "rows": [{k: v for k, v in row.items() if k != "length"} for row in rows],
                "about": {
                    **about,
                    "evaluator": spec["evaluator"],
                    "settings": {**about["settings"], **manifest["method"]["settings"]},
                    **computed,
                },
            }
        )
    )
