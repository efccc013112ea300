"""Small sweeps and their files."""

from pathlib import Path

from ves_gym._util.params import from_plain
from ves_gym.experiments.spec import Spec

SMALL = {  # two environments, a policy, a planner: units of a fraction of a second
    "evaluate": [
        {"envs": ["BeamLQR-v0"], "policies": ["zero", "released"], "episodes": 2},
        {
            "envs": ["PumaDamp-v0"],
            "policies": ["random"],
            "seeds": [3],
            "episodes": 2,
            "settings": {"duration": 1.0},
        },
    ],
    "plan": [{"suite": "reach100", "planners": ["direct"], "durations": [0.5], "queries": 1}],
}


def spec(plain=None, **changes):
    return from_plain(Spec, {**(plain or SMALL), **changes})


def many(count):
    """Units of some 10 ms each, once a worker is warm."""
    table = {"envs": ["BeamLQR-v0"], "policies": ["random"], "episodes": 1}
    return spec({"evaluate": [{**table, "seeds": list(range(count))}]})


def files(folder, part="results"):
    """Names and contents of the files of a sweep."""
    return {p.name: p.read_bytes() for p in (Path(folder) / part).glob("*")}
