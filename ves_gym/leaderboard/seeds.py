"""Seeds of a problem's questions: public and fixed, or official, from a maintainer's salt."""

from __future__ import annotations

import hashlib
import hmac
import os
from pathlib import Path
from typing import NamedTuple

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.problems import Problem
from ves_gym.planners.suites import REACH_SEED

PUBLIC = "public"
_OFFICIAL = "official-"
_EPISODES = 19_940_000  # first public seed; training runs use small numbers
_RELEASES = 432  # thesis 4.3.2
_LEAST_SALT = 16  # characters
_MARK = 16  # hexadecimal digits


class Seeds(NamedTuple):
    """Origin of a problem's questions."""

    name: str  # public, or official- and the mark of the salt, which it does not tell
    root: int


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
    if salt is None:
        episodes = _EPISODES if problem.environment is not None else _RELEASES
        return Seeds(PUBLIC, REACH_SEED if problem.track == "paths" else episodes)
    # below 2**56, so that what counts up from it stays a seed
    root = int.from_bytes(_keyed(salt, f"{problem.track}/{problem.base}")[:7], "big")
    return Seeds(_OFFICIAL + _keyed(salt, "mark").hex()[:_MARK], root)


def _keyed(salt: str, what: str) -> bytes:
    message = f"ves-leaderboard/{what}"
    return hmac.new(salt.encode(), message.encode(), hashlib.sha256).digest()
