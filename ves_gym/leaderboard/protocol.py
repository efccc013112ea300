"""The rules of the leaderboard: tracks, problems, seeds, scores, tolerances.

Seeds are public and fixed, or official: derived by HMAC-SHA256 from a salt that only the
maintainer holds, for each version of the rules and each problem.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ves_gym._util.params import ParameterError
from ves_gym._util.suggest import did_you_mean
from ves_gym.planners.suites import REACH_SEED

# Version 2 of paths: limits, goal and contact are those of the simulated arm at every physics
# step too, not of the commanded motion at 201 instants alone.
PROTOCOL = {"paths": 2, "policies": 1, "tasks": 1, "damping": 1, "discrepancy": 1}
# Versions of problems whose behaviour was changed on purpose, by track and name; 1 of the rest.
# A new version starts with an empty table; entries of the one before are history.
VERSIONS: dict[tuple[str, str], int] = {}
QUICK = "-quick"  # after a problem's name: a part of it, for a first try
DURATIONS = {"1s": 1.0, "2s": 2.0, "4s": 4.0}
MODES = ("", "-obstacles")
# Environments that the board asks about; those registered later have none of its problems.
ENVIRONMENTS = (
    "PumaRestToRest",
    "PumaReach",
    "PumaReachGoal",
    "PumaTrack",
    "PumaDamp",
    "FreeFlyerReach",
    "BeamLQR",
)
# Environments that track tasks asks about: of every task the latest version, in space and in
# the laboratory (`envs.registration`).
TASKS = (
    "PumaRestToRest-v1",
    "PumaReach-v1",
    "PumaReachGoal-v1",
    "PumaTrack-v1",
    "PumaDamp-v1",
    "BeamLQR-v1",
    "FreeFlyerReach-v0",
    "MacroMicro-v0",
    "PoseReach-v0",
    "PayloadTransfer-v0",
    "ServicerCapture-v0",
    "PumaRestToRestEmulated-v1",
    "PumaReachEmulated-v1",
    "PumaReachGoalEmulated-v1",
    "PumaTrackEmulated-v1",
    "PumaDampEmulated-v1",
    "BeamLQREmulated-v1",
    "FreeFlyerReachEmulated-v1",
    "MacroMicroEmulated-v1",
    "PoseReachEmulated-v1",
    "PayloadTransferEmulated-v1",
)
PPED_VEHICLE = "bent-thesis"
PPED_SECONDS = 20.0  # of every release
MOST_GROUPS = 16  # policies or planner seeds in one bundle
_EPISODES, _EPISODES_QUICK = 100, 10
_RELEASES, _RELEASES_QUICK = 50, 5
_CASES, _CASES_QUICK = 600, 30
_PUBLIC_EPISODES = 19_940_000  # first seed; training runs use small numbers
_PUBLIC_RELEASES = 432  # thesis 4.3.2
_LEAST_SALT = 16  # characters

# Elsewhere than on the same engine and instruction sets (`fingerprint.same_machine`), where
# every bit must agree:
RELATIVE = 1e-6  # of an energy or a score; without FMA and AVX2 they moved by up to 7e-14
ABSOLUTE = 1e-9
ACTION = 1e-3  # of actions of a policy run again, full scale 1
FLIPPED = 0.01  # share of rows that may differ: a threshold that rounding crosses
PLANNED = 0.01  # relative, of E_mean of a motion planned again
PLANNED_SHARE = 0.95  # share of the queries that must agree so

LEDGER_PATHS = 1e-2  # residual over the work through the base port; measured 2e-4 at most
# residual over the energy that the drives turned over; measured 1e-5 of smooth motions, 2e-2
# of a reference thrown to and fro with the motors at their limits
LEDGER_EPISODES = 0.1

SCORES = {
    "paths": ("E_mean over the straight line's", "1"),
    "policies": ("return, negative", "1"),
    "tasks": ("E_mean of solved episodes", "J"),
    "damping": ("strain integral over that of the high gains", "1"),
    "discrepancy": ("share of cases not answered as wanted", "1"),
}
KINDS = {
    "paths": ("planner",),
    "policies": ("policy", "controller"),
    "tasks": ("policy", "controller"),
    "damping": ("policy", "controller", "gains"),
    "discrepancy": ("selector",),
}


class Seeds(NamedTuple):
    """Origin of a problem's questions."""

    which: str  # public or official
    root: int
    mark: str | None  # of the salt, which it does not tell


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
        """Episodes, queries, releases or cases."""
        if self.track == "discrepancy":
            return _CASES_QUICK if self.quick else _CASES
        if self.base.startswith("pped-"):
            return _RELEASES_QUICK if self.quick else _RELEASES
        return _EPISODES_QUICK if self.quick else _EPISODES

    @property
    def environment(self) -> str | None:
        """Id of its environment, None where there is none."""
        return self.base if self.base.startswith("ves/") else None

    def kinds(self) -> tuple[str, ...]:
        """Kinds of methods that can answer."""
        if self.track == "damping":
            return ("gains",) if self.environment is None else ("policy", "controller")
        return KINDS[self.track]


