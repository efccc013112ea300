"""A seal over labels and code, to be published before a set is answered.

It covers what is drawn for every case of the set, the labels that are written, this generator,
and everything that decides a diagnosis: the package `ves_gym` as files, byte by byte. What is
drawn and the generator determine the labels of the other cases; sizes in labels are of three
digits, which processors share.
"""

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.trial2.cases import SIZE, draw

ROOT = Path(__file__).parents[2]
SEALED = ("benchmarks/trial2", "ves_gym")


def canonical(label: Any) -> Any:
    """A label with its numbers to three digits, as processors agree on them."""
    if isinstance(label, float):
        return float(f"{label:.3g}")
    if isinstance(label, dict):
        return {key: canonical(value) for key, value in label.items()}
    if isinstance(label, list | tuple):
        return [canonical(value) for value in label]
    return label


def code_digests() -> dict[str, str]:
    """SHA-256 of every file of generator and package, and of the diagnosis room alone."""
    out = {}
    for name in (*SEALED, "ves_gym/diagnosis"):
        digest = hashlib.sha256()
        for path in sorted((ROOT / name).rglob("*")):
            if path.suffix in (".py", ".toml") and path.is_file():
                digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0")
                digest.update(path.read_bytes() + b"\0")
        out[name] = digest.hexdigest()
    return out


def drawn(salt: str) -> str:
    """Return the SHA-256 of what is drawn for every case, before sizes are searched."""
    cases = [canonical(asdict(draw(salt, index))) for index in range(SIZE)]
    return hashlib.sha256(f"{salt}\n{json.dumps(cases, sort_keys=True)}".encode()).hexdigest()


def seal(labels: list[dict[str, Any]], salt: str) -> dict[str, Any]:
    """Return what is published first: digests of labels with their salt, and of the code."""
    text = json.dumps([canonical(label) for label in labels], sort_keys=True)
    return {
        "schema": "ves-trial2-seal/1",
        "cases": [label["index"] for label in labels],
        "drawn": drawn(salt),
        "labels": hashlib.sha256(f"{salt}\n{text}".encode()).hexdigest(),
        "code": code_digests(),
    }


def check(published: dict[str, Any], labels: list[dict[str, Any]], salt: str) -> list[str]:
    """Return what differs between a published seal and labels, salt and code now."""
    now = seal(labels, salt)
    out = [name for name in ("cases", "drawn", "labels") if now[name] != published[name]]
    return out + [
        f"code of {name}"
        for name in now["code"]
        if now["code"][name] != published["code"].get(name)
    ]
