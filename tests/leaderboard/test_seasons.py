"""A season's salt is bound by the mark published before, and opens every official row after."""

import pytest

from tests.leaderboard.bundles import policy_bundle
from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.journal import append
from ves_gym.leaderboard.protocol import salt_mark
from ves_gym.leaderboard.published import publish, reverify
from ves_gym.leaderboard.seasons import (
    Season,
    published_salt,
    read_season,
    season_file,
    write_season,
)
from ves_gym.leaderboard.verify import verify

SALT = "a secret of the tests"


def test_an_official_row_is_verified_by_anybody_once_the_season_is_over(tmp_path):
    board = tmp_path / "entries"
    file = season_file(board, "2026-11")
    write_season(file, Season(salt_mark(SALT)))
    bundle = policy_bundle(tmp_path, name="official.zip", salt=SALT)
    record = append(board, verify(bundle, salt=SALT).shortened())
    assert record.entry["about"]["salt"] == salt_mark(SALT)
    publish(board, record, bundle)
    with pytest.raises(ParameterError, match="2026-11 is not over"):
        reverify(board / record.name)
    write_season(file, Season(salt_mark(SALT), SALT))
    assert reverify(board / record.name).alike == 1.0


def test_no_other_salt_can_be_published(tmp_path):
    board = tmp_path / "entries"
    file = season_file(board, "one")
    mark = salt_mark(SALT)
    write_season(file, Season(mark))
    with pytest.raises(ParameterError, match="not the one whose mark"):
        Season(mark, SALT + "!")
    with pytest.raises(ParameterError, match="cannot be changed"):
        write_season(file, Season(salt_mark(SALT + "!")))
    write_season(file, Season(mark, SALT))
    with pytest.raises(ParameterError, match="cannot be changed"):
        write_season(file, Season(mark))
    assert published_salt(board, mark) == SALT
    with pytest.raises(ParameterError, match="no season"):
        published_salt(board, "0" * 64)


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"schema":"ves-season/1"}', '{"mark":1,"salt":null,"schema":"ves-season/1"}'],
)
def test_a_damaged_season_is_named(tmp_path, text):
    file = season_file(tmp_path / "entries", "x")
    file.parent.mkdir()
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ParameterError, match=r"x\.json"):
        read_season(file)
    with pytest.raises(ParameterError, match="letters, digits"):
        season_file(tmp_path, "../x")
