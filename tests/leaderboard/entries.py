"""Made-up entries, small honest ones made by the real run, and ways to spoil them."""

import itertools
import json

import numpy as np

from ves_gym.baselines.policy import Network, Policy, save_policy
from ves_gym.leaderboard.entry import Entry, Method, Refused
from ves_gym.leaderboard.files import ENTRY, RECORDING, pack, read_files
from ves_gym.leaderboard.tracks.base import task_of
from ves_gym.leaderboard.verify import verify_entry

DAMP = ("damping", "ves/PumaDamp-v0-quick")


def made_entry(name="refined", scores=(0.2, 0.3, 0.4, 0.5), *, success=None, **more):
    """An entry of scores, (episodes,) or (groups, episodes); None is a failure."""
    table = np.atleast_2d(np.array(scores, dtype=float))
    table = np.where(np.isnan(table), np.inf, table)
    won = np.isfinite(table) if success is None else np.atleast_2d(success)
    groups = tuple(range(len(table)))
    results = {"score": table, "success": won.astype(float)}
    results |= dict.fromkeys(("E_mean", "E_peak", "E_res"), 2 * table)
    kind = more.pop("kind", "planner")
    weights = tuple(f"{k:064x}" for k in groups) if kind == "policy" else ()
    made = {
        "track": "paths",
        "problem": "bent-2s",
        "name": name,
        "author": "ves-gym",
        "level": "reproduced",
        "seeds": "public",
        "method": Method(kind=kind, name=name, seeds=groups, weights=weights),
        "results": results,
        "about": {"versions": {"numpy": "2.3.0"}},
    }
    return Entry(**{**made, **more})


def noisy(level, n=100, seed=0, failed=0):
    """n scores around a level, the same every time; the first `failed` are failures."""
    values = level * np.exp(0.3 * np.random.default_rng(seed).normal(size=n))
    return [np.nan if k < failed else float(v) for k, v in enumerate(values)]


def save_random_policy(path, seed=0, noise=0.0):
    """A small policy for `DAMP`; `noise` is added to the weights of that seed."""
    task = task_of("ves/PumaDamp-v0", {})
    sizes = (sum(f.size for f in task.fields()), 8, task.action_width)
    rng, shake = np.random.default_rng(seed), np.random.default_rng(99)
    layers = []
    for a, b in itertools.pairwise(sizes):
        weights = rng.normal(size=(a, b)) / np.sqrt(a)
        layers.append((weights * (1 + noise * shake.normal(size=(a, b))), np.zeros(b)))
    layers[-1] = layers[-1][0] / 10, layers[-1][1]  # it does little
    about = {"algorithm": "none", "seed": seed}
    return save_policy(Policy(Network(sizes=sizes), tuple(layers), about), path)


class Spoiled:
    """The files of an entry, to be changed and written again."""

    def __init__(self, folder):
        self.files = read_files(folder)
        self.plain = json.loads(self.files[ENTRY])

    def write(self, folder):
        folder.mkdir()
        for name, data in {**self.files, ENTRY: json.dumps(self.plain).encode()}.items():
            (folder / name).write_bytes(data)
        return folder

    def record(self, recording):
        self.files[RECORDING] = pack(recording)


def code_of(place, **options):
    """The code that an entry is refused with, None if it is not."""
    try:
        verify_entry(place, **options)
    except Refused as error:
        assert str(error).startswith(error.code.slug + ": ") and "\n" not in str(error)
        return error.code
    return None


class Gentle:
    """A controller of one's own, which does next to nothing."""

    name, privileged = "gentle", True

    def reset(self, env, ids):
        pass

    def act(self, env, observation):
        return np.full((env.num_envs, env.batch.width), 0.01)
