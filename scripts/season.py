"""Begin and end a season of official seeds: `python scripts/season.py begin|end NAME`.

begin   draws a salt into out/leaderboard/NAME.salt, which stays secret, and writes its mark
        to docs/leaderboard/seasons/NAME.json: to be committed before anything is answered
        (`python scripts/leaderboard.py --salt out/leaderboard/NAME.salt`)
end     writes the salt there, and publishes the bundles of the season's entries, up to
        --most bytes each (400000): others are made again with the salt
        (`ves-gym leaderboard run --salt`)

--board DIR     another folder of entries
"""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path

from ves_gym._util.params import ParameterError, write_text
from ves_gym.leaderboard.bundle import digest
from ves_gym.leaderboard.journal import read
from ves_gym.leaderboard.protocol import read_salt, salt_mark
from ves_gym.leaderboard.published import publish
from ves_gym.leaderboard.seasons import Season, season_file, write_season
from ves_gym.leaderboard.verify import bundle_manifest

PLACE = Path(__file__).parents[1] / "docs" / "leaderboard"
SECRETS = Path("out/leaderboard")


def begin(board: Path, name: str, secret: Path) -> None:
    """Draw a salt and publish its mark."""
    if secret.exists():
        raise ParameterError(f"{secret} is there already")
    secret.parent.mkdir(parents=True, exist_ok=True)
    salt = secrets.token_hex(32)
    write_text(secret, salt + "\n")
    secret.chmod(0o600)
    write_season(season_file(board, name), Season(salt_mark(salt)))


def end(board: Path, name: str, secret: Path, most: int) -> int:
    """Publish the salt, and bundles of at most so many bytes; how many there are."""
    salt = read_salt(secret)
    mark = salt_mark(salt)
    write_season(season_file(board, name), Season(mark, salt))
    bundles = {
        digest(bundle_manifest(file)[1]): file
        for file in sorted((SECRETS / "bundles").glob(f"*-{mark[:12]}.zip"))
    }
    records = [r for r in read(board).records if r.entry["about"].get("salt") == mark]
    there = [bundles.get(str(r.entry["bundle"])) for r in records]
    return sum(
        file is not None and publish(board, record, file, most) is not None
        for record, file in zip(records, there, strict=True)
    )


def main(words: Sequence[str]) -> int:
    """See the module's docstring."""
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("what", choices=("begin", "end"))
    parser.add_argument("name")
    parser.add_argument("--board", type=Path, default=PLACE / "entries")
    parser.add_argument("--most", type=int, default=400_000, metavar="BYTES")
    args = parser.parse_args(words)
    secret = SECRETS / f"{args.name}.salt"
    if args.what == "begin":
        begin(args.board, args.name, secret)
        print(f"mark written, salt in {secret}: keep it secret")
    else:
        print(f"salt published, with {end(args.board, args.name, secret, args.most)} bundles")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
