"""Units of work: one (environment or query, policy or planner, seed) with a name of its own.

A unit is plain data; its id is the SHA-256 of that data, which holds the package's version and
the hash of the system that is simulated. Whoever runs it, wherever, gets the same result file
to the last bit: clocks and hosts go to a file beside it.

    folder/results/ID.json    the result; it is written last
    folder/about/ID.json      where and when it was made, how long it took
    folder/policies/ID/       the policy that a training run ends with
    folder/work/ID/           the checkpoint of a training run under way
"""

from __future__ import annotations

import hashlib
import math
import os
import platform
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from ves_gym._util.params import (
    ParameterError,
    canonical_json,
    content_hash,
    from_plain,
    read_table,
)
from ves_gym._util.statistics import STATISTICS
from ves_gym._util.threads import on_one_thread
from ves_gym._util.version import __version__
from ves_gym.baselines.config import TrainConfig
from ves_gym.baselines.evaluate import ENERGIES, evaluate, spec_of
from ves_gym.baselines.policy import load_policy, versions
from ves_gym.baselines.registry import CONTROLLERS, get_controller
from ves_gym.envs.build import build_task
from ves_gym.planners.benchmark import run_query
from ves_gym.planners.query import Query

SCHEMA, RESULT, ABOUT = "ves-unit/1", "ves-result/1", "ves-about/1"
_SUMMARY = {  # of an evaluation: measure -> statistic
    "return": "iqm",
    **dict.fromkeys(("success", "success_once", "failed"), "mean"),
    **dict.fromkeys(ENERGIES, "median"),
}
_CLOCKED = ("seconds", "seconds_stepping", "plan_seconds")  # no part of a result


@dataclass(frozen=True)
class Unit:
    """Piece of work as plain data, and where its parts are on this machine."""

    identity: Mapping[str, Any]  # schema, version, kind, where, who, seed, system, settings
    source: Mapping[str, Any] = field(default_factory=dict)  # no part of the id

    @cached_property
    def id(self) -> str:
        """64 hexadecimal digits."""
        return content_hash(self.identity)

    @property
    def label(self) -> str:
        """For people: kind, where, who and seed."""
        return " ".join(str(self.identity[k]) for k in ("kind", "where", "who", "seed"))


# ---------------------------------------------------------------------- the three kinds


def evaluate_unit(
    env: str, who: str, seed: int, episodes: int, settings: Mapping[str, Any]
) -> Unit:
    """Episodes in an environment of `who`, a controller's name or a policy's .json file."""
    identity = _identity("evaluate", env, _name(who), seed, _task(env, settings))
    identity |= {"episodes": episodes, "settings": dict(settings), "weights": _weights(who)}
    return Unit(identity, {"who": who})


def train_unit(config: TrainConfig, seed: int) -> Unit:
    """A training run with one seed."""
    config = replace(config, seeds=(seed,))
    system = _task(config.env, config.settings)
    identity = _identity("train", config.env, config.label, seed, system)
    return Unit(identity | {"config": config.to_dict()})


def plan_unit(suite: str, vehicle: str, query: Query, planner: str, seed: int) -> Unit:
    """A planner's answer to a query, simulated."""
    identity = _identity("plan", query.name, planner, seed, query.system.hash)
    identity |= {"suite": suite, "vehicle": vehicle, "query": content_hash(query)}
    return Unit(identity, {"query": query})


def _identity(kind: str, where: str, who: str, seed: int, system: str) -> dict[str, Any]:
    parts = {"kind": kind, "where": where, "who": who, "seed": seed, "system": system}
    return {"schema": SCHEMA, "version": __version__, **parts}


def _task(env: str, settings: Mapping[str, Any]) -> str:
    """Hash of an environment's task, the system in it; nothing is simulated."""
    defaults = spec_of(env).kwargs
    if "task" not in defaults:
        raise ParameterError(f"{env} is no environment of ves_gym")
    return content_hash(build_task(**{**defaults, **settings}))


def _name(who: str) -> str:
    return who if who in CONTROLLERS else Path(who).stem


def _weights(who: str) -> str | None:
    """SHA-256 of a policy's two files, without what says where it comes from."""
    if who in CONTROLLERS:
        return None
    table = read_table(who)
    return content_hash([table.get("network"), table.get("weights")])


# -------------------------------------------------------------------------- running


