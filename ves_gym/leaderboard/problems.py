"""The problems of the leaderboard, by track: queries, their number, and who may answer.

Seeds of the questions are public and fixed, or official, from a maintainer's salt.
"""

from __future__ import annotations

import hashlib
import hmac
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym

from ves_gym._util.params import ParameterError, require_one_of
from ves_gym._util.suggest import did_you_mean
from ves_gym.planners.suites import REACH_SEED

# track: name and unit of the score of an episode; lower is better
SCORES = {
    "paths": ("E_mean over the straight line's", "1"),
    "tasks": ("E_mean of solved episodes", "J"),
    "damping": ("strain integral over that of the high gains", "1"),
}
QUICK = "-quick"  # after a problem's name: a part of it, for a first try, not for the board


class Paths(NamedTuple):
    """Questions of a problem of track *paths*: reach100's on a vehicle."""

    vehicle: str
    duration: float  # s
    arm: str = "puma560"
    obstacles: bool = False
    calm: bool = False  # an answer shakes the mount no more than the straight line


THESIS = "thesis"  # its motions, on the bent beam by finite elements
PATHS = {
    **{f"{v}-{d}s": Paths(v, d) for v in ("bent", "straight-horizontal") for d in (1, 2, 4)},
    "bent-2s-calm": Paths("bent", 2, calm=True),
    "bent-2s-obstacles": Paths("bent", 2, obstacles=True),
    "bent-4s-obstacles": Paths("bent", 4, obstacles=True),
    "bent-iiwa14-2s": Paths("bent", 2, arm="iiwa14"),
    "servicer-flexible-2s": Paths("servicer-flexible", 2),
}
# Machines whose payload, stiffness and friction nobody is told. Success is to arrive.
_DRAWN = {
    "payload/mass": {"mass": [0.0, 10.0]},  # kg
    "base/stiffness": {"error": [-0.3, 0.3]},
    "joint/coulomb": {"torque": [[0.0] * 3, [5.0] * 3]},  # N m
}
_PLATFORM = {"platform/bandwidth": {"error": [-0.1, 0.1]}}
UNKNOWN: dict[str, tuple[str, dict[str, Any]]] = {
    "unknown-space": ("ves/PumaRestToRest-v0", {"saving": None, "randomize": _DRAWN}),
    "unknown-laboratory": (
        "ves/PumaRestToRestEmulated-v0",
        {"saving": None, "randomize": {**_DRAWN, **_PLATFORM}},
    ),
}
GAINS = "gains-bent"  # joint gains for releases of the beam
GAINS_VEHICLE = "bent"
DAMPING_TASKS = ("ves/PumaDamp-", "ves/PumaDampEmulated-")
_COUNTS = {GAINS: (50, 5), THESIS: (2, 2)}  # whole and quick, of releases and motions
_COUNT = 100, 10  # of queries and episodes
PUBLIC = "public"
_OFFICIAL = "official-"
_EPISODES = 19_940_000  # first public seed; training runs use small numbers
_RELEASE_SEED = 432  # thesis 4.3.2
_LEAST_SALT = 16  # characters
_MARK = 16  # hexadecimal digits


@dataclass(frozen=True)
class Problem:
    """A problem of a track."""

    track: str
    name: str

    @property
    def quick(self) -> bool:
        """True of the short form."""
        return self.name.endswith(QUICK)

    @property
    def base(self) -> str:
        """Its name without that."""
        return self.name.removesuffix(QUICK)

    @property
    def count(self) -> int:
        """Episodes, queries or releases."""
        return _COUNTS.get(self.base, _COUNT)[self.quick]

    @property
    def environment(self) -> str | None:
        """Id of its environment, None where there is none."""
        id = UNKNOWN.get(self.base, (self.base,))[0]
        return id if id.startswith("ves/") else None

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of its environment that are the problem's, not the method's."""
        return UNKNOWN.get(self.base, ("", {}))[1]

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of methods that can answer."""
        if self.environment is not None:
            return ("policy", "controller")
        return ("planner",) if self.track == "paths" else ("gains",)


def problems(track: str) -> tuple[str, ...]:
    """Names of a track's problems, the quick ones included."""
    ids = sorted(k for k in gym.registry if k.startswith("ves/"))
    damping = [k for k in ids if k.startswith(DAMPING_TASKS)]
    named = {
        "paths": [*PATHS, THESIS],
        "tasks": [*(k for k in ids if k not in damping), *UNKNOWN],
        "damping": [GAINS, *damping],
    }
    require_one_of("track", track, SCORES)
    return tuple(name + part for name in named[track] for part in ("", QUICK))


def get_problem(track: str, name: str) -> Problem:
    """A problem by track and name."""
    names = problems(track)
    if name not in names:
        listed = ", ".join(k for k in names if not k.endswith(QUICK))
        raise ParameterError(
            f"problem of track {track} must be one of {listed}, or with {QUICK} after it, got"
            f" {name!r:.80}{did_you_mean(name, names)}"
        )
    return Problem(track, name)


# ---------------------------------------------------------------------------- seeds


class Seeds(NamedTuple):
    """Origin of a problem's questions."""

    name: str  # public, or official- and the mark of the salt, which it does not tell
    root: int


def read_salt(path: str | os.PathLike[str]) -> str:
    """The maintainer's secret from a file."""
    try:
        salt = Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ParameterError(f"{path}: cannot be read: {why}") from None
    if len(salt) < _LEAST_SALT:
        raise ParameterError(
            f"{path}: a salt has at least {_LEAST_SALT} characters, got {len(salt)}"
        )
    return salt


def seeds_of(problem: Problem, salt: str | None) -> Seeds:
    """The public seeds, or with a salt the official ones."""
    if salt is None:
        episodes = _EPISODES if problem.environment is not None else _RELEASE_SEED
        return Seeds(PUBLIC, REACH_SEED if problem.track == "paths" else episodes)
    # below 2**56, so that what counts up from it stays a seed
    root = int.from_bytes(_keyed(salt, f"{problem.track}/{problem.base}")[:7], "big")
    return Seeds(_OFFICIAL + _keyed(salt, "mark").hex()[:_MARK], root)


def _keyed(salt: str, what: str) -> bytes:
    message = f"ves-leaderboard/{what}"
    return hmac.new(salt.encode(), message.encode(), hashlib.sha256).digest()