def problems(track: str) -> tuple[str, ...]:
    """Names of a track's problems, the quick ones included."""
    ids = [f"ves/{name}{suffix}-v0" for name in ENVIRONMENTS for suffix in ("", "Emulated")]
    named = {
        "paths": [f"reach100-{d}{mode}" for d in DURATIONS for mode in MODES],
        "policies": ids,
        "tasks": [f"ves/{name}" for name in TASKS],
        "damping": ["pped-bent", *(k for k in ids if k.startswith("ves/PumaDamp"))],
        "discrepancy": ["blind-development", "blind-sealed"],
    }
    if track not in named:
        raise ParameterError(
            f"track must be one of {', '.join(PROTOCOL)}, got {track!r:.80}"
            f"{did_you_mean(track, PROTOCOL)}"
        )
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


def read_salt(path: str | os.PathLike[str]) -> str:
    """The maintainer's secret from a file."""
    try:
        salt = Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    if len(salt) < _LEAST_SALT:
        raise ParameterError(
            f"{path}: a salt has at least {_LEAST_SALT} characters, got {len(salt)}"
        )
    return salt


def seeds_of(problem: Problem, salt: str | None) -> Seeds:
    """The public seeds, or with a salt the official ones."""
    if problem.track == "discrepancy":
        sealed = problem.base == "blind-sealed"
        if sealed != (salt is not None):
            raise ParameterError(
                "blind-sealed needs a salt" if sealed else "blind-development takes no salt"
            )
        from ves_gym.diagnosis.benchmark.blind.cases import root_seed

        root = root_seed("sealed" if sealed else "development", salt or "")
        which = "official" if sealed else "public"
        return Seeds(which, root, None if salt is None else salt_mark(salt))
    if salt is None:
        if problem.track == "paths":
            return Seeds("public", REACH_SEED, None)
        pped = problem.environment is None
        return Seeds("public", _PUBLIC_RELEASES if pped else _PUBLIC_EPISODES, None)
    return Seeds("official", _derived(salt, problem), salt_mark(salt))


def _derived(salt: str, problem: Problem) -> int:
    """A root below 2**56, so that what counts up from it stays a seed."""
    what = f"ves-leaderboard/{problem.track}/{PROTOCOL[problem.track]}/{problem.base}"
    return int.from_bytes(_keyed(salt, what)[:7], "big")


def salt_mark(salt: str) -> str:
    """Return a mark that tells salts apart and gives none away."""
    return _keyed(salt, "ves-leaderboard/mark").hex()


def _keyed(salt: str, what: str) -> bytes:
    return hmac.new(salt.encode(), what.encode(), hashlib.sha256).digest()


MARK = re.compile(r"[0-9a-f]{64}")
