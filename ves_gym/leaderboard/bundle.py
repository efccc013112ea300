"""Bundles: a canonical manifest and the files it names, all by digest.

    manifest.json                         what is claimed, and the digest of everything else
    actions.npy | motions.npy | gains.npy | answers.json    what the replay takes
    policy.json, policy.safetensors       each policy, of a closed list of architectures

`seal` is the SHA-256 of the manifest without it: a change of any field shows, unless it was
sealed again, and then the recomputed fields give it away.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from ves_gym._util.params import ParameterError, canonical_json
from ves_gym.leaderboard.archive import MANIFEST
from ves_gym.leaderboard.entry import (
    ABOUT,
    DIGEST,
    KINDS,
    SEEDS,
    check_about,
    checked_row,
    integer,
    plain_data,
    table_of,
    text,
)
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.names import require_name
from ves_gym.leaderboard.protocol import MOST_GROUPS

SCHEMA = "ves-bundle/1"
KEYS = ("schema", "track", "protocol", "problem", "name", "author", "kind", "seeds", "spec",
        "method", "members", "rows", "about", "seal")  # fmt: skip
_SPEC = ("environment", "system", "model", "evaluator")
_METHOD = ("name", "seeds", "architecture", "weights", "settings")
_ABOUT = tuple(k for k in ABOUT if k not in ("model", "evaluator"))  # those are in the spec
_LONGEST = 10_000_000  # of a row's part of the payload
_MOST = 200_000  # rows


def digest(data: bytes) -> str:
    """SHA-256, 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def sealed(manifest: Mapping[str, Any]) -> bytes:
    """The manifest's file, with its seal."""
    plain = {k: v for k, v in manifest.items() if k != "seal"}
    plain["seal"] = digest(canonical_json(plain).encode())
    return (canonical_json(plain) + "\n").encode()


def read_manifest(data: bytes) -> dict[str, Any]:
    """The manifest, checked by itself.

    Raises:
        BundleError: MALFORMED_MANIFEST, HASH_MISMATCH.
    """
    try:
        plain = json.loads(
            data.decode("utf-8"), object_pairs_hook=_once, parse_constant=_no_number
        )
        if not isinstance(plain, dict):
            raise ParameterError("expected a table")
        canonical = (canonical_json(plain) + "\n").encode()
    except (ValueError, RecursionError, OverflowError) as error:
        raise malformed(str(error)) from None
    if plain.get("schema") != SCHEMA:
        raise malformed(f"schema must be {SCHEMA!r}, got {str(plain.get('schema'))[:80]!r}")
    if canonical != data:
        raise malformed("not canonical: sorted keys, no spaces, shortest floats")
    if sealed(plain) != data:
        raise BundleError(Code.HASH_MISMATCH, f"{MANIFEST}: the seal is of other contents")
    try:
        _check(plain)
    except (ParameterError, RecursionError) as error:
        raise malformed(str(error)) from None
    return plain


def malformed(why: str) -> BundleError:
    """A manifest that is none."""
    return BundleError(Code.MALFORMED_MANIFEST, f"{MANIFEST}: {why[:300]}")


def _check(plain: dict[str, Any]) -> None:
    """Every key there and of its kind; whether it is true is for `verify`."""
    table_of(plain, KEYS, "manifest")
    for name in ("track", "problem", "name", "author"):
        require_name(text(plain[name], name, empty=name == "author"), name)
    integer(plain["protocol"], "protocol", least=1)
    if plain["kind"] not in KINDS:
        raise ParameterError(f"kind must be one of {', '.join(KINDS)}")
    seeds = table_of(plain["seeds"], ("which", "mark", "list"), "seeds")
    if seeds["which"] not in SEEDS:
        raise ParameterError(f"seeds.which must be one of {', '.join(SEEDS)}")
    if seeds["mark"] is not None:
        _digest(seeds["mark"], "seeds.mark")
    for k in _list(seeds["list"], "seeds.list", 100_000):
        # roots of the blind benchmark are whole numbers of 128 bits
        if isinstance(k, bool) or not isinstance(k, int) or not 0 <= k < 2**128:
            raise ParameterError("seeds.list must be whole numbers >= 0")
    spec = table_of(plain["spec"], _SPEC, "spec")
    for name in _SPEC[1:]:
        _digest(spec[name], f"spec.{name}")
    if spec["environment"] is not None:
        env = table_of(spec["environment"], ("id", "version", "spec"), "spec.environment")
        text(env["id"], "spec.environment.id")
        integer(env["version"], "spec.environment.version")
        _digest(env["spec"], "spec.environment.spec")
    _check_method(plain)
    if not isinstance(plain["members"], dict):
        raise ParameterError("members must be a table")
    for name, about in plain["members"].items():
        text(name, "members")
        about = table_of(about, ("bytes", "sha256"), f"members.{name}")
        integer(about["bytes"], f"members.{name}.bytes")
        _digest(about["sha256"], f"members.{name}.sha256")
    for k, row in enumerate(_list(plain["rows"], "rows", _MOST)):
        checked = checked_row(row, f"rows[{k}]", ("length",))
        if integer(checked["length"], f"rows[{k}].length") > _LONGEST:
            raise ParameterError(f"rows[{k}].length must be at most {_LONGEST}")
    check_about(plain["about"], _ABOUT, "about")


def _check_method(plain: dict[str, Any]) -> None:
    method = table_of(plain["method"], _METHOD, "method")
    text(method["name"], "method.name", empty=True)
    for k in _list(method["seeds"], "method.seeds", MOST_GROUPS, least=1):
        integer(k, "method.seeds")
    if method["architecture"] is not None:
        text(method["architecture"], "method.architecture")
    for k in _list(method["weights"], "method.weights", MOST_GROUPS):
        _digest(k, "method.weights")
    if not isinstance(method["settings"], dict):
        raise ParameterError("method.settings must be a table")
    plain_data(method["settings"], "method.settings")
    policy = plain["kind"] == "policy"
    if policy != (method["architecture"] is not None) or (
        len(method["weights"]) != (len(method["seeds"]) if policy else 0)
    ):
        raise ParameterError("a policy has an architecture and weights per seed, others none")
    if policy and method["name"]:
        raise ParameterError("method.name is of what is built in: none for a policy")


def _list(value: Any, where: str, most: int, least: int = 0) -> list[Any]:
    if not isinstance(value, list) or not least <= len(value) <= most:
        raise ParameterError(f"{where} must be a list of {least} to {most}")
    return value


def _digest(value: Any, where: str) -> None:
    if not (isinstance(value, str) and DIGEST.fullmatch(value)):
        raise ParameterError(f"{where} must be a SHA-256")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ValueError("a key is given more than once")
    return table


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")
