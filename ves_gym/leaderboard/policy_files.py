"""Policies in a bundle: a closed list of architectures, weights as safetensors."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ves_gym._util.params import read_table
from ves_gym.baselines.policy import Policy, load_policy
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.tracks.base import Method

ARCHITECTURES = ("mlp",)  # of `baselines/policy.py`: dense layers, tanh or ReLU


def policy_names(group: int) -> tuple[str, str]:
    """Members that hold the policy of a group."""
    stem = "policy" if group == 0 else f"policy-{group}"
    return f"{stem}.json", f"{stem}.safetensors"


def policies_of(method: Method, members: Mapping[str, bytes]) -> list[Policy]:
    """The policies in a bundle's files.

    Raises:
        BundleError: UNKNOWN_ARCHITECTURE, HASH_MISMATCH, BAD_WEIGHTS.
    """
    if method.architecture not in ARCHITECTURES:
        raise BundleError(
            Code.UNKNOWN_ARCHITECTURE,
            f"must be one of {', '.join(ARCHITECTURES)}, got {str(method.architecture)[:80]!r}",
        )
    out = []
    with tempfile.TemporaryDirectory() as folder:
        for group, digest in enumerate(method.weights):
            named, weights = policy_names(group)
            if hashlib.sha256(members[weights]).hexdigest() != digest:
                raise BundleError(
                    Code.HASH_MISMATCH, f"{weights}: not the weights of the method"
                )
            for name in (named, weights):
                (Path(folder) / name).write_bytes(members[name])
            out.append(_policy(Path(folder) / named))
    return out


def _policy(path: Path) -> Policy:
    try:
        table = read_table(path)
        network = table.get("network")
        kinds = {"activation": ("tanh", "relu"), "output": ("clip", "tanh")}
        for key, choices in kinds.items():
            if isinstance(network, dict) and network.get(key, choices[0]) not in choices:
                raise BundleError(
                    Code.UNKNOWN_ARCHITECTURE,
                    f"{key} must be one of {', '.join(choices)}, got"
                    f" {str(network[key])[:80]!r}",
                )
        if table.get("schema") != "ves-policy/1":
            raise BundleError(
                Code.UNKNOWN_ARCHITECTURE, f"schema {str(table.get('schema'))[:80]!r}"
            )
        return load_policy(path)
    except BundleError:
        raise
    except Exception as error:  # the parsers' own, whatever a file made them raise
        why = f"{path.name}: {type(error).__name__}: {str(error).replace(str(path.parent), '')}"
        raise BundleError(Code.BAD_WEIGHTS, why[:300]) from None
