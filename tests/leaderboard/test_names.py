"""Names: one spelling, no character that cannot be seen, none that looks like another's."""

import unicodedata

import pytest

from ves_gym._util.params import ParameterError
from ves_gym.leaderboard.entry import check_entry
from ves_gym.leaderboard.journal import append, read
from ves_gym.leaderboard.names import require_unlike, skeleton

ALIKE = [
    ("ves_gym", "vеs_gym"),  # Cyrillic e
    ("ves_gym", "ves‐gym"),  # a hyphen
    ("ves_gym", "VES_GYM"),
    ("ppo", "рро"),  # Cyrillic throughout
    ("ppo", "ppο"),  # Greek o
    ("ppo", "ｐｐｏ"),  # full width
    ("ppo", "pp0"),
    ("Ida Hall", "lda Hall"),
    ("A. Name", "A. Narne"),
    ("Muller", "Müller"),
]


@pytest.mark.parametrize(("there", "new"), ALIKE)
def test_a_name_that_looks_like_another_is_refused(there, new):
    assert skeleton(there) == skeleton(new)
    require_unlike(there, [there, "someone"], "author")  # itself
    with pytest.raises(ParameterError, match="looks like"):
        require_unlike(new, ["someone", there], "author")


def test_names_that_only_resemble_each_other_are_not():
    names = [
        "refined",
        "refined-2",
        "direct",
        "ppo",
        "ppo-lab",
        "trpo",
        "anna",
        "hanna",
        "李雷",
    ]
    assert len({skeleton(name) for name in names}) == len(names)
    require_unlike("", names, "author")  # without an author


@pytest.mark.parametrize(
    "name",
    [
        "a\u202eb",  # changes the direction of what follows
        "a\u2066b",
        "a\u200bb",  # of no width
        "a\x1b[2Jb",  # clears a terminal
        "a\x9bb",
        "a\u00a0b",
        "a\ue000b",
        " a",
        "a  b",
        unicodedata.normalize("NFD", "Müller"),
        "\u0301a",
    ],
)
def test_characters_that_cannot_be_seen_or_have_two_spellings(name, make_entry):
    for key in ("name", "author"):
        with pytest.raises(ParameterError, match=f"entry.{key}"):
            check_entry(make_entry() | {key: name})


def test_the_journal_takes_no_look_alike(tmp_path, make_entry):
    path = tmp_path / "entries"
    append(path, make_entry("ppo"))
    for change in ({"author": "vеs_gym"}, {"name": "рро"}):
        with pytest.raises(ParameterError, match="looks like"):
            append(path, make_entry("ppo") | change)
    assert len(read(path).records) == 1
    append(path, make_entry("李雷") | {"author": "Zoë Åström"})
    assert len(read(path).records) == 2
