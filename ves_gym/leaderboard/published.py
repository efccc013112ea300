"""Bundles published beside the board, so that any reader can verify any row that has one.

The bundle of `entries/NAME.json` is `bundles/NAME.zip`: the one whose manifest has the digest
that the entry names, which is checked before anything else.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from ves_gym._util.params import ParameterError, write_bytes
from ves_gym.baselines.policy import released
from ves_gym.leaderboard.archive import read_members, write_members
from ves_gym.leaderboard.entry import MEASURES, Entry
from ves_gym.leaderboard.errors import BundleError, Code
from ves_gym.leaderboard.evaluators import history_reason
from ves_gym.leaderboard.protocol import QUICK
from ves_gym.leaderboard.record import Record, parse
from ves_gym.leaderboard.run import make_bundle
from ves_gym.leaderboard.seasons import published_salt
from ves_gym.leaderboard.tracks.base import Progress, no_progress
from ves_gym.leaderboard.verify import verify

FOLDER = "bundles"
MOST = 2_000_000  # bytes of a published bundle
RELATIVE = 1e-5  # of a number; the board holds six digits
SHARE = {"paths": 0.95}  # of rows that must be alike; searches may end elsewhere by rounding
_SHARE = 0.99

Plain = Mapping[str, Any]


class Reverified(NamedTuple):
    """An entry of the board, what it gives here, and the share of rows alike."""

    record: Record
    here: Entry
    alike: float
    again: bool  # its method has answered once more, since no bundle is published


def bundle_of(file: str | os.PathLike[str]) -> Path:
    """Return the place of the bundle of an entry.

    Args:
        file: of the entry, in the folder of the board's entries.
    """
    path = Path(file).absolute()
    return path.parent.parent / FOLDER / f"{path.stem}.zip"


def publish(
    folder: str | os.PathLike[str], record: Record, bundle: Path, most: int = MOST
) -> Path | None:
    """Put a bundle beside the board; None where it is too large for that.

    Args:
        folder: of the entries.
        record: the bundle's entry.
        bundle: folder or .zip file.
        most: bytes of a published bundle.
    """
    place = bundle_of(Path(folder) / record.name)
    place.parent.mkdir(parents=True, exist_ok=True)
    packed = place.with_name(f".{place.name}")
    packed.unlink(missing_ok=True)
    try:
        data = write_members(packed, read_members(bundle)).read_bytes()
    finally:
        packed.unlink(missing_ok=True)
    if len(data) > most:
        return None
    write_bytes(place, data)
    return place


def reverify(
    file: str | os.PathLike[str],
    *,
    level: str | None = None,
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress = no_progress,
) -> Reverified:
    """Verify an entry of the board by its published bundle, and compare the rows.

    Where none is published, a method of ves_gym's own answers again, with the entry's seeds.

    Args:
        file: of the entry.
        level: "replayed" or "reproduced"; default that of the entry.
        folder, workers, progress: see `verify`.

    Raises:
        ParameterError: no such file, neither a bundle beside it nor a method of ves_gym's own,
            or official seeds of a season that is not over.
        BundleError: the bundle is not the entry's, is refused, or gives other rows.
    """
    path = Path(file)
    try:
        record = parse(path.name, path.read_bytes())
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read: {error.strerror}") from None
    except ParameterError as error:
        raise ParameterError(f"{path}: is no entry of a board: {error}") from None
    there, bundle = record.entry, bundle_of(path)
    official = there["seeds"] == "official"
    salt = published_salt(path.parent, str(there["about"].get("salt"))) if official else None
    how: dict[str, Any] = {
        "salt": salt,
        "folder": folder,
        "workers": workers,
        "progress": progress,
    }
    again = not bundle.exists()
    if again:
        method = _own_method(path, there)
        with TemporaryDirectory() as place:
            made = make_bundle(
                Path(place) / "again.zip",
                str(there["track"]),
                str(there["problem"]),
                method,
                seeds=range(len({row["group"] for row in there["rows"]})),
                **how,
            )
            here = verify(made, level=level or "replayed", **how)
    else:
        here = verify(
            bundle, level=level or str(there["level"]), expect=str(there["bundle"]), **how
        )
    share = alike(here.rows, there["rows"])
    if share < SHARE.get(str(there["track"]), _SHARE):
        raise BundleError(
            Code.SCORE_DIFFERS,
            f"{path.name}: {share:.0%} of the entry's rows are those that it gives here",
        )
    return Reverified(record, here, share, again)


def _own_method(path: Path, entry: Plain) -> str | list[str | os.PathLike[str]]:
    """Return the name of a built-in method, or the file of a released policy."""
    if (reason := history_reason(entry)) is not None:
        raise ParameterError(
            f"{path.name}: its bundle is not published, and its method's answer of today is"
            f" another: the entry stands under History ({reason})"
        )
    name, problem = str(entry["name"]), str(entry["problem"]).removesuffix(QUICK)
    files = released(problem) if problem.startswith("ves/") else {}
    if entry["kind"] == "policy" and name in files:
        return [files[name]]
    if entry["kind"] == "policy":
        raise ParameterError(
            f"{path.name}: its bundle is not published ({FOLDER}/{bundle_of(path).name} is"
            f" missing), and {name!r} is no policy of ves_gym's own that could act again"
        )
    return name


def alike(rows: Sequence[Plain], others: Sequence[Plain]) -> float:
    """Return the share of rows with the same questions and numbers, to five digits.

    Args:
        rows: of an entry.
        others: those they are compared with.
    """
    if len(rows) != len(others):
        return 0.0
    return float(
        np.mean(
            [
                all(_near(a.get(k), b.get(k)) for k in ("score", *MEASURES))
                and (a["id"], a["group"], a["success"]) == (b["id"], b["group"], b["success"])
                for a, b in zip(rows, others, strict=True)
            ]
        )
    )


def _near(a: float | None, b: float | None) -> bool:
    if a is None or b is None:
        return a is b
    return abs(a - b) <= RELATIVE * max(abs(a), abs(b)) + 1e-9
