"""Logs on disk without their labels, and labels that can be sealed."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ves_gym._util.params import canonical_json, read_table, write_text
from ves_gym.diagnosis.benchmark.blind.cases import FINAL, BlindCase, Runner
from ves_gym.diagnosis.benchmark.blind.magnitude import SCALE
from ves_gym.diagnosis.benchmark.blind.simulate import CHANNELS
from ves_gym.system.runlog import RunLog


def logs_of(
    case: BlindCase, description: dict[str, Any], controller: dict[str, Any]
) -> list[RunLog]:
    """Return the case's runs as logs; nothing in them says what is in the machine.

    Args:
        case: to write.
        description, controller: as the logs state them.
    """
    return [_log(case, k, description, controller) for k in range(len(case.records))]


def _log(
    case: BlindCase, k: int, description: dict[str, Any], controller: dict[str, Any]
) -> RunLog:
    record, t = case.records[k], case.t[k]
    nominal = np.arange(len(t)) * description["control_dt"]
    command = case.motions[k].at(nominal)
    columns = {name: record[:, where] for name, where in CHANNELS.items()}
    meta = {
        "format": "ves-run/1",
        "system": description,
        "controller": controller,
        "initial": {
            "q": columns["q"][0].tolist(),
            "v": [0.0] * 3,
            "y": [0.0] * 6,
            "yd": [0.0] * 6,
        },
        "noise_std": {name: std.tolist() for name, std in SCALE.items() if name != "y_cmd"},
        "duration": float(nominal[-1]),
        "held_back": k >= len(case.records) - FINAL,
    }
    return RunLog(t=t, q_cmd=command.q, v_cmd=command.v, meta=meta, **columns)


def label_of(case: BlindCase) -> dict[str, Any]:
    """Return the truth about a case, plain data."""
    return {
        "index": case.number,
        "category": case.plan.category,
        "variant": case.plan.variant,
        "effects": [
            {**effect.label(), "wanted": target, "reached": reached}
            for effect, target, reached in zip(
                case.effects, case.plan.ratios, case.reached, strict=True
            )
        ],
    }


def case_name(index: int) -> str:
    """Return the folder of a case."""
    return f"case-{index:03d}"


def write_case(
    folder: str | os.PathLike[str],
    case: BlindCase,
    description: dict[str, Any],
    controller: dict[str, Any],
) -> None:
    """Write `case-NNN/run-1.parquet` and on; the label is not among them.

    Args:
        folder: of all cases.
        case: to write.
        description, controller: as the logs state them.
    """
    place = Path(folder) / case_name(case.number)
    for k, log in enumerate(logs_of(case, description, controller)):
        log.save(place / f"run-{k + 1}.parquet")


def write_set(
    folder: str | os.PathLike[str],
    labels: str | os.PathLike[str],
    root: int,
    indices: Iterable[int],
    runner: Runner,
    controller: dict[str, Any],
) -> None:
    """Write cases that are not there yet.

    Args:
        folder: of the logs.
        labels: folder of the labels.
        root: seed of the set.
        indices: of the cases.
        runner: makes them.
        controller: as the logs state it.
    """
    for index in indices:
        label = Path(labels) / f"{case_name(index)}.json"
        if label.exists():
            continue
        case = runner.case(index, root)
        write_case(folder, case, runner.description, controller)
        write_text(label, canonical_json(label_of(case)) + "\n")


def read_labels(labels: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Return all labels of a set, by index."""
    return [read_table(path) for path in sorted(Path(labels).glob("case-*.json"))]


def seal(labels: Sequence[dict[str, Any]], nonce: str | None = None) -> tuple[str, str]:
    """Return SHA-256 over labels and a random nonce, which keeps them from being guessed.

    Args:
        labels: in order.
        nonce: to check a seal; a fresh one by default.

    Returns:
        The digest, to be published first, and the nonce, to be published with the labels.
    """
    nonce = secrets.token_hex(32) if nonce is None else nonce
    text = canonical_json({"labels": list(labels), "nonce": nonce})
    return hashlib.sha256(text.encode()).hexdigest(), nonce
