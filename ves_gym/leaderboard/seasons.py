"""Seasons of official seeds: the mark of a secret salt comes first, the salt when it is over.

`seasons/NAME.json`, beside the folder of the board's entries, holds `mark`, which is published
before anything is answered, and `salt`, null until the season ends. Nobody can choose another
salt afterwards (`salt_mark` is an HMAC), and from then on anybody can make the seeds and verify
every official row.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

from ves_gym._util.params import ParameterError, canonical_json, write_text
from ves_gym.leaderboard.protocol import MARK, salt_mark

SCHEMA = "ves-season/1"
FOLDER = "seasons"
_KEYS = {"schema", "mark", "salt"}


@dataclass(frozen=True)
class Season:
    """A season: the mark of its salt, and the salt once it is over."""

    mark: str
    salt: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.mark, str) or not MARK.fullmatch(self.mark):
            raise ParameterError(f"mark must be 64 digits of SHA-256, got {self.mark!r:.80}")
        if self.salt is not None and (
            not isinstance(self.salt, str) or salt_mark(self.salt) != self.mark
        ):
            raise ParameterError("the salt is not the one whose mark was published")


def season_file(board: str | os.PathLike[str], name: str) -> Path:
    """Return the file of a season.

    Args:
        board: the folder of the entries.
        name: of the season: letters, digits and hyphens.
    """
    if not name or not all(k.isascii() and (k.isalnum() or k == "-") for k in name):
        raise ParameterError(f"a season is named by letters, digits and hyphens, got {name!r}")
    return Path(board).absolute().parent / FOLDER / f"{name}.json"


def read_season(file: Path) -> Season:
    """Read a season.

    Raises:
        ParameterError: no such file, not of the schema, or a salt of another mark.
    """
    try:
        plain = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ParameterError(f"{file}: cannot be read: {error}") from None
    if not isinstance(plain, dict) or plain.keys() != _KEYS or plain["schema"] != SCHEMA:
        raise ParameterError(f"{file}: expected {', '.join(sorted(_KEYS))}, schema {SCHEMA}")
    try:
        return Season(plain["mark"], plain["salt"])
    except ParameterError as error:
        raise ParameterError(f"{file}: {error}") from None


def write_season(file: Path, season: Season) -> None:
    """Write a season; one that is there can only be ended, with its own salt.

    Raises:
        ParameterError: another mark, or a season that is over.
    """
    if file.exists():
        before = read_season(file)
        if before.mark != season.mark or before.salt is not None:
            raise ParameterError(f"{file.name}: a season cannot be changed, only ended")
    file.parent.mkdir(parents=True, exist_ok=True)
    content = {"schema": SCHEMA, "mark": season.mark, "salt": season.salt}
    write_text(file, canonical_json(content) + "\n")


def season_names(board: str | os.PathLike[str]) -> dict[str, str]:
    """Return the names of the seasons of a board, by the marks of their salts.

    Args:
        board: the folder of the entries.

    Raises:
        ParameterError: a file that is not of a season.
    """
    return {season.mark: file.stem for file, season in _seasons(board)}


def published_salt(board: str | os.PathLike[str], mark: str) -> str:
    """Return the salt of a season that is over.

    Args:
        board: the folder of the entries.
        mark: of the salt, as an official entry has it.

    Raises:
        ParameterError: no season has that mark, or it is not over.
    """
    for file, season in _seasons(board):
        if season.mark == mark:
            if season.salt is None:
                raise ParameterError(f"season {file.stem} is not over: its salt is secret yet")
            return season.salt
    raise ParameterError(f"no season of the board has the mark {mark[:12]}...")


def _seasons(board: str | os.PathLike[str]) -> list[tuple[Path, Season]]:
    files = sorted((Path(board).absolute().parent / FOLDER).glob("*.json"))
    return [(file, read_season(file)) for file in files]
