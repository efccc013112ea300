"""Rows as columns: what went in comes out, and what is none is told."""

import pytest

from ves_gym._util.params import ParameterError, canonical_json
from ves_gym.leaderboard.columnar import from_columns, to_columns

ROWS = [
    {"id": "a", "group": 0, "score": 0.5, "failed": False, "anytime": [[0.1, 2.0]]},
    {"id": "b", "group": 0, "score": None, "failed": True, "anytime": [[0.1, 2.0]]},
]


@pytest.mark.parametrize(
    "rows", [ROWS, ROWS[:1], [{"x": 0}, {"x": 0.0}], [{"x": True}, {"x": 1}]]
)
def test_rows_come_back_with_the_types_they_had(rows):
    again = from_columns(to_columns(rows))
    assert canonical_json(again) == canonical_json(rows)
    assert to_columns(again) == to_columns(rows)


def test_what_all_rows_have_is_written_once():
    columns = to_columns(ROWS)["columns"]
    assert columns["group"] == 0
    assert columns["anytime"] == [[[0.1, 2.0]]] * 2  # a list is not taken for one value


def test_what_a_row_lacks_is_null():
    assert from_columns(to_columns([{"a": 1}, {"b": 2}])) == [
        {"a": 1, "b": None},
        {"a": None, "b": 2},
    ]


@pytest.mark.parametrize(
    "plain",
    [
        None,
        [],
        {"count": 1},
        {"count": True, "columns": {}},
        {"count": -1, "columns": {}},
        {"count": 10**12, "columns": {"a": 0}},
        {"count": 2, "columns": {"a": [1]}},
        {"count": 2, "columns": []},
    ],
)
def test_what_is_no_such_table_is_refused(plain):
    with pytest.raises(ParameterError, match=r"entry\.rows"):
        from_columns(plain)
