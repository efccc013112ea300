"""Small honest bundles, made by the real run, and ways to spoil them."""

import json
import zipfile
from pathlib import Path

from ves_gym.baselines.policy import released
from ves_gym.leaderboard.archive import MANIFEST, read_members
from ves_gym.leaderboard.bundle import digest, sealed
from ves_gym.leaderboard.run import make_bundle

POLICY = ("policies", "ves/PumaRestToRest-v0-quick")
PATHS = ("paths", "reach100-1s-quick")


def policy_bundle(folder: Path, name="policy.zip", **options) -> Path:
    """Ten episodes of a released policy."""
    files = [released("ves/PumaRestToRest-v0")["ppo"]]
    return make_bundle(folder / name, *POLICY, files, author="someone", **options)


def path_bundle(folder: Path, name="paths.zip", method="straight", **options) -> Path:
    """Ten motions of a planner."""
    return make_bundle(folder / name, *PATHS, method, **options)


class Bundle:
    """The files of a bundle, to be changed and written again."""

    def __init__(self, path: Path) -> None:
        self.members = read_members(path)
        self.manifest = json.loads(self.members[MANIFEST])

    def write(self, path: Path, *, seal: bool = True) -> Path:
        """Write it; with `seal` as a forger would, every digest brought up to date."""
        members = dict(self.members)
        if seal:
            self.manifest["members"] = {
                name: {"bytes": len(data), "sha256": digest(data)}
                for name, data in members.items()
                if name != MANIFEST
            }
        return self.write_manifest(path, seal=seal)

    def write_manifest(self, path: Path, *, seal: bool = True) -> Path:
        """Write it with the manifest as it is now, its seal renewed or left."""
        if seal:
            data = sealed(self.manifest)
        else:
            text = json.dumps(self.manifest, sort_keys=True, separators=(",", ":"))
            data = (text + "\n").encode()
        with zipfile.ZipFile(path, "w") as archive:
            for name, member in {**self.members, MANIFEST: data}.items():
                archive.writestr(name, member)
        return path


def leaves(value, path=()):
    """Places of everything in plain data that is no table or list; empty ones too."""
    if isinstance(value, dict) and value:
        for key in value:
            yield from leaves(value[key], (*path, key))
    elif isinstance(value, list) and value:
        for k in range(len(value)):
            yield from leaves(value[k], (*path, k))
    else:
        yield path


def changed(value):
    """Something else of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value * (1 + 1e-12) if value else 1e-9
    if isinstance(value, str):
        if len(value) == 64:  # a digest
            return ("1" if value[0] == "0" else "0") + value[1:]
        return value + "x"
    if value is None:
        return 1
    return {"x": 1} if isinstance(value, dict) else [1]


def get(plain, path):
    """The value at a place."""
    for key in path:
        plain = plain[key]
    return plain


def put(plain, path, value):
    """Change the value at a place."""
    get(plain, path[:-1])[path[-1]] = value