def run_unit(unit: Unit, folder: str | None = None) -> dict[str, bytes]:
    """Do a unit's work, wherever; its files by name, to be stored in this order.

    Where the sweep's `folder` is on this machine, a training run leaves its checkpoints there
    and goes on from them.
    """
    root = None if folder is None else Path(folder)
    begun, begin, worked = datetime.now(UTC), time.perf_counter(), time.process_time()
    # sums depend on the number of threads, and a result on nothing but its unit
    with tempfile.TemporaryDirectory() as scratch, on_one_thread():
        work = root / "work" / unit.id if root and root.is_dir() else Path(scratch)
        answer = _RUN[unit.identity["kind"]](unit, work)
    body = {
        "schema": RESULT,
        "id": unit.id,
        "unit": dict(unit.identity),
        "rows": answer.rows,
        "summary": answer.summary,
        "files": {  # those that are alike on every machine: of numbers only
            name: hashlib.sha256(data).hexdigest()
            for name, data in answer.files.items()
            if name.endswith(".safetensors")
        },
    }
    about = {
        "schema": ABOUT,
        "id": unit.id,
        "host": platform.node(),
        "process": os.getpid(),
        "begun": begun.isoformat(timespec="milliseconds"),
        "ended": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "seconds": round(time.perf_counter() - begin, 3),
        "processor_seconds": round(time.process_time() - worked, 3),
        "versions": versions("mujoco"),
        "clocked": answer.clocked,
    }
    result = {**body, "digest": content_hash(body)}
    texts = {"about": about, "results": result}
    files = {f"policies/{unit.id}/{name}": data for name, data in answer.files.items()}
    for place, plain in texts.items():
        files[f"{place}/{unit.id}.json"] = f"{canonical_json(plain)}\n".encode()
    return files


def read_result(path: str | os.PathLike[str]) -> dict[str, Any]:
    """A result file.

    Raises:
        ParameterError: it is no result, or not what was written: its digest says otherwise.
    """
    path = Path(path)
    table = read_table(path)
    digest = table.pop("digest", None)
    if table.get("schema") != RESULT or "id" not in table or "rows" not in table:
        raise ParameterError(f"{path}: expected {RESULT}, got {table.get('schema')!r}")
    if content_hash(table) != digest or table["id"] != path.stem:
        raise ParameterError(f"{path}: is damaged: its content does not match its digest")
    if content_hash(table["unit"]) != table["id"]:
        raise ParameterError(f"{path}: is damaged: its unit is not the one of its id")
    return table


@dataclass(frozen=True)
class _Answer:
    rows: list[dict[str, Any]]
    summary: Mapping[str, float | None]
    clocked: Any = None
    files: dict[str, bytes] = field(default_factory=dict)


def _evaluate(unit: Unit, work: Path) -> _Answer:
    identity, who = unit.identity, unit.source["who"]
    if _weights(who) != identity["weights"]:
        raise ParameterError(f"{who}: is not the policy any more that the sweep began with")
    controller = (
        get_controller(who, identity["seed"]) if who in CONTROLLERS else load_policy(who)
    )
    evaluation = evaluate(
        controller,
        identity["where"],
        episodes=identity["episodes"],
        seed=identity["seed"],
        threads=1,
        **identity["settings"],
    )
    summary = {
        name: float(STATISTICS[kind](evaluation.values(name)[0]))
        for name, kind in _SUMMARY.items()
    }
    finite = {k: v if math.isfinite(v) else None for k, v in summary.items()}
    return _Answer(evaluation.to_dict()["rows"], finite)


def _train(unit: Unit, work: Path) -> _Answer:
    from ves_gym.baselines.train import train

    config = from_plain(TrainConfig, unit.identity["config"])
    rows = train(config, unit.identity["seed"], work, resume=True)
    clocked = [{k: row[k] for k in _CLOCKED if k in row} for row in rows]
    timeless = [{k: v for k, v in row.items() if k not in _CLOCKED} for row in rows]
    best = max(timeless, key=lambda row: row["return"])
    summary = {k: v for k, v in best.items() if isinstance(v, float | int)}
    files = {name: (work / name).read_bytes() for name in ("best.json", "best.safetensors")}
    return _Answer(timeless, summary, clocked, files)


def _plan(unit: Unit, work: Path) -> _Answer:
    identity = unit.identity
    row = run_query(
        identity["who"], identity["vehicle"], unit.source["query"], identity["seed"]
    )
    clocked = {k: row.pop(k) for k in _CLOCKED if k in row}
    summary = {k: row[k] for k in (*ENERGIES, "predicted")}
    return _Answer([row], summary | {"success": float(row["success"])}, clocked)


_RUN: dict[str, Callable[[Unit, Path], _Answer]] = {
    "evaluate": _evaluate,
    "train": _train,
    "plan": _plan,
}
